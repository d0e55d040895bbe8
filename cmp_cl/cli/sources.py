"""Two sources side by side, and the frame at rest of a source, for `cmp-cl run`."""

import argparse
import contextlib
from collections.abc import Generator

import numpy as np

from cmp_cl.cameras import CameraSettings, PairCount, Source, paired
from cmp_cl.cli.messages import counted, in_shell, shown
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame

PAIR_WITHIN = 20.0  # ms


class Pairs:
    """Frames of two sources side by side, left and right, paired by their times.

    The attributes that it shares with `Source` mean the same for pairs.
    """

    start_ns: int | None = None
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
        self._within = arguments.pair_within
        if self._within is None:
            self._within = min(periods) / 2 if periods else PAIR_WITHIN
        self.count = PairCount()

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all pairs, from the first; one that cannot be read has no image.

        A frame that a camera missed has no time, and is not paired.
        """
        self.count = PairCount()
        start = None
        with contextlib.ExitStack() as stack:
            sides = [stack.enter_context(contextlib.closing(s.frames())) for s in self._sides]
            left_frames, right_frames = (
                (each for each in side if each.image is not None or not self.live) for side in sides
            )
            found = paired(
                left_frames,
                right_frames,
                tolerance_ms=self._within,
                count=self.count,
                endless=self.live,
            )
            for number, (left, right) in enumerate(found):
                start = left.time_ms if start is None else start
                both = _side_by_side(left.image, right.image)
                yield Frame(number, both, left.time_ms - start)

    def alone(self) -> str:
        """Return how many frames had no partner, as text; "" if all had one."""
        if not (self.count.left_alone or self.count.right_alone):
            return ""
        return (
            f"; {self.count.left_alone} left and {self.count.right_alone} right frames without "
            "a partner"
        )


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
                f"--rest-frame {number} cannot be read; choose another one{because(frame)}"
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


def because(frame: Frame) -> str:
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
