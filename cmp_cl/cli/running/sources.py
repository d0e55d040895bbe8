"""The source of `cmp-cl run`, its frame at rest, and the frames that are left out."""

import contextlib
from collections.abc import Generator

from cmp_cl.cli.messages import counted, shown
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Pairs, Source


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
    return f": {frame.why}" if frame.why else ""


def _chained(first: Frame, others: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    with contextlib.closing(others):
        yield first
        yield from others
