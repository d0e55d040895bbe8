"""Images and videos are read as grey levels; a CSV names its units."""

import contextlib
import csv
import itertools
import os
import re
import struct
import threading

import cv2
import numpy as np
import pytest
from videos import write_deep_video, write_video

from cmp_cl import media
from cmp_cl.cli.tables import CORNER_COLUMNS, Table, corner_rows
from cmp_cl.corners import Corners, Method
from cmp_cl.errors import ImageError
from cmp_cl.files import whole_file
from cmp_cl.image_size import page_sizes

NOISE = np.random.default_rng(1).integers(0, 256, (48, 64), dtype=np.uint8)


def corners_at(xy):
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    count = len(xy)
    return Corners(
        xy=xy,
        pixel=np.rint(xy).astype(np.int32),
        response=np.full(count, 4, np.float32),
        method=np.full(count, Method.EDGE_LINES, np.uint8),
        sigma=np.full(count, np.nan, np.float32),
        edges=np.tile(np.float32([0, 1.5, 3, -1.5]), (count, 1)),
        doubtful=np.zeros(count, bool),
        refusal=np.zeros(count, np.uint8),
        device="none",
    )


def test_grey_levels_come_back_as_they_were_written(tmp_path):
    deep = NOISE.astype(np.uint16) * 16
    for suffix in (".png", ".tif", ".pgm"):
        for image in (NOISE, deep):
            media.write_image(tmp_path / f"a{suffix}", image)
            read = media.read_image(tmp_path / f"a{suffix}")
            assert read.dtype == image.dtype
            np.testing.assert_array_equal(read, image)


@pytest.mark.parametrize(
    "name",
    ["a.png", "a.jpg", "a.bmp", "a.pgm", "a.ppm", "a.pbm", "a.tif", "a.webp", "a.jp2", "a.gif"],
)
def test_the_size_of_an_image_is_known_before_it_is_unpacked(name, tmp_path):
    image = np.dstack([NOISE] * 3) if name in ("a.ppm", "a.gif") else NOISE
    media.write_image(tmp_path / name, image)
    data = (tmp_path / name).read_bytes()
    assert page_sizes(memoryview(data)) == [(64, 48)]
    for most, fits in ((64 * 48, True), (64 * 48 - 1, False)):
        with contextlib.nullcontext() if fits else pytest.raises(ImageError, match="64 x 48"):
            assert media.read_image(tmp_path / name, max_pixels=most).shape == (48, 64)
    for end in range(0, min(len(data), 120), 7):  # never another size, never another error
        with contextlib.suppress(ValueError):
            assert page_sizes(memoryview(data[:end])) in (None, [(64, 48)])


def test_unknown_formats_have_no_known_size():
    for data in (b"", b"text", b"\x76\x2f\x31\x01 OpenEXR"):
        assert page_sizes(memoryview(data)) is None


def test_a_webp_with_transparency_and_a_big_endian_tiff_have_their_sizes(tmp_path):
    media.write_image(tmp_path / "a.webp", np.dstack([NOISE] * 4))
    assert page_sizes(memoryview((tmp_path / "a.webp").read_bytes())) == [(64, 48)]
    tiff = struct.pack(">2sHIHHHIHHHHIII", b"MM", 42, 8, 2, 256, 3, 1, 64, 0, 257, 4, 1, 48, 0)
    assert page_sizes(memoryview(tiff)) == [(64, 48)]


def test_a_stack_whose_pages_lead_to_one_another_is_an_image_error(tmp_path):
    tiff = struct.pack("<2sHIHHHIHHHHIII", b"II", 42, 8, 2, 256, 3, 1, 64, 0, 257, 4, 1, 48, 8)
    (tmp_path / "loop.tif").write_bytes(tiff)
    with pytest.raises(ImageError, match="lead to one another"):
        media.read_image(tmp_path / "loop.tif")


def test_a_stack_is_unpacked_page_by_page(tmp_path, monkeypatch):
    pages = [np.full((300, 400), level, np.uint8) for level in range(20)]
    cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    asked = []
    decode = cv2.imdecodemulti

    def noted(data, flags, **what):
        asked.append(what["range"])
        return decode(data, flags, **what)

    monkeypatch.setattr(cv2, "imdecodemulti", noted)
    frames = media.read_frames(tmp_path / "stack.tif")
    for index in range(3):
        np.testing.assert_array_equal(next(frames).image, pages[index])
    assert asked == [(0, 1), (1, 2), (2, 3)]
    assert len(list(frames)) == 17


