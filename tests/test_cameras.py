"""Frames of cameras and files have times, and are paired by them."""

import itertools
import math
import threading

import cv2
import numpy as np
import pytest
from videos import camera_of, write_video

from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.media import Frame
from cmp_cl.media.ahead import Ahead
from cmp_cl.media.cameras import Pairs, Source, paired


@pytest.mark.parametrize(
    ("left", "right", "expected", "alone"),
    [
        ([0, 20, 60, 80, 100], [8, 28, 48, 68, 108], [(0, 0), (1, 1), (2, 3), (4, 4)], (1, 1)),
        ([0, 20, 40, 60], [33, 53, 73, 93, 113], [(2, 0), (3, 1)], (2, 3)),
        ([math.nan] * 4, [math.nan] * 3, [(0, 0), (1, 1), (2, 2)], (1, 0)),  # no times: in turn
    ],
)
def test_pairs_are_the_nearest_and_the_others_come_alone(left, right, expected, alone):
    sides = (iter([Frame(i, None, t) for i, t in enumerate(times)]) for times in (left, right))
    found = list(paired(*sides, tolerance_ms=10.0))
    assert [(a.index, b.index) for a, b in found if a and b] == expected
    assert (sum(b is None for _, b in found), sum(a is None for a, _ in found)) == alone


def test_several_videos_have_no_clock_in_common(tmp_path):
    for number in range(2):
        write_video(tmp_path / f"{number}.avi", [np.zeros((48, 64), np.uint8)] * 2)
    source = Source(str(tmp_path))
    frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert all(math.isnan(frame.time_ms) for frame in frames)
    alone = Source(str(tmp_path / "0.avi"))
    assert [frame.time_ms for frame in alone.frames()] == [0, alone.period_ms]


@pytest.fixture
def pairs_of(tmp_path, monkeypatch):
    """Return pairs_of(left, right, rates): the pairs of two recordings that deliver such frames.

    A frame is (index, ms), with an image of 64 x 48 px, or (index, ms, its rows).
    """

    def of(left, right, rates=(25, 25)):
        told = {"a": left, "b": right}

        def timed(source):
            for index, time_ms, *rows in told[source.paths[0].stem]:
                yield Frame(index, np.zeros((*(rows or [48]), 64), np.uint8), time_ms)

        for name in told:
            write_video(tmp_path / f"{name}.avi", [np.zeros((48, 64), np.uint8)])
        sources = [Source(str(tmp_path / f"{name}.avi")) for name in told]
        for source, rate in zip(sources, rates, strict=True):
            source.period_ms = 1e3 / rate
        monkeypatch.setattr(Source, "timed", timed)
        return Pairs(*sources)

    return of


def test_frames_of_a_pair_are_at_most_half_an_interval_apart(pairs_of):
    pairs = pairs_of(*([(0, time) for time in times] for times in ([0, 40, 80], [5, 61, 85])))
    assert [frame.time_ms for frame in pairs.frames()] == [0, 80]
    assert pairs.alone == [1, 1]


@pytest.mark.parametrize(
    ("left", "right", "rates", "missing"),
    [
        ([0, 1, 2, 3, 4, 5], [0, 1, 5], (25, 25), [2, 3, 4]),
        ([0, 1, 5], [0, 1, 5], (25, 25), [2, 3, 4]),  # a busy computer loses both
        ([0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 3], (50, 25), []),  # one camera is twice as fast
        ([0, 1, 2, 3, 4, 5, 6], [0, 1, 3], (50, 25), [2]),
    ],
)
def test_pairs_that_are_missing_are_frames_without_an_image(pairs_of, left, right, rates, missing):
    recorded = zip((left, right), rates, strict=True)
    pairs = pairs_of(*([(i, i * 1e3 / rate) for i in numbers] for numbers, rate in recorded), rates)
    frames = list(pairs.frames())
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert [frame.index for frame in frames if frame.image is None] == missing


def test_views_of_two_sizes_are_told_and_the_others_come(pairs_of):
    first, other, last = pairs_of(
        [(0, 0), (1, 40), (2, 80)], [(0, 0), (1, 40, 24), (2, 80)]
    ).frames()
    assert first.image is not None
    assert last.image is not None
    assert other.image is None
    assert "left view is 64 x 48 px of uint8, the right one 64 x 24" in other.why
    assert "bring them to one size and kind, in the calibration too" in other.why


