"""Frames with their times from files and cameras, and pairs of frames from two of these.

The time of a frame of a video is that in its container. The time of a camera's frame is that of
its arrival: a thread reads a camera, so that frames do not wait in the driver.
"""

import contextlib
import dataclasses
import itertools
import math
import queue
import re
import threading
import time
from collections.abc import Generator, Iterator
from numbers import Real
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, ImageError, as_size, check_kind, check_positive
from cmp_cl.image import GreyImage
from cmp_cl.media.images import find_inputs
from cmp_cl.media.videos import LONGEST_GAP, Frame, VideoInfo, read_frames, video_info

_WAITING = 64  # the most frames of a camera that wait to be measured
_LONGEST_WAIT = 10.0  # s, the longest wait for a frame of a camera
_DEVICES = Path("/dev")  # where Linux has its cameras

_Queue = queue.Queue[Frame | ImageError | None]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CameraSettings:
    """The settings requested of a camera; None leaves a setting as it is.

    size: (width, height), px. fps: frames per second. exposure: in the driver's own unit.
    fourcc: pixel format of four letters, such as GREY, MJPG, YUYV, or Y16 and a space.
    """

    size: tuple[int, int] | None = None
    fps: float | None = None
    exposure: float | None = None
    fourcc: str | None = None

    def __post_init__(self) -> None:
        if self.fourcc is not None and not (isinstance(self.fourcc, str) and len(self.fourcc) == 4):
            raise ConfigError(f"a pixel format has four letters, such as MJPG, not {self.fourcc!r}")
        if self.size is not None:
            as_size("size", self.size, ConfigError)
        if self.fps is not None:
            check_positive("fps", self.fps, ConfigError)
        if self.exposure is not None:
            check_kind("exposure", self.exposure, Real, ConfigError)


def is_live(name: str) -> bool:
    """Return whether a name is a camera's number, a device such as /dev/video0, or an address.

    Raises ConfigError if it is no text.
    """
    check_kind("name", name, str, ConfigError)
    number = name.isascii() and name.isdigit() and not Path(name).exists()
    return number or re.match(r"/dev/video|[a-z][a-z0-9+.-]*://", name) is not None


class Source:
    """The source of frames.

    name: a file, a folder of images, the number of a camera, a device such as
    /dev/video0, or an address such as rtsp://camera/stream.

    settings: those to request of a camera, or None.
    live: whether it is a camera or a stream, whose frames arrive whether or not they are read.
    paths: the files, () of a live source. period_ms: time between frames, NaN if unknown.
    full_scale: largest grey level, None if unknown. total: how many frames, or how many files if
    there are several; None if unknown.
    from_start: whether times of a camera count from its first frame; else two of them
        have one clock, and can be paired.

    Raises ConfigError for a name or settings of another type, and FileNotFoundError and ImageError
    as `cmp_cl.media` does.
    """

    def __init__(
        self,
        name: str,
        settings: CameraSettings | None = None,
        *,
        from_start: bool = False,
    ) -> None:
        self.name = name
        self._from_start = from_start
        self._settings = CameraSettings() if settings is None else settings
        check_kind("settings", self._settings, CameraSettings, ConfigError)
        self.live = is_live(name)
        self._opened_as: int | str = int(name) if self.live and name.isdigit() else name
        self.paths = () if self.live else tuple(find_inputs([name]))
        info = VideoInfo(rate=self._settings.fps) if self.live else VideoInfo()
        if len(self.paths) == 1:
            info = video_info(self.paths[0])
        self.full_scale = info.full_scale
        self.total = len(self.paths) if len(self.paths) > 1 else info.frames
        self.period_ms = 1e3 / info.rate if info.rate else math.nan

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all frames in turn, those that cannot be read or are missed without an image.

        A live source ends after 10 s, or 250 reads, without a frame. Frames of several videos have
        no times. Raises ImageError if the source cannot be read.
        """
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
        capture = self._capture()
        waiting: _Queue = queue.Queue(_WAITING)
        done = threading.Event()
        thread = threading.Thread(target=_read, args=(capture, waiting, done), daemon=True)
        thread.start()
        index, zero = 0, None if self._from_start else 0.0
        try:
            while True:
                try:
                    frame = waiting.get(timeout=_LONGEST_WAIT)
                except queue.Empty:
                    return
                if isinstance(frame, ImageError):
                    raise frame
                if frame is None:
                    return
                for missed in range(index, frame.index):
                    yield Frame(missed, None)
                zero = frame.time_ms if zero is None else zero
                yield Frame(frame.index, frame.image, frame.time_ms - zero)
                index = frame.index + 1
        finally:
            done.set()
            thread.join(timeout=_LONGEST_WAIT)
            if not thread.is_alive():
                capture.release()

    def _capture(self) -> Any:
        capture = cv2.VideoCapture(self._opened_as)
        if not capture.isOpened():
            raise ImageError(
                f"there is no camera {self.name} that OpenCV can open; {_cameras_here()}"
            )
        asked: list[tuple[int, float | None, str]] = [
            (cv2.CAP_PROP_FRAME_WIDTH, self._settings.size and self._settings.size[0], "width"),
            (cv2.CAP_PROP_FRAME_HEIGHT, self._settings.size and self._settings.size[1], "height"),
            (cv2.CAP_PROP_FPS, self._settings.fps, "fps"),
            (cv2.CAP_PROP_EXPOSURE, self._settings.exposure, "exposure"),
        ]
        if self._settings.fourcc is not None:
            code = cv2.VideoWriter.fourcc(*self._settings.fourcc)
            asked.insert(0, (cv2.CAP_PROP_FOURCC, float(code), "pixel format"))
            if self._settings.fourcc in ("Y16 ", "GREY"):
                asked.append((cv2.CAP_PROP_CONVERT_RGB, 0.0, "raw pixels"))
        for key, value, what in asked:
            if value is not None and not capture.set(key, value):
                capture.release()
                raise ImageError(f"the camera {self.name!r} does not take this {what}: {value:g}")
        return capture


def _read(capture: Any, waiting: _Queue, done: threading.Event) -> None:
    """Queue every frame of a camera as it arrives; an error or None marks the end.

    The number of a read without a frame is missing; if too many wait, so is that of the oldest.
    """
    index = gap = 0
    end: ImageError | None = None
    while not done.is_set() and gap < LONGEST_GAP and end is None:
        read, picture = capture.read()
        now = time.monotonic() * 1e3
        gap = 0 if read else gap + 1
        if read:
            if waiting.full():
                with contextlib.suppress(queue.Empty):
                    waiting.get_nowait()
            try:
                waiting.put(Frame(index, grey_of(picture), now))
            except ImageError as error:
                end = error
        index += 1
    while not done.is_set():
        with contextlib.suppress(queue.Full):
            waiting.put(end, timeout=0.1)
            return


def grey_of(frame: NDArray[Any]) -> GreyImage:
    """Return a frame that OpenCV captured, in BGR or raw, as (H, W); raises ImageError."""
    if frame.ndim == 3 and frame.shape[2] == 3:
        return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    if frame.size != math.prod(frame.shape[:2]):
        raise ImageError(f"OpenCV delivers frames of shape {frame.shape}, neither grey nor BGR")
    return np.ascontiguousarray(frame.reshape(frame.shape[:2]))


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


def _cameras_here() -> str:
    """Return which cameras there are, as far as the folder of devices tells."""
    devices = sorted(str(path) for path in _DEVICES.glob("video*"))
    if not devices:
        return "none is seen in /dev: connect one, or check its driver and its permissions"
    return f"{', '.join(devices)} can be given, if no other program has it open"
