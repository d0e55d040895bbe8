"""The sources of `cmp-cl run`: their options, two of them side by side, and the frame at rest."""

import argparse
import contextlib
import re
from collections.abc import Generator
from typing import Any

import numpy as np

from cmp_cl.cli.arguments import positive_number
from cmp_cl.cli.messages import counted, in_shell, shown
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.media.cameras import CameraSettings, Source, paired

_PAIR_WITHIN = 20.0  # ms, between frames that are paired if their interval is unknown


def add_arguments(group: Any) -> None:
    """Add SOURCE, --stereo, --left and --right to a group of an argparse parser."""
    group.add_argument(
        "source",
        metavar="SOURCE",
        nargs="?",
        help="video, folder of images, image, number of a camera, device such as "
        "/dev/video0, or address such as rtsp://camera/stream",
    )
    group.add_argument(
        "--stereo",
        metavar="YAML",
        help="the calibration of two views; SOURCE shows both in each frame",
    )
    group.add_argument(
        "--left", metavar="SOURCE", help="with --stereo: the left view, in place of SOURCE"
    )
    group.add_argument("--right", metavar="SOURCE", help="the right view")


def add_camera_arguments(group: Any) -> None:
    """Add the settings of a camera to a group of an argparse parser."""
    group.add_argument(
        "--camera-size", metavar="WIDTHxHEIGHT", type=_camera_size, help="size of the frames, px"
    )
    group.add_argument(
        "--camera-fps", metavar="FPS", type=positive_number, help="frames per second"
    )
    group.add_argument(
        "--exposure", metavar="VALUE", type=float, help="exposure time, in the driver's units"
    )
    group.add_argument(
        "--pixel-format", metavar="FOUR", help="four letters, such as GREY, MJPG, YUYV"
    )


def _camera_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(match[1]), int(match[2])


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if the options do not name one source, or two."""
    two = arguments.left is not None or arguments.right is not None
    if two == (arguments.source is not None):
        raise ConfigError("give SOURCE, or --left and --right")
    if two and (arguments.left is None or arguments.right is None or arguments.stereo is None):
        raise ConfigError("--left and --right need each other, and --stereo")
    if two and (arguments.split or arguments.mirror):
        raise ConfigError("--split and --mirror are for frames that show both views")


class Pairs:
    """Frames of two sources side by side, left and right, paired by their times.

    Frames of a pair are at most half the interval between frames apart.

    The attributes that it shares with `Source` mean the same for pairs.
    """

    total: int | None = None

    def __init__(self, arguments: argparse.Namespace, camera: CameraSettings) -> None:
        self._sides = [Source(name, camera) for name in (arguments.left, arguments.right)]
        left, right = self._sides
        if left.live != right.live:
            raise ConfigError("--left and --right must both be files or both be cameras")
        counts = len(left.paths), len(right.paths)
        if max(counts) > 1 and counts[0] != counts[1]:
            raise ConfigError(
                f"--left has {counted(counts[0], 'file')} and --right {counts[1]}: images have no "
                "times by which they could be paired; leave out those without a partner"
            )
        self.name = f"{left.name}, {right.name}"
        self.live, self.full_scale = left.live, left.full_scale
        self.paths = (*left.paths, *right.paths)
        periods = [side.period_ms for side in self._sides if np.isfinite(side.period_ms)]
        self.period_ms = max(periods, default=np.nan)
        self._within = min(periods) / 2 if periods else _PAIR_WITHIN
        self._alone = [0, 0]  # frames of each side without a partner

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all pairs, from the first; one that cannot be read has no image.

        A frame that a camera missed has no time, and is not paired.
        """
        self._alone = [0, 0]
        number, start = 0, None
        with contextlib.ExitStack() as stack:
            sides = [stack.enter_context(contextlib.closing(s.frames())) for s in self._sides]
            left_frames, right_frames = (
                (each for each in side if each.image is not None or not self.live) for side in sides
            )
            for left, right in paired(
                left_frames, right_frames, tolerance_ms=self._within, endless=self.live
            ):
                if left is None or right is None:
                    self._alone[left is None] += 1
                    continue
                start = left.time_ms if start is None else start
                both = _side_by_side(left.image, right.image)
                yield Frame(number, both, left.time_ms - start)
                number += 1

    def alone(self) -> str:
        """Return how many frames had no partner, as text; "" if all had one."""
        left, right = self._alone
        return f"; {left} left and {right} right frames without a partner" if left + right else ""


def opened(arguments: argparse.Namespace) -> Source | Pairs:
    """Open the source; raises ConfigError if camera settings are given for a file."""
    camera = CameraSettings(
        size=arguments.camera_size,
        fps=arguments.camera_fps,
        exposure=arguments.exposure,
        fourcc=arguments.pixel_format,
    )
    source = (
        Source(arguments.source, camera, from_start=True)
        if arguments.left is None
        else Pairs(arguments, camera)
    )
    if camera != CameraSettings() and not source.live:
        raise ConfigError(f"{shown(source.name)} is not a camera, so it takes no camera settings")
    return source


def at_rest(source: Source | Pairs, number: int) -> tuple[GreyImage, Generator[Frame, None, None]]:
    """Return the frame at rest of that number, and the frames to measure.

    Those of a camera begin with the frame at rest; those of a file are all its frames. Raises
    ConfigError if the frame cannot be read or does not exist.
    """
    frames, count = source.frames(), 0
    for frame in frames:
        count = frame.index + 1
        if frame.index < number:
            continue
        if frame.image is None:
            raise ConfigError(
                f"--rest-frame {number} cannot be read; choose another one{_because(frame)}"
            )
        if source.live:
            return frame.image, _chained(frame, frames)
        frames.close()
        return frame.image, source.frames()
    if not count:
        raise ConfigError(f"no frame comes from {source.name!r}")
    raise ConfigError(
        f"there is no --rest-frame {number}: {shown(source.name)} has {counted(count, 'frame')}, "
        "numbered from 0"
    )


def why_left_out(frame: Frame, rest: GreyImage, *, live: bool) -> str:
    """Return why a frame is not measured, as text; live: whether it comes from a camera."""
    if frame.image is None and live:
        return (
            f"frame {frame.index} is missing: the camera did not deliver it, or frames come faster "
            "than they are measured"
        )
    if frame.image is None:
        return f"frame {frame.index} cannot be read and is skipped{_because(frame)}"
    rows, columns = frame.image.shape
    return (
        f"frame {frame.index} is {columns} x {rows} px of {frame.image.dtype}, the frame at rest "
        f"is {rest.shape[1]} x {rest.shape[0]} of {rest.dtype}; it is left out"
    )


def _because(frame: Frame) -> str:
    """Return why a frame has no image, as the end of a message; "" if it is not known."""
    return f": {in_shell(frame.why)}" if frame.why else ""


def _side_by_side(left: GreyImage | None, right: GreyImage | None) -> GreyImage | None:
    if left is None or right is None:
        return None
    if (left.shape, left.dtype) != (right.shape, right.dtype):
        raise ImageError(f"the left frame is {_size(left)}, the right one {_size(right)}")
    both = np.empty((left.shape[0], 2 * left.shape[1]), left.dtype)
    both[:, : left.shape[1]], both[:, left.shape[1] :] = left, right
    return both


def _size(image: GreyImage) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px of {image.dtype}"


def _chained(first: Frame, others: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    with contextlib.closing(others):
        yield first
        yield from others
