"""Images and videos are read as grey levels, upright and in order."""

import itertools
import os
import re
import struct
import zlib

import av
import cv2
import numpy as np
import pytest
from children import python
from videos import write_deep_video, write_video

from cmp_cl import media
from cmp_cl.errors import ImageError

NOISE = np.random.default_rng(1).integers(0, 256, (48, 64), dtype=np.uint8)


def test_grey_levels_come_back_as_they_were_written(tmp_path):
    deep = NOISE.astype(np.uint16) * 16
    for suffix in (".png", ".tif", ".pgm"):
        for image in (NOISE, deep):
            media.write_image(tmp_path / f"a{suffix}", image)
            read = media.read_image(tmp_path / f"a{suffix}")
            assert read.dtype == image.dtype
            np.testing.assert_array_equal(read, image)


def photograph(name, orientation):
    """Return the bytes of a JPEG whose EXIF tag says how it was held."""
    data = cv2.imencode(name, NOISE)[1].tobytes()
    tag = struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, 0x112, 3, 1, orientation, 0, 0)
    exif = b"Exif\0\0" + tag
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


def test_a_photograph_comes_upright(tmp_path):
    (tmp_path / "held.jpg").write_bytes(photograph(".jpg", 6))
    flat = cv2.imdecode(np.frombuffer(photograph(".jpg", 1), np.uint8), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(media.read_image(tmp_path / "held.jpg"), np.rot90(flat, -1))


def test_colour_becomes_grey_as_in_opencv(tmp_path):
    colour = np.dstack([NOISE, NOISE[::-1], NOISE[:, ::-1]])
    opaque = np.dstack([colour, np.full_like(NOISE, 255)])
    for name, image in (("c.png", colour), ("c.jpg", colour), ("a.png", opaque)):
        path = tmp_path / name
        media.write_image(path, image)
        read = media.read_image(path)
        assert read.shape == NOISE.shape
        np.testing.assert_array_equal(read, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


def test_a_file_that_is_no_image_is_an_image_error_with_its_name(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_bytes(b"")
    media.write_image(tmp_path / "whole.png", NOISE)
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:60])
    for name in ("text.png", "cut.png", "empty.png"):
        with pytest.raises(ImageError, match=f"{name}' is not an image"):
            media.read_image(tmp_path / name)
    with pytest.raises(ImageError, match="is a folder or a device"):
        next(media.read_frames(tmp_path))
    with pytest.raises(ImageError, match=r"cannot read .*missing.png"):
        media.read_image(tmp_path / "missing.png")


def black_png(side, rows=None):
    """Return a black PNG of 16 bits with alpha, (side, side); rows: how many it has of them."""
    row, count = bytes(1 + side * 8), side if rows is None else rows
    packing = zlib.compressobj(1, wbits=-15)
    packed = packing.compress(row) + packing.flush(zlib.Z_FULL_FLUSH)
    check = struct.pack(">HH", count * len(row) % 65521, 1)  # Adler's of zeros
    pixels = b"\x78\x01" + packed * count + b"\x03\0" + check
    head = struct.pack(">IIBBBBB", side, side, 16, 6, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n"
    for name, body in ((b"IHDR", head), (b"IDAT", pixels), (b"IEND", b"")):
        data += struct.pack(">I", len(body)) + name + body
        data += struct.pack(">I", zlib.crc32(name + body))
    return data


def looping_tiff(extra):
    """Return a TIFF whose directory is followed by itself; extra: entries that mean nothing."""
    entries = [(256, 64), (257, 48), (258, 8), (259, 1), (262, 1), (273, 0), (277, 1), (278, 48)]
    entries += [(279, 64 * 48), *((60_000, 0) for _ in range(extra))]
    start = 8 + 2 + 12 * len(entries) + 4
    data = struct.pack("<2sHIH", b"II", 42, 8, len(entries))
    for tag, value in entries:
        data += struct.pack("<HHII", tag, 4, 1, start if tag == 273 else value)
    return data + struct.pack("<I", 8) + bytes(64 * 48)


def long_png():
    """Return a PNG with a chunk that is said to have 1 GB."""
    data = cv2.imencode(".png", NOISE)[1].tobytes()
    return data[:33] + struct.pack(">I", 10**9) + b"tEXt" + data[33:]


READ = """
import resource, sys, time
from cmp_cl import ImageError, media
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start = time.process_time()
try:
    print(len(list(media.read_frames(sys.argv[1]))))
except ImageError as error:
    print(error)
print(time.process_time() - start)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


@pytest.mark.skipif(os.name == "nt", reason="memory is not measured on Windows")
@pytest.mark.parametrize(
    ("data", "says", "most_s", "most_mb"),
    [
        (lambda: black_png(30_000, rows=1), "more pixels than OpenCV's limit", 1, 200),
        (long_png, "is not an image", 1, 200),
        (lambda: looping_tiff(0), "1", 1, 200),
        (lambda: looping_tiff(60_000), "is not an image", 1, 200),
        (lambda: black_png(11_500), "1", 20, 1000),
    ],
    ids=["900 Mpx", "a chunk of 1 GB", "a loop", "a loop of long directories", "132 Mpx"],
)
def test_an_image_of_any_size_takes_little_time_and_memory(tmp_path, data, says, most_s, most_mb):
    (tmp_path / "a.tif").write_bytes(data())
    done = python("-c", READ, tmp_path / "a.tif", check=True)
    said, seconds, megabytes = done.stdout.splitlines()
    assert says in said
    assert float(seconds) < most_s
    assert float(megabytes) < most_mb


@pytest.mark.parametrize("share", [0.3, 0.5, 0.99])
def test_a_stack_that_is_cut_off_gives_the_pages_before_the_cut(tmp_path, share):
    pages = [np.roll(NOISE, k) for k in range(5)]
    cv2.imwritemulti(str(tmp_path / "a.tif"), pages)
    whole = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(whole[: int(len(whole) * share)])
    read = list(media.read_pages(tmp_path / "a.tif"))
    assert len(read) >= int(share * len(pages))
    for page, expected in zip(read, pages, strict=False):
        np.testing.assert_array_equal(page, expected)


def brighter(count):
    """Return images that grow brighter by 6 grey levels each."""
    return [np.full((48, 64), 6 * index, np.uint8) for index in range(count)]


def test_a_video_gives_its_frames_in_order_as_grey(tmp_path):
    write_video(tmp_path / "press.avi", brighter(8))
    frames = list(media.read_frames(tmp_path / "press.avi"))
    assert media.video_info(tmp_path / "press.avi") == (8, 25, None)
    assert len(frames) == 8
    for index, frame in enumerate(frames):
        assert frame.index == index
        assert frame.image.shape == (48, 64)
        assert abs(int(frame.image[0, 0]) - 6 * index) <= 1
        assert frame.time_ms == pytest.approx(40 * index)


@pytest.mark.parametrize(("name", "codec"), [("press.avi", "MJPG"), ("press.mkv", "FFV1")])
def test_a_video_that_is_cut_off_gives_its_frames_and_marks_the_missing_ones(tmp_path, name, codec):
    write_video(tmp_path / name, [np.roll(NOISE, k) for k in range(40)], codec)
    assert [frame.why for frame in media.read_frames(tmp_path / name)] == [""] * 40
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    frames = list(media.read_frames(tmp_path / name))
    broken = [frame.index for frame in frames if frame.image is None]
    assert [frame.index for frame in frames] == list(range(40))
    assert 15 <= len(broken) < 39
    assert broken == list(range(broken[0], 40))
    assert [frame.why for frame in frames[-15:]] == ["the file is cut off"] * 15


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_video_comes_upright(tmp_path, quarters, mirrored):
    path = tmp_path / "held.mp4"
    write_video(path, [NOISE] * 3, "mp4v")
    flat = next(media.read_frames(path)).image
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 44  # of a header of version 0
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    side = -1 if mirrored else 1
    turn = [side * cosine, side * sine, 0, -sine, cosine, 0]
    data[matrix : matrix + 24] = struct.pack(">6i", *(number << 16 for number in turn))
    path.write_bytes(data)
    upright = next(media.read_frames(path)).image
    seen = flat[:, ::-1] if mirrored else flat
    np.testing.assert_array_equal(upright, np.rot90(seen, -quarters))


def test_a_raw_stream_of_h264_is_read(tmp_path):
    path = tmp_path / "press.h264"
    with av.open(str(path), "w", format="h264") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for level in (200, 100, 50):
            picture = np.full((48, 64), level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    levels = [frame.image.mean() for frame in media.read_frames(path)]
    assert levels == pytest.approx([200, 100, 50], abs=3)


def test_a_damaged_frame_is_none_and_those_after_it_are_read(tmp_path):
    writer = cv2.VideoWriter(  # in colour: PyAV finds no damage in grey JPEG
        str(tmp_path / "press.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48)
    )
    for number in range(10):
        writer.write(np.dstack([np.roll(NOISE, number)] * 3))
    writer.release()
    data = bytearray((tmp_path / "press.avi").read_bytes())
    starts = [match.start() for match in re.finditer(rb"\xff\xda", data)]
    data[starts[4] + 100 : starts[4] + 200] = bytes(100)
    (tmp_path / "press.avi").write_bytes(data)
    frames = list(media.read_frames(tmp_path / "press.avi"))
    assert [frame.index for frame in frames if frame.image is None] == [4]
    assert len(frames) == 10


@pytest.mark.parametrize(("codec", "name"), [("libx264", "a.mp4"), ("ffv1", "a.mkv")])
def test_frames_that_build_on_a_damaged_one_are_none(tmp_path, codec, name):
    path = tmp_path / name
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height = NOISE.shape[::-1]
        stream.pix_fmt, stream.gop_size = "yuv420p", 10
        for number in range(40):
            picture = cv2.GaussianBlur(NOISE, (0, 0), 2) // 2 + np.roll(NOISE, number) // 4
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="gray")))
        container.mux(stream.encode())
    whole = list(media.read_frames(path))
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    time_ms = 1e3 * float(packets[14].pts * packets[14].time_base)
    data = bytearray(path.read_bytes())
    middle = packets[14].pos + packets[14].size // 2
    data[middle : middle + 40] = bytes(range(40))
    path.write_bytes(data)
    frames = list(media.read_frames(path))
    lost = {frame.index: frame.why for frame in frames if frame.image is None}
    assert [frame.time_ms for frame in frames] == [frame.time_ms for frame in whole]
    assert set(lost.values()) == {"", "it builds on a damaged frame"}
    assert set(range(round(time_ms / 40), 20)) <= lost.keys() <= set(range(9, 20))
    for frame in frames:
        if frame.image is not None:
            np.testing.assert_array_equal(frame.image, whole[frame.index].image)


def test_a_video_of_two_moments_a_frame_is_told_once(tmp_path):
    path = tmp_path / "press.mpg"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg2video", rate=25, options={"flags": "+ildct+ilme"})
        stream.width, stream.height, stream.pix_fmt = *NOISE.shape[::-1], "yuv420p"
        for _ in range(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(NOISE, format="gray")))
        container.mux(stream.encode())
    with pytest.warns(UserWarning, match="press.mpg' is interlaced") as told:
        assert len(list(media.read_frames(path))) == 3
    assert len(told) == 1


def test_frames_of_another_size_come_as_they_are(tmp_path):
    sizes = [(60, 80), (90, 120), (60, 80)]
    jpegs = [cv2.imencode(".jpg", np.full(size, 90, np.uint8))[1].tobytes() for size in sizes]
    (tmp_path / "press.mjpeg").write_bytes(b"".join(jpegs))
    frames = list(media.read_frames(tmp_path / "press.mjpeg"))
    assert [frame.image.shape for frame in frames] == sizes


def test_pyav_reads_12_bits_and_the_times_that_are_written(tmp_path):
    ramp = np.tile(np.arange(64, dtype=np.uint16) * 64, (48, 1))
    write_deep_video(tmp_path / "deep.mkv", ramp)
    frames = list(media.read_frames(tmp_path / "deep.mkv"))
    assert [frame.time_ms for frame in frames] == pytest.approx([0, 35, 110])
    assert frames[0].image.dtype == np.uint16
    np.testing.assert_array_equal(frames[0].image, ramp)
    assert media.video_info(tmp_path / "deep.mkv").full_scale == 4095


def test_what_is_no_video_is_an_image_error_that_says_why(tmp_path):
    write_video(tmp_path / "codec.avi", brighter(3))
    unknown = (tmp_path / "codec.avi").read_bytes().replace(b"FFV1", b"zzzz")
    (tmp_path / "codec.avi").write_bytes(unknown)
    (tmp_path / "text.mp4").write_text("hello")
    cv2.imwrite(str(tmp_path / "secret.png"), np.zeros((16, 16), np.uint8))
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile secret.png\n")
    for name, why in (
        ("codec.avi", "codec.avi.*no video of a codec that PyAV knows"),
        ("text.mp4", "text.mp4"),
        ("missing.mp4", "missing.mp4"),
        ("list.mp4", "list.mp4.*or a list of other files"),
    ):
        with pytest.raises(ImageError, match=why):
            next(media.read_frames(tmp_path / name))


def test_a_folder_stands_for_its_images_and_videos_by_name(tmp_path):
    for name in ("b.png", "a.JPG", "c.avi", "notes.txt", "d.csv", "._a.JPG"):
        (tmp_path / name).touch()
    (tmp_path / "e.png").mkdir()
    found = media.find_inputs([tmp_path, tmp_path / "notes.txt"])
    assert [path.name for path in found] == ["a.JPG", "b.png", "c.avi", "notes.txt"]
    with pytest.raises(FileNotFoundError, match="no image and no video in the folder"):
        media.find_inputs([tmp_path / "e.png"])
    for name in (tmp_path / "missing.png", ""):
        with pytest.raises(FileNotFoundError, match="there is no file"):
            media.find_inputs([name])


def test_a_file_pattern_that_the_shell_did_not_expand_stands_for_its_files(tmp_path):
    for name in ("b1.png", "b2.png", "b10.png", "c1.png", "b[1].png"):
        (tmp_path / name).touch()
    assert [path.name for path in media.find_inputs([tmp_path / "b?.png"])] == ["b1.png", "b2.png"]
    for numbered in (tmp_path / "b*.png", tmp_path):
        names = [path.name for path in media.find_inputs([numbered])]
        assert names[:3] == ["b1.png", "b2.png", "b10.png"]
    times = ["1700000000.123456.png", "1700000000.2.png", "1700000001.05.png"]
    for name in times:
        (tmp_path / name).touch()
    assert [path.name for path in media.find_inputs([tmp_path])][:3] == times
    assert media.find_inputs([tmp_path / "b[1].png"]) == [tmp_path / "b[1].png"]
    with pytest.raises(FileNotFoundError, match=r"d\*\.png"):
        media.find_inputs([tmp_path / "d*.png"])


@pytest.mark.parametrize(("suffix", "ground"), [("png", 0), ("png", 90), ("tif", 90), ("webp", 0)])
def test_what_is_transparent_is_white(tmp_path, suffix, ground):
    """Whatever grey level lies under it."""
    drawn = np.full((20, 30, 4), ground, np.uint8)
    drawn[..., 3] = 0
    drawn[5:10, 5:10] = 50, 50, 50, 255
    drawn[12:15, :, 3] = 128
    other = drawn.copy()
    other[17, 20:] = 255
    cv2.imwritemulti(str(tmp_path / f"logo.{suffix}"), [drawn, other])
    read = list(itertools.islice(media.read_pages(tmp_path / f"logo.{suffix}"), 3))
    assert len(read) == 1 + (suffix == "tif"), "only the first image of an animation"
    for grey in read:
        half = (ground * 128 + 255 * 127) / 255
        np.testing.assert_allclose((grey[0, 0], grey[6, 6], grey[13, 0]), (255, 50, half), atol=1)


def test_a_colour_of_a_png_may_be_transparent(tmp_path):
    data = cv2.imencode(".png", np.dstack([NOISE] * 3))[1].tobytes()
    which = b"tRNS" + struct.pack(">3H", 7, 7, 7)
    chunk = struct.pack(">I", 6) + which + struct.pack(">I", zlib.crc32(which))
    (tmp_path / "key.png").write_bytes(data[:33] + chunk + data[33:])
    found = media.read_image(tmp_path / "key.png")
    np.testing.assert_array_equal(found, np.where(NOISE == 7, 255, NOISE))
