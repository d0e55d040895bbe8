"""Frames of cameras and files have times, and are paired by them."""

import itertools
import math
import threading

import cv2
import numpy as np
import pytest
from videos import write_video

from cmp_cl.cameras import CameraSettings, PairCount, Source, paired
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.media import Frame


def pairs_of(left, right, tolerance=10.0):
    """Return indices of the pairs of frames at these times, ms, and the count."""
    count = PairCount()
    sides = (iter([Frame(i, None, t) for i, t in enumerate(times)]) for times in (left, right))
    found = [(a.index, b.index) for a, b in paired(*sides, tolerance_ms=tolerance, count=count)]
    return found, (count.pairs, count.left_alone, count.right_alone)


def test_frames_of_one_clock_are_all_paired():
    left = np.arange(50) * 20.0
    found, count = pairs_of(left, left + np.random.default_rng(1).normal(0, 2, 50))
    assert found == [(i, i) for i in range(50)]
    assert count == (50, 0, 0)


def test_a_lost_frame_loses_only_its_own_pair_and_is_counted():
    left = [0, 20, 60, 80, 100.0]
    right = [1, 21, 41, 61, 101.0]
    found, count = pairs_of(left, right)
    assert found == [(0, 0), (1, 1), (2, 3), (4, 4)]
    assert count == (4, 1, 1)


def test_the_nearer_one_of_two_is_taken():
    found, count = pairs_of([0, 9.0, 40], [10.0, 41], tolerance=15)
    assert found == [(1, 0), (2, 1)]
    assert count == (2, 1, 0)


def test_frames_before_and_after_the_other_recording_are_counted():
    found, count = pairs_of([0, 20, 40, 60.0], [40, 60, 80, 100, 120.0])
    assert found == [(2, 0), (3, 1)]
    assert count == (2, 2, 3)


def test_frames_without_times_are_paired_in_turn():
    found, count = pairs_of([math.nan] * 3, [math.nan] * 4)
    assert found == [(0, 0), (1, 1), (2, 2)]
    assert count == (3, 0, 1)


def test_no_frame_is_lost_between_two_recordings_with_jitter():
    rng = np.random.default_rng(2)
    for _ in range(20):
        kept = rng.random((2, 200)) > 0.1
        times = np.arange(200) * 20.0
        sides = [times[keep] + rng.uniform(-3, 3, keep.sum()) for keep in kept]
        _, (pairs, left, right) = pairs_of(*sides)
        assert pairs == np.count_nonzero(kept.all(axis=0))
        assert (pairs + left, pairs + right) == (len(sides[0]), len(sides[1]))


def test_folders_have_no_times_and_broken_images_are_frames(tmp_path):
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((8, 8), number, np.uint8))
    (tmp_path / "1.png").write_bytes(b"broken")
    source = Source(str(tmp_path))
    frames = list(source.frames())
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert math.isnan(frames[0].time_ms)
    assert not source.live


def test_several_videos_have_no_clock_in_common(tmp_path):
    for number in range(2):
        write_video(tmp_path / f"{number}.avi", [np.zeros((48, 64), np.uint8)] * 2)
    source = Source(str(tmp_path))
    assert source.total == 4
    frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert all(math.isnan(frame.time_ms) for frame in frames)
    alone = Source(str(tmp_path / "0.avi"))
    assert [frame.time_ms for frame in alone.frames()] == [0, alone.period_ms]


class Capture:
    """A camera that gives ten frames and rejects an exposure."""

    def __init__(self, _):
        self.left, self.set_to = 10, {}

    def isOpened(self):
        return True

    def set(self, key, value):
        self.set_to[key] = value
        return key != cv2.CAP_PROP_EXPOSURE

    def read(self):
        self.left -= 1
        return (self.left >= 0), np.full((4, 6, 3), max(10 - self.left, 0) % 256, np.uint8)

    def release(self):
        pass


@pytest.mark.parametrize("name", ["7", "/dev/video3", "rtsp://camera/stream"])
def test_cameras_and_addresses_are_live_and_lose_no_frame(monkeypatch, name):
    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Capture)
    source = Source(name, CameraSettings(size=(6, 4), fps=50, fourcc="MJPG"))
    frames = list(source.frames())
    assert source.live
    assert source.period_ms == 20
    assert [frame.index for frame in frames] == list(range(10))
    assert frames[3].image[0, 0] == 4
    assert all(a.time_ms <= b.time_ms for a, b in itertools.pairwise(frames))


@pytest.mark.parametrize("name", ["7", "/dev/video3"])
@pytest.mark.parametrize("settings", [CameraSettings(), CameraSettings(fps=50)])
def test_frames_that_a_camera_misses_are_counted_and_have_no_image(monkeypatch, name, settings):
    class Missing(Capture):
        def read(self):
            read, image = super().read()
            return read and self.left not in (9, 6, 5), image

    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Missing)
    frames = list(Source(name, settings, from_start=True).frames())
    assert [frame.index for frame in frames] == list(range(10))
    missed = [frame.index for frame in frames if frame.image is None]
    assert missed == [0, 3, 4]
    assert [frame.index for frame in frames if math.isnan(frame.time_ms)] == missed
    assert frames[1].time_ms == 0


def test_frames_that_come_faster_than_they_are_taken_are_counted(monkeypatch):
    class Fast(Capture):
        def __init__(self, _):
            super().__init__(_)
            self.left = 100

        def read(self):
            read, image = super().read()
            if not read:
                over.set()
            return read, image

    over = threading.Event()
    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Fast)
    coming = Source("0").frames()
    first = next(coming)
    assert over.wait(10)
    frames = [first, *coming]
    assert [frame.index for frame in frames] == list(range(100))
    assert all(frame.image is not None for frame in frames[-60:])
    assert sum(frame.image is None for frame in frames) >= 30


def test_pixels_that_are_neither_grey_nor_bgr_end_a_camera_with_an_error(monkeypatch):
    class Packed(Capture):
        def read(self):
            return True, np.zeros((4, 6, 2), np.uint8)

    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Packed)
    with pytest.raises(ImageError, match=r"\(4, 6, 2\), neither grey nor BGR"):
        list(Source("0").frames())


def test_a_camera_that_gives_nothing_has_no_frames(monkeypatch):
    monkeypatch.setattr(Capture, "read", lambda _: (False, None))
    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Capture)
    assert list(Source("0").frames()) == []


def test_a_setting_that_a_camera_does_not_take_is_reported(monkeypatch):
    monkeypatch.setattr("cmp_cl.cameras.cv2.VideoCapture", Capture)
    with pytest.raises(ImageError, match="exposure"):
        next(Source("0", CameraSettings(exposure=3)).frames())
    for wrong in ({"fourcc": "MJ"}, {"size": (0, 3)}, {"fps": -1}):
        with pytest.raises(ConfigError):
            CameraSettings(**wrong)
    with pytest.raises(FileNotFoundError):
        Source("gone.mp4")
