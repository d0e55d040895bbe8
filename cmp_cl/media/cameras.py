"""Frames with their times from files and cameras, and pairs of frames from two of these.

The time of a frame of a video is that in its container. The time of a camera's frame is that of
its arrival: a thread reads a camera, so that frames do not wait in the driver.
"""

import contextlib
import dataclasses
import itertools
import math
import re
import time
from collections.abc import Generator, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.image import GreyImage
from cmp_cl.media.ahead import Ahead
from cmp_cl.media.images import find_inputs, numbers_of
from cmp_cl.media.videos import LONGEST_GAP, Frame, VideoInfo, read_frames, video_info

_LONGEST_WAIT = 10.0  # s, the longest wait for a frame of a camera
_EARLY = 0.1  # of a pair: a step this much shorter is one of it
_PAIR_WITHIN = 20.0  # ms, between frames that are paired if their interval is unknown


def is_live(name: str) -> bool:
    """Return whether a name is a camera's number, a device such as /dev/video0, or an address.

    Raises ConfigError if it is no text.
    """
    if not isinstance(name, str):
        raise ConfigError(f"a source is named by a text such as '0' or 'press.mp4', not {name!r}")
    number = name.isascii() and name.isdigit() and not Path(name).exists()
    return number or re.match(r"/dev/video|[a-z][a-z0-9+.-]*://", name) is not None