def test_images_of_one_number_that_are_not_paired_are_refused(tmp_path):
    def source(name, numbers):
        (tmp_path / name).mkdir()
        for number in numbers:
            cv2.imwrite(str(tmp_path / name / f"{name}{number}.png"), np.zeros((4, 6), np.uint8))
        return Source(str(tmp_path / name))

    left = source("left", [0, 1, 3, 4, 5])
    with pytest.raises(ConfigError, match=r"left3.png and right2.png would be a pair"):
        Pairs(left, source("right", [0, 1, 2, 3, 5]))
    for other in (source("same", [0, 1, 3, 4, 5]), source("later", range(10, 15))):
        assert len(list(Pairs(left, other).frames())) == 5


SHADES = [np.full((4, 6, 3), level, np.uint8) for level in range(1, 11)]


@pytest.mark.parametrize("name", ["7", "/dev/video3", "rtsp://camera/stream"])
def test_cameras_and_addresses_are_live_and_lose_no_frame(monkeypatch, name):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(SHADES))
    source = Source(name, {"frame_width": 6, "frame_height": 4, "fps": "50", "fourcc": "MJPG"})
    frames = list(source.frames())
    assert source.live
    assert source.period_ms == 20
    assert [frame.index for frame in frames] == list(range(10))
    assert frames[3].image[0, 0] == 4
    assert all(a.time_ms <= b.time_ms for a, b in itertools.pairwise(frames))


def test_frames_that_a_camera_misses_are_counted_and_have_no_image(monkeypatch):
    images = [None if number in (0, 3) else each for number, each in enumerate(SHADES)]
    images[4] = cv2.error("the JPEG of this frame is damaged")
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images))
    frames = list(Source("7").frames())
    assert [frame.index for frame in frames] == list(range(10))
    missed = [frame.index for frame in frames if frame.image is None]
    assert missed == [0, 3, 4]
    assert [frame.index for frame in frames if math.isnan(frame.time_ms)] == missed
    assert frames[1].time_ms == 0
    assert frames[-1].time_ms < 1e4


def test_frames_that_come_faster_than_they_are_taken_are_counted(monkeypatch):
    def images():
        yield from SHADES * 30
        over.set()

    over = threading.Event()
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images()))
    coming = Source("0").frames()
    first = next(coming)
    assert over.wait(10)
    frames = [first, *coming]
    assert [frame.index for frame in frames] == list(range(300))
    assert all(frame.image is not None for frame in frames[-60:])
    assert sum(frame.image is None for frame in frames) >= 200


def test_what_a_thread_has_made_comes_before_its_error_and_closing_ends_it():
    made, go_on = [], threading.Event()

    def items(last):
        for number in range(last):
            made.append(number)
            yield number
            if number == 1:
                go_on.wait(10)
        raise OSError("gone")

    go_on.set()
    with Ahead(items(3), 2, lossy=True) as made_ahead:
        while not made_ahead.ended:
            made_ahead.wait(0.01)
        assert [made_ahead.take(0) for _ in range(2)] == [1, 2]
        with pytest.raises(OSError, match="gone"):
            made_ahead.wait(0)
    go_on.clear()
    made.clear()
    with Ahead(items(10**9), 2, lossy=True) as made_ahead:
        while len(made) < 2:
            made_ahead.wait(0.01)
        threading.Timer(0.1, go_on.set).start()
    count = len(made)
    assert count <= 3
    assert made_ahead.ended


def test_what_a_camera_does_not_do_is_reported(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(SHADES))
    with pytest.raises(ImageError, match="exposure"):
        next(Source("0", {"exposure": 3}).frames())
    with pytest.raises(ConfigError, match="not a camera"):
        Source(__file__, {"fps": 50})
    for wrong in ({"rate": 50}, {"fps": "fast"}, {"fourcc": "MJ"}):
        with pytest.raises(ConfigError, match=r"a camera takes no setting (rate|fps|fourcc)="):
            Source("0", wrong)
    with pytest.raises(FileNotFoundError):
        Source("gone.mp4")
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([np.zeros((4, 6, 2), np.uint8)]))
    with pytest.raises(ImageError, match=r"\(4, 6, 2\), neither grey nor BGR"):
        list(Source("0").frames())
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([None]))
    assert list(Source("0").frames()) == []
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([]))
    with pytest.raises(ImageError, match=r"no camera rtsp://a/b that"):
        next(Source("rtsp://a/b").frames())


def test_a_number_that_no_camera_can_have_is_no_camera():
    with pytest.raises(ImageError, match="no camera 99999999999"):
        next(Source("99999999999").frames())
