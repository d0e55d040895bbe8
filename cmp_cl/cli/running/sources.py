"""The source of `cmp-cl run`: its options, and the frame at rest."""

import argparse
import contextlib
import re
from collections.abc import Generator
from typing import Any

import cv2

from cmp_cl.cli.arguments import positive_number
from cmp_cl.cli.messages import counted, in_shell, shown
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Pairs, Source


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
        "--pixel-format",
        metavar="FOUR",
        type=_pixel_format,
        help="four letters, such as GREY, MJPG, YUYV",
    )


def _camera_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(match[1]), int(match[2])


def _pixel_format(text: str) -> float:
    if len(text) != 4:
        raise argparse.ArgumentTypeError(f"{text!r} has not four letters, such as MJPG")
    return float(cv2.VideoWriter.fourcc(*text))


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if the options do not name one source, or two."""
    two = arguments.left is not None or arguments.right is not None
    if two == (arguments.source is not None):
        raise ConfigError("give SOURCE, or --left and --right")
    if two and (arguments.left is None or arguments.right is None or arguments.stereo is None):
        raise ConfigError("--left and --right need each other, and --stereo")
    if two and (arguments.split or arguments.mirror):
        raise ConfigError("--split and --mirror are for frames that show both views")


def opened(arguments: argparse.Namespace) -> Source | Pairs:
    """Open the source; raises ConfigError if camera settings are given for a file."""
    asked: dict[str, float | None] = {
        "pixel format": arguments.pixel_format,
        "width": arguments.camera_size and arguments.camera_size[0],
        "height": arguments.camera_size and arguments.camera_size[1],
        "fps": arguments.camera_fps,
        "exposure": arguments.exposure,
    }
    camera = {what: value for what, value in asked.items() if value is not None}
    if arguments.left is None:
        return Source(arguments.source, camera, from_start=True)
    return Pairs(*(Source(name, camera) for name in (arguments.left, arguments.right)))


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


def _chained(first: Frame, others: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    with contextlib.closing(others):
        yield first
        yield from others