@pytest.mark.skipif(os.name == "nt", reason="there are no named pipes on Windows")
def test_an_image_comes_through_a_pipe(tmp_path):
    data = cv2.imencode(".png", NOISE)[1].tobytes()
    os.mkfifo(tmp_path / "pipe")
    writer = threading.Thread(target=(tmp_path / "pipe").write_bytes, args=(data,))
    writer.start()
    np.testing.assert_array_equal(media.read_image(tmp_path / "pipe"), NOISE)
    writer.join()


def test_colour_becomes_grey_as_in_opencv(tmp_path):
    colour = np.dstack([NOISE, NOISE[::-1], NOISE[:, ::-1]])
    alpha = np.dstack([colour, NOISE])
    for name, image in (("c.png", colour), ("c.jpg", colour), ("a.png", alpha)):
        path = tmp_path / name
        media.write_image(path, image)
        read = media.read_image(path)
        assert read.shape == NOISE.shape
        np.testing.assert_array_equal(read, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize("name", ["a.jpg", "a.bmp", "a.xyz", "a"])
def test_formats_that_would_cut_16_bits_refuse_them(name, tmp_path):
    with pytest.raises(ImageError, match="cannot write uint16 pixels"):
        media.write_image(tmp_path / name, NOISE.astype(np.uint16))
    assert os.listdir(tmp_path) == []


def test_a_file_that_is_no_image_is_an_image_error_with_its_name(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_bytes(b"")
    media.write_image(tmp_path / "whole.png", NOISE)
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:60])
    for name in ("text.png", "cut.png"):
        with pytest.raises(ImageError, match=f"{name}' is not an image"):
            media.read_image(tmp_path / name)
    with pytest.raises(ImageError, match=r"empty\.png.* is empty"):
        media.read_image(tmp_path / "empty.png")
    with pytest.raises(ImageError, match=r"cannot read .*missing.png"):
        media.read_image(tmp_path / "missing.png")


def test_pixels_of_another_type_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "f.tif"), NOISE.astype(np.float32))
    with pytest.raises(ImageError, match="holds float32 pixels, expected 8 or 16 bits"):
        media.read_image(tmp_path / "f.tif")


def test_every_page_of_a_stack_is_a_frame(tmp_path):
    pages = [NOISE, NOISE[::-1].copy(), NOISE[:, ::-1].copy()]
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    frames = list(media.read_frames(tmp_path / "stack.tif"))
    assert [frame.index for frame in frames] == [0, 1, 2]
    for frame, page in zip(frames, pages, strict=True):
        np.testing.assert_array_equal(frame.image, page)


def brighter(count):
    """Return images that grow brighter by 6 grey levels each."""
    return [np.full((48, 64), 6 * index, np.uint8) for index in range(count)]


@pytest.fixture(params=["PyAV", "OpenCV"])
def reader(request, monkeypatch):
    """Return the reader of videos."""
    if request.param == "PyAV":
        pytest.importorskip("av", reason="PyAV is not installed")
    monkeypatch.setattr(media, "has_pyav", lambda: request.param == "PyAV")
    return request.param


def test_a_video_gives_its_frames_in_order_as_grey(tmp_path, reader):
    write_video(tmp_path / "press.avi", brighter(8))
    frames = list(media.read_frames(tmp_path / "press.avi"))
    assert media.count_frames(tmp_path / "press.avi") == len(frames) == 8
    for index, frame in enumerate(frames):
        assert frame.index == index
        assert frame.image.shape == (48, 64)
        assert abs(int(frame.image[0, 0]) - 6 * index) <= 1
        assert frame.time_ms == pytest.approx(
            1e3 * index / media.frame_rate(tmp_path / "press.avi")
        )


