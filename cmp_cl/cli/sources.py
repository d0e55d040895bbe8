"""The sources of frames for `cmp-cl run`: files, cameras, or two of them side by side."""

import argparse
import contextlib
import time
from collections.abc import Generator, Iterator

import numpy as np

from cmp_cl import cameras, media
from cmp_cl.cameras import CameraSettings, PairCount, is_live, paired
from cmp_cl.cli.messages import counted, shown
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.image import GreyImage
from cmp_cl.media import Frame
from cmp_cl.series.mcap import mcap_images

PAIR_WITHIN = 20.0  # ms


class Source:
    """The source of the frames.

    rate: frames per second. full_scale: largest grey level. Both are None if unknown.
    """

    def __init__(self, name: str, max_pixels: int, camera: CameraSettings) -> None:
        self._max_pixels = max_pixels
        self._source = cameras.Source(name, camera, max_pixels=max_pixels)
        self.name, self.live, self.paths = name, is_live(name), self._source.paths
        plain = self.live and name.isdigit() and camera == CameraSettings()
        self._number = int(name) if plain else None
        self.start_ns: int | None = None  # since 1970, of an MCAP recording
        single = self.paths[0] if len(self.paths) == 1 else None
        self.rate = None if single is None else media.frame_rate(single)
        self.full_scale = None if single is None else media.full_scale(single)

    @property
    def total(self) -> int | None:
        """Return how many frames or pairs there are, None if unknown."""
        if self.live:
            return None
        if len(self.paths) == 1:
            return media.count_frames(self.paths[0])
        total = 0
        for path in self.paths:
            with contextlib.suppress(ImageError):
                total += media.count_frames(path) or 1
        return total

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all frames or pairs, from the first; one that cannot be read has no image."""
        if self.paths and self.paths[0].suffix.lower() == ".mcap":
            for number, (stamp, image) in enumerate(
                mcap_images(self.paths[0], max_pixels=self._max_pixels)
            ):
                self.start_ns = self.start_ns or stamp
                yield Frame(number, image, (stamp - self.start_ns) / 1e6)
            return
        taken = self._source.frames() if self._number is None else _now(self._number)
        start = None if self.live else 0.0
        for each in taken:
            start = each.time_ms if start is None else start
            time_ms = each.time_ms - start if len(self.paths) < 2 else np.nan
            yield Frame(each.index, each.image, time_ms)

    def rest(self, number: int) -> tuple[GreyImage, Generator[Frame, None, None]]:
        """Return the frame at rest of that number, and the frames to measure.

        Those of a camera begin with the frame at rest; those of a file are all its frames. Raises
        ConfigError if the frame cannot be read or does not exist.
        """
        frames, count = self.frames(), 0
        for frame in frames:
            count = frame.index + 1
            if frame.index < number:
                continue
            if frame.image is None:
                raise ConfigError(f"--rest-frame {number} cannot be read; choose another one")
            if self.live:
                return frame.image, _chained(frame, frames)
            frames.close()
            return frame.image, self.frames()
        raise ConfigError(
            f"there is no --rest-frame {number}: {shown(self.name)} has {counted(count, 'frame')}, "
            "numbered from 0"
        )


class Pairs(Source):
    """Frames of two sources side by side, left and right, paired by their times."""

    def __init__(self, arguments: argparse.Namespace, camera: CameraSettings) -> None:
        self._sides = [
            cameras.Source(name, camera, max_pixels=arguments.max_pixels)
            for name in (arguments.left, arguments.right)
        ]
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
        self.start_ns = self.full_scale = None
        if not left.live:
            self.full_scale = media.full_scale(left.paths[0])
        self.live = left.live
        self.paths = (*left.paths, *right.paths)
        periods = [side.period_ms for side in self._sides if np.isfinite(side.period_ms)]
        self.rate = 1e3 / max(periods) if periods else None
        self._within = arguments.pair_within
        if self._within is None:
            self._within = min(periods) / 2 if periods else PAIR_WITHIN
        self.count = PairCount()

    @property
    def total(self) -> int | None:
        """Return how many frames or pairs there are, None if unknown."""
        return None

    def frames(self) -> Generator[Frame, None, None]:
        """Yield all frames or pairs, from the first; one that cannot be read has no image."""
        self.count = PairCount()
        start = None
        with contextlib.ExitStack() as stack:
            sides = [stack.enter_context(contextlib.closing(s.frames())) for s in self._sides]
            found = paired(*sides, tolerance_ms=self._within, count=self.count, endless=self.live)
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


def _now(number: int) -> Iterator[cameras.Timed]:
    """Yield the frames of a camera with the times at which they came."""
    for frame in media.read_camera(number):
        yield cameras.Timed(frame.index, time.monotonic() * 1e3, frame.image)


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
