"""The rows of the tables: four of ours, and the peers."""

import contextlib
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from peers import PEERS, Detect, Pattern

from cmp_cl import Detector, DetectorConfig, EdgeLines
from cmp_cl.errors import GridError
from cmp_cl.grid.grid import MEASURED
from cmp_cl.image import GreyImage

DEFAULT = "cmp_cl, default"
LINES = "cmp_cl, EDGE_LINES"
PAPER = "cmp_cl, the paper's"
GRIDDED = "cmp_cl, default + grid"


class Method(NamedTuple):
    """A row of a table: its name, and what runs. slow: takes more than 50 ms a frame."""

    name: str
    detect: Detect
    slow: bool = False

    def timed(self, image: GreyImage) -> tuple[np.ndarray, float]:
        """Return the positions in an image, and the time, ms, by the peer's own clock if any."""
        start = time.perf_counter()
        xy = np.asarray(self.detect(image))
        spent = time.perf_counter() - start
        return xy, 1e3 * getattr(self.detect, "seconds", spent)


def used(
    pattern: Pattern, shape: tuple[int, int], names: Sequence[str], density: int | None = None
) -> list[Method]:
    """Return our rows for images of that shape, and those of the peers of these names.

    The grid is told the size of a single pattern. density: as for `peer`.
    """
    configs = {
        DEFAULT: DetectorConfig(),
        LINES: DetectorConfig(refinement=EdgeLines()),
        PAPER: DetectorConfig.paper(min((20, 30, 40), key=lambda n: abs(n - pattern.markers))),
    }
    detectors = {name: Detector(shape=shape, config=config) for name, config in configs.items()}
    rows = [Method(name, lambda image, own=own: own(image).xy) for name, own in detectors.items()]
    if pattern.views == 1:
        rows.append(_gridded(pattern, shape))
    return rows + [peer(name, pattern, density) for name in names]


def peer(name: str, pattern: Pattern, density: int | None = None) -> Method:
    """Return a peer at the settings that `search.py` found for that density.

    density: corners a side, of the scenes with cells like these; by default the pattern's own.
    """
    entry = PEERS[name]
    detect = entry.make(entry.settings(density or pattern.markers), pattern)
    return Method(entry.label, detect, entry.slow)


def _gridded(pattern: Pattern, shape: tuple[int, int]) -> Method:
    """Return the corners that the grid numbers; predicted nodes do not count."""
    detector = Detector(shape=shape)
    size = (pattern.markers, pattern.markers)

    def detect(image: GreyImage) -> np.ndarray:
        with contextlib.suppress(GridError):
            _, grid = detector.grid(image, shape=size)
            return grid.xy[np.isin(grid.status, MEASURED)]
        return np.empty((0, 2), np.float32)

    return Method(GRIDDED, detect)
