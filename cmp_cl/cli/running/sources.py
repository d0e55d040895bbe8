"""The source of `cmp-cl run`: its options, and the frame at rest."""

import argparse
import contextlib
from collections.abc import Generator
from typing import Any

from cmp_cl.cli.arguments import check_split
from cmp_cl.cli.messages import counted, in_shell, shown
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Pairs, Source


def add_arguments(group: Any) -> None:
    """Add the options of the source to a group of an argparse parser."""
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
    group.add_argument(
        "--set",
        metavar="NAME=VALUE",
        type=_setting,
        action="append",
        default=[],
        help="a setting of the camera, given once for each, such as frame_width=1280, "
        "frame_height=720, fps=60, fourcc=MJPG or exposure=50: a property CAP_PROP_NAME of OpenCV",
    )


def _setting(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE such as fps=60")
    return name, value


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if the options do not name one source, or two."""
    two = arguments.left is not None or arguments.right is not None
    if two == (arguments.source is not None):
        raise ConfigError("give SOURCE, or --left and --right")
    if two and (arguments.left is None or arguments.right is None or arguments.stereo is None):
        raise ConfigError("--left and --right need each other, and --stereo")
    check_split(arguments, both=arguments.stereo is not None and not two)


def opened(arguments: argparse.Namespace) -> Source | Pairs:
    """Open the source; raises ConfigError if camera settings are given for a file."""
    settings = dict(arguments.set)
    if arguments.left is None:
        return Source(arguments.source, settings)
    return Pairs(*(Source(name, settings) for name in (arguments.left, arguments.right)))


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