class Source:
    """The source of frames.

    name: a file, a folder of images, the number of a camera, a device such as
    /dev/video0, or an address such as rtsp://camera/stream.

    settings: what to ask of a camera, by OpenCV's names of properties: fps is CAP_PROP_FPS. A value
        is a number, or a text of one; fourcc, the format of pixels, is four letters such as MJPG.
    waiting: how many frames of a camera wait to be taken; older ones are missed.
    live: whether it is a camera or a stream, whose frames arrive whether or not they are read.
    paths: the files, () of a live source. period_ms: time between frames, NaN if unknown.
    full_scale: largest grey level, None if unknown.

    Raises ConfigError for a name of another type, or settings for a file; FileNotFoundError and
    ImageError as `cmp_cl.media` does.
    """

    def __init__(
        self, name: str, settings: Mapping[str, float | str] | None = None, *, waiting: int = 64
    ) -> None:
        self.name = name
        self._waiting = waiting
        self.live = is_live(name)
        asked = {what.lower(): value for what, value in (settings or {}).items()}
        self._settings = {what: _asked(what, value) for what, value in asked.items()}
        if self._settings and not self.live:
            raise ConfigError(f"{name!r} is not a camera, so it takes no camera settings")
        self._opened_as: int | str = int(name) if self.live and name.isdigit() else name
        self.paths = () if self.live else tuple(find_inputs([name]))
        info = video_info(self.paths[0]) if len(self.paths) == 1 else VideoInfo()
        self.full_scale = info.full_scale
        rate = self._settings["fps"][1] if "fps" in self._settings else info.rate
        self.period_ms = 1e3 / rate if rate else math.nan

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all frames in turn, those that cannot be read or are missed without an image.

        Times of a live source count from its first frame; it ends after 10 s, or 250 reads, without
        a frame. Frames of several videos have no times. Raises ImageError if the source cannot be
        read.
        """
        with contextlib.closing(self.timed()) as frames:
            yield from _from_first(frames) if self.live else frames

    def timed(self) -> Generator[Frame, None, None]:
        """Yield the frames as `frames` does, but those of all live sources with one clock."""
        return self._live_frames() if self.live else self._file_frames()

    def _file_frames(self) -> Generator[Frame, None, None]:
        numbers = itertools.count()
        for path in self.paths:
            try:
                for each in read_frames(path):
                    time_ms = each.time_ms if len(self.paths) == 1 else math.nan
                    yield Frame(next(numbers), each.image, time_ms, each.why)
            except ImageError as error:
                if len(self.paths) == 1:
                    raise
                yield Frame(next(numbers), None, why=str(error))

    def _live_frames(self) -> Generator[Frame, None, None]:
        index = 0
        with Ahead(_captured(self._capture()), self._waiting, lossy=True) as waiting:
            while (frame := waiting.take(_LONGEST_WAIT)) is not None:
                for missed in range(index, frame.index):
                    why = "the camera did not deliver it, or frames come faster than they are taken"
                    yield Frame(missed, None, why=why)
                yield frame
                index = frame.index + 1

    def _capture(self) -> Any:
        capture = None
        with contextlib.suppress(cv2.error):  # of a number that no camera can have
            capture = cv2.VideoCapture(self._opened_as)
        if capture is None or not capture.isOpened():
            raise ImageError(
                f"there is no camera {self.name} that OpenCV can open: check its number or "
                "address, its permissions, and that no other program has it open"
            )
        for what, (key, value) in self._settings.items():
            if not capture.set(key, value):
                capture.release()
                raise ImageError(f"the camera {self.name!r} does not take {what}={value:g}")
        return capture


def _asked(what: str, value: float | str) -> tuple[int, float]:
    """Return a setting as OpenCV takes it; raises ConfigError."""
    key = getattr(cv2, f"CAP_PROP_{what.upper()}", None)
    if key is not None and what == "fourcc" and isinstance(value, str) and len(value) == 4:
        return key, cv2.VideoWriter.fourcc(*value)
    with contextlib.suppress(TypeError, ValueError):
        if key is not None:
            return key, float(value)
    raise ConfigError(
        f"a camera takes no setting {what}={value!r}; frame_width=1280 and fourcc=MJPG are some"
    )


def _captured(capture: Any) -> Generator[Frame, None, None]:
    """Yield every frame of a camera as it arrives; the number of a read without one is missing."""
    index = gap = 0
    try:
        while gap < LONGEST_GAP:
            read = False
            with contextlib.suppress(cv2.error):  # of a frame that is damaged on its way
                read, picture = capture.read()
            now = time.monotonic() * 1e3
            if read:
                if picture.ndim == 3 and picture.shape[2] == 3:
                    picture = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
                if picture.size != math.prod(picture.shape[:2]):
                    shape = picture.shape
                    raise ImageError(f"OpenCV delivers frames of {shape}, neither grey nor BGR")
                yield Frame(index, np.ascontiguousarray(picture.reshape(picture.shape[:2])), now)
            gap = 0 if read else gap + 1
            index += 1
    finally:
        capture.release()


def _from_first(frames: Iterable[Frame]) -> Iterator[Frame]:
    """Yield frames with times from the first one that has an image."""
    start = math.nan
    for frame in frames:
        start = frame.time_ms if math.isnan(start) else start
        yield dataclasses.replace(frame, time_ms=frame.time_ms - start)


def paired(
    left: Iterator[Frame], right: Iterator[Frame], *, tolerance_ms: float, endless: bool = False
) -> Iterator[tuple[Frame | None, Frame | None]]:
    """Yield the frames of two sources side by side; one without a partner comes with None.

    left, right: the frames of each source. Two frames are partners if their times differ by at most
    tolerance_ms, half the time between frames. Frames without a time are paired in order; so are
    all if the tolerance is NaN. endless: whether the sources are live; if not, frames after the end
    of the other side come too.
    """
    one, two = next(left, None), next(right, None)
    while one is not None and two is not None:
        off = one.time_ms - two.time_ms
        if off < -tolerance_ms:
            yield one, None
            one = next(left, None)
        elif off > tolerance_ms:
            yield None, two
            two = next(right, None)
        else:
            yield one, two
            one, two = next(left, None), next(right, None)
    if not endless:
        yield from ((frame, None) for frame in itertools.chain([one] if one else [], left))
        yield from ((None, frame) for frame in itertools.chain([two] if two else [], right))


class Pairs:
    """Frames of two sources side by side, left and right, paired by their times.

    Frames of a pair are at most half the interval between frames apart. Those of images, which have
    no times, are paired in order.

    The attributes that it shares with `Source` mean the same for pairs. alone: frames of each side
    that had no partner so far. after: those of them after the last pair. Raises ConfigError if the
    sources do not go together.
    """

    def __init__(self, left: Source, right: Source) -> None:
        if left.live != right.live:
            raise ConfigError("left and right must both be files or both be cameras")
        counts = len(left.paths), len(right.paths)
        if max(counts) > 1 and counts[0] != counts[1]:
            raise ConfigError(
                f"left has {counts[0]} files and right {counts[1]}: images have no times by "
                "which they could be paired; leave out those without a partner"
            )
        numbers = numbers_of(left.paths), numbers_of(right.paths)
        if numbers[0] != numbers[1] and not set(numbers[0]).isdisjoint(numbers[1]):
            at = next(i for i, (one, two) in enumerate(zip(*numbers, strict=True)) if one != two)
            raise ConfigError(
                f"{left.paths[at].name} and {right.paths[at].name} would be a pair, though both "
                "sides have files of one number; leave out those without a partner"
            )
        self._sides = left, right
        self.name = f"{left.name}, {right.name}"
        self.live, self.full_scale = left.live, left.full_scale
        self.paths = (*left.paths, *right.paths)
        periods = [side.period_ms for side in self._sides if math.isfinite(side.period_ms)]
        self.period_ms = max(periods, default=math.nan)
        self._within = min(periods) / 2 if periods else _PAIR_WITHIN
        known = len(periods) == len(self._sides)
        self._in_a_pair = [max(periods) / each for each in periods] if known else [1.0, 1.0]
        self.alone, self.after = [0, 0], [0, 0]

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all pairs, from the first; one that cannot be read, and one that is missing between
        two others, as a side has no frame, has no image."""
        self.alone, self.after = [0, 0], [0, 0]
        with contextlib.ExitStack() as stack:
            sides = [stack.enter_context(contextlib.closing(s.timed())) for s in self._sides]
            yield from _from_first(self._paired(*sides))

    def _paired(self, left: Iterator[Frame], right: Iterator[Frame]) -> Iterator[Frame]:
        number, before = 0, None
        left, right = (
            (each for each in side if each.image is not None or not self.live)
            for side in (left, right)
        )
        for one, two in paired(left, right, tolerance_ms=self._within, endless=self.live):
            if one is None or two is None:
                self.alone[one is None] += 1
                self.after[one is None] += 1
                continue
            self.after = [0, 0]
            for _ in range(self._missing(before, (one.index, two.index))):
                yield Frame(number, None, why="a view has no frame then")
                number += 1
            yield _of_both(number, one, two)
            number, before = number + 1, (one.index, two.index)

    def _missing(self, before: tuple[int, int] | None, now: tuple[int, int]) -> int:
        """Return how many pairs are missing between two others, by the numbers of their frames."""
        steps = zip(now, before or now, self._in_a_pair, strict=True)
        return max(int((then - first) / in_a_pair + _EARLY) for then, first, in_a_pair in steps) - 1


def _of_both(number: int, one: Frame, two: Frame) -> Frame:
    """Return the frame of a pair, without an image if one side has none or they differ in kind."""
    if one.image is None or two.image is None:
        return Frame(number, None, one.time_ms, one.why or two.why)
    left, right = (f"{i.shape[1]} x {i.shape[0]} px of {i.dtype}" for i in (one.image, two.image))
    if left != right:
        why = (
            f"the left view is {left}, the right one {right}; bring them to one size and kind, in "
            "the calibration too"
        )
        return Frame(number, None, one.time_ms, why)
    return Frame(number, cast(GreyImage, np.hstack([one.image, two.image])), one.time_ms)
