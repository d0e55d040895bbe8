"""The frame at rest of what `cmp-cl run` measures, its frames, and those that are left out."""

import contextlib
from collections.abc import Generator, Sequence
from pathlib import Path

import numpy as np

from cmp_cl.cli.messages import counted, shown
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Pairs, Source
from cmp_cl.media.images import numbers_of


class Recording:
    """The frame at rest of a source, and the frames to measure.

    number: of the frame at rest. rest: its image. frames: those of a camera begin with the frame at
    rest; those of a file are all its frames.

    Raises ConfigError if the frame at rest cannot be read or does not exist.
    """

    rest: GreyImage
    frames: Generator[Frame, None, None]

    def __init__(self, source: Source | Pairs, number: int) -> None:
        self.source, self.number = source, number
        frames, count = source.frames(), 0
        for frame in frames:
            count = frame.index + 1
            if frame.index < number:
                continue
            if frame.image is None:
                raise ConfigError(
                    f"--rest-frame {number} cannot be read; choose another one{_because(frame)}"
                )
            self.rest, self.frames = frame.image, _chained(frame, frames)
            if not source.live:
                self.frames.close()
                self.frames = source.frames()
            return
        if not count:
            raise ConfigError(f"no frame comes from {source.name!r}")
        raise ConfigError(
            f"there is no --rest-frame {number}: {shown(source.name)} has "
            f"{counted(count, 'frame')}, numbered from 0"
        )

    def why_left_out(self, frame: Frame) -> str:
        """Return why a frame is not measured, as text; "" if it is like the frame at rest."""
        image, rest = frame.image, self.rest
        if image is None:
            return f"frame {frame.index} is missing, and left out{_because(frame)}"
        if (image.shape, image.dtype) == (rest.shape, rest.dtype):
            return ""
        return (
            f"frame {frame.index} is {image.shape[1]} x {image.shape[0]} px of {image.dtype}, the "
            f"frame at rest is {rest.shape[1]} x {rest.shape[0]} of {rest.dtype}; it is left out"
        )


def missing_numbers(paths: Sequence[Path]) -> int:
    """Return how many numbers are missing between files that are numbered one by one."""
    return int((np.diff(numbers_of(paths)) - 1).sum())


def _because(frame: Frame) -> str:
    """Return why a frame has no image, as the end of a message; "" if it is not known."""
    return f": {frame.why}" if frame.why else ""


def _chained(first: Frame, others: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    with contextlib.closing(others):
        yield first
        yield from others
