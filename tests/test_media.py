"""Images and videos are read as grey levels, upright and in order."""

import re
import struct

import cv2
import numpy as np
import pytest
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
    alpha = np.dstack([colour, NOISE])
    for name, image in (("c.png", colour), ("c.jpg", colour), ("a.png", alpha)):
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
    with pytest.raises(ImageError, match=r"cannot read .*missing.png"):
        media.read_image(tmp_path / "missing.png")


def test_every_page_of_a_stack_is_read(tmp_path):
    pages = [np.roll(NOISE, k) for k in range(5)]
    cv2.imwritemulti(str(tmp_path / "a.tif"), pages)
    frames = list(media.read_frames(tmp_path / "a.tif"))
    assert [frame.index for frame in frames] == list(range(5))
    np.testing.assert_array_equal([frame.image for frame in frames], pages)
    np.testing.assert_array_equal(media.read_image(tmp_path / "a.tif"), pages[0])


def test_an_image_that_is_too_large_is_refused(tmp_path):
    with open(tmp_path / "a.png", "wb") as file:
        file.truncate((1 << 30) + 1)  # it has no blocks on the disk
    (tmp_path / "b.pgm").write_bytes(b"P5 40000 40000 255\n")
    with pytest.raises(ImageError, match=r"a\.png' has over 1073741824 bytes"):
        media.read_image(tmp_path / "a.png")
    with pytest.raises(ImageError, match=r"b\.pgm' is not an image .*MAX_IMAGE_PIXELS"):
        media.read_image(tmp_path / "b.pgm")


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


def test_a_video_that_is_cut_off_gives_its_frames_and_marks_the_missing_ones(tmp_path):
    write_video(tmp_path / "press.avi", [np.roll(NOISE, k) for k in range(40)], "MJPG")
    assert [frame.why for frame in media.read_frames(tmp_path / "press.avi")] == [""] * 40
    whole = (tmp_path / "press.avi").read_bytes()
    (tmp_path / "press.avi").write_bytes(whole[: len(whole) // 2])
    frames = list(media.read_frames(tmp_path / "press.avi"))
    broken = [frame.index for frame in frames if frame.image is None]
    assert [frame.index for frame in frames] == list(range(40))
    assert 15 <= len(broken) < 39
    assert broken == list(range(broken[0], 40))
    assert [frame.why for frame in frames[-15:]] == ["the file is cut off"] * 15


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_video_comes_upright(tmp_path, quarters):
    path = tmp_path / "held.mp4"
    write_video(path, [NOISE] * 3, "mp4v")
    flat = next(media.read_frames(path)).image
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 44  # of a header of version 0
    cosine, sine = ((0, 1), (-1, 0), (0, -1))[quarters - 1]
    turn = [cosine, sine, 0, -sine, cosine, 0]
    data[matrix : matrix + 24] = struct.pack(">6i", *(number << 16 for number in turn))
    path.write_bytes(data)
    upright = next(media.read_frames(path)).image
    np.testing.assert_array_equal(upright, np.rot90(flat, -quarters))


def test_an_unknown_codec_is_an_image_error(tmp_path):
    write_video(tmp_path / "press.avi", brighter(3))
    data = (tmp_path / "press.avi").read_bytes()
    (tmp_path / "press.avi").write_bytes(data.replace(b"FFV1", b"zzzz"))
    with pytest.raises(ImageError, match="no video of a codec that PyAV knows"):
        next(media.read_frames(tmp_path / "press.avi"))


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


def test_pyav_reads_12_bits_and_the_times_that_are_written(tmp_path):
    ramp = np.tile(np.arange(64, dtype=np.uint16) * 64, (48, 1))
    write_deep_video(tmp_path / "deep.mkv", ramp)
    frames = list(media.read_frames(tmp_path / "deep.mkv"))
    assert [frame.time_ms for frame in frames] == pytest.approx([0, 35, 110])
    assert frames[0].image.dtype == np.uint16
    np.testing.assert_array_equal(frames[0].image, ramp)
    assert media.video_info(tmp_path / "deep.mkv").full_scale == 4095


def test_a_file_that_is_no_video_is_an_image_error(tmp_path):
    (tmp_path / "text.mp4").write_text("hello")
    for name in ("text.mp4", "missing.mp4"):
        with pytest.raises(ImageError, match=name):
            next(media.read_frames(tmp_path / name))


def test_a_folder_stands_for_its_images_and_videos_by_name(tmp_path):
    for name in ("b.png", "a.JPG", "c.avi", "notes.txt", "d.csv", "._a.JPG"):
        (tmp_path / name).touch()
    (tmp_path / "e.png").mkdir()
    found = media.find_inputs([tmp_path, tmp_path / "notes.txt"])
    assert [path.name for path in found] == ["a.JPG", "b.png", "c.avi", "notes.txt"]
    with pytest.raises(FileNotFoundError, match="no image and no video in the folder"):
        media.find_inputs([tmp_path / "e.png"])
    with pytest.raises(FileNotFoundError, match="there is no file"):
        media.find_inputs([tmp_path / "missing.png"])


def test_a_file_pattern_that_the_shell_did_not_expand_stands_for_its_files(tmp_path):
    for name in ("b1.png", "b2.png", "b10.png", "c1.png", "b[1].png"):
        (tmp_path / name).touch()
    assert [path.name for path in media.find_inputs([tmp_path / "b?.png"])] == ["b1.png", "b2.png"]
    for numbered in (tmp_path / "b*.png", tmp_path):
        names = [path.name for path in media.find_inputs([numbered])]
        assert names[:3] == ["b1.png", "b2.png", "b10.png"]
    assert media.find_inputs([tmp_path / "b[1].png"]) == [tmp_path / "b[1].png"]
    with pytest.raises(FileNotFoundError, match=r"d\*\.png"):
        media.find_inputs([tmp_path / "d*.png"])