def test_a_video_that_is_cut_off_gives_its_frames_and_marks_the_missing_ones(tmp_path, reader):
    write_video(tmp_path / "press.avi", brighter(40), "MJPG")
    whole = (tmp_path / "press.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) // 2])
    frames = list(media.read_frames(tmp_path / "cut.avi"))
    broken = [frame.index for frame in frames if frame.image is None]
    assert [frame.index for frame in frames] == list(range(40))
    assert 1 < len(broken) < 39
    assert broken == list(range(broken[0], 40))


class Dead:
    """A video or a camera that opens, promises a million frames and gives none."""

    def __init__(self, _):
        pass

    def isOpened(self):
        return True

    def get(self, what):
        return 1e6 if what == cv2.CAP_PROP_FRAME_COUNT else 0

    def read(self):
        return False, None

    def release(self):
        pass


def test_a_damaged_frame_is_none_and_those_after_it_are_read(tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed")
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


def test_frames_of_another_size_come_as_they_are(tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed")
    sizes = [(60, 80), (90, 120), (60, 80)]
    jpegs = [cv2.imencode(".jpg", np.full(size, 90, np.uint8))[1].tobytes() for size in sizes]
    (tmp_path / "press.mjpeg").write_bytes(b"".join(jpegs))
    frames = list(media.read_frames(tmp_path / "press.mjpeg"))
    assert [frame.image.shape for frame in frames] == sizes
    few = list(media.read_frames(tmp_path / "press.mjpeg", max_pixels=5000))
    assert [frame.image is None for frame in few] == [False, True, False]


def test_pyav_reads_12_bits_and_the_times_that_are_written(tmp_path):
    ramp = np.tile(np.arange(64, dtype=np.uint16) * 64, (48, 1))
    write_deep_video(tmp_path / "deep.mkv", ramp)
    frames = list(media.read_frames(tmp_path / "deep.mkv"))
    assert [frame.time_ms for frame in frames] == pytest.approx([0, 35, 110])
    assert frames[0].image.dtype == np.uint16
    np.testing.assert_array_equal(frames[0].image, ramp)
    assert media.full_scale(tmp_path / "deep.mkv") == 4095


def test_8_bits_have_no_full_scale_of_their_own(tmp_path, reader):
    write_video(tmp_path / "press.avi", brighter(8))
    assert media.full_scale(tmp_path / "press.avi") is None
    assert media.full_scale(tmp_path / "press.png") is None


def test_frames_that_never_come_are_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(media, "has_pyav", lambda: False)
    monkeypatch.setattr(cv2, "VideoCapture", Dead)
    (tmp_path / "dead.avi").write_bytes(b"")
    some = list(itertools.islice(media.read_frames(tmp_path / "dead.avi"), 2 * media.LONGEST_GAP))
    assert [frame.image for frame in some] == [None] * media.LONGEST_GAP


def test_a_file_that_is_no_video_is_an_image_error(tmp_path, reader):
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


def test_a_csv_has_units_in_its_header_and_every_digit_in_its_rows(tmp_path):
    corners = corners_at([[1.1, 2.2], [63.000004, 47]])
    name = 'a "b",\nc.png'
    with whole_file(tmp_path / "c.csv") as file:
        table = Table(file, CORNER_COLUMNS)
        table.write(name, 3, corner_rows(corners))
        assert table.rows == 2
    with open(tmp_path / "c.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[:6] == ["image", "frame", "x_px", "y_px", "pixel_x_px", "pixel_y_px"]
    assert list(rows[0])[6:9] == ["response", "method", "sigma_px"]
    assert list(rows[0])[9:] == [f"edge{i}_rad" for i in range(4)] + ["doubtful", "refusal"]
    for row, xy, pixel in zip(rows, corners.xy, corners.pixel, strict=True):
        assert (row["image"], row["frame"], row["method"]) == (name, "3", "EDGE_LINES")
        assert (np.float32(row["x_px"]), np.float32(row["y_px"])) == tuple(xy)
        assert (int(row["pixel_x_px"]), int(row["pixel_y_px"])) == tuple(pixel)
        assert np.isnan(float(row["sigma_px"]))


def test_a_name_that_is_no_text_does_not_stop_the_csv(tmp_path):
    with whole_file(tmp_path / "c.csv") as file:
        table = Table(file, CORNER_COLUMNS)
        table.write(os.fsdecode(b"\xff.png"), 0, corner_rows(corners_at([[1, 2]])))
    assert (tmp_path / "c.csv").read_text(encoding="utf-8").count("\n") == 2
