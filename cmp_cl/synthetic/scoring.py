"""Detections against truth: what was missed, what was invented, and how far off the rest is."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Places = NDArray[np.float64]  # (N, 2), px


@dataclasses.dataclass(frozen=True)
class Score:
    """The answer for one frame or for several, see `total`.

    expected: corners in the truth. found: of them, how many were found.
    missed: the others. false: detections that belong to no corner.
    frames: how many frames. success: in how many nothing was missed and nothing was false.
    errors: (found,) float64, distance of each found corner from its truth, px.
    """

    expected: int
    found: int
    missed: int
    false: int
    frames: int
    success: int
    errors: NDArray[np.float64] = dataclasses.field(repr=False)

    @property
    def recall(self) -> float:
        """Share of the corners that were found, NaN where there are none."""
        return _ratio(self.found, self.expected)

    @property
    def precision(self) -> float:
        """Share of the detections that are corners, NaN where there are none."""
        return _ratio(self.found, self.found + self.false)

    @property
    def per_thousand(self) -> float:
        """Missed and false per thousand corners, NaN where there are no corners."""
        return 1000 * _ratio(self.missed + self.false, self.expected)

    @property
    def rmse(self) -> float:
        """Root mean square of the errors, px, NaN where nothing was found."""
        return float(np.sqrt(np.mean(self.errors**2))) if self.found else float("nan")

    @property
    def mean(self) -> float:
        """Mean of the errors, px, NaN where nothing was found."""
        return float(self.errors.mean()) if self.found else float("nan")

    @property
    def p95(self) -> float:
        """95th percentile of the errors, px, NaN where nothing was found."""
        return float(np.percentile(self.errors, 95)) if self.found else float("nan")

    def summary(self) -> dict[str, Any]:
        """All of it as plain numbers, for a table or JSON; NaN becomes None."""
        numbers = {
            "frames": self.frames,
            "success": self.success,
            "expected": self.expected,
            "missed": self.missed,
            "false": self.false,
            "recall": self.recall,
            "precision": self.precision,
            "per_thousand": self.per_thousand,
            "mean": self.mean,
            "rmse": self.rmse,
            "p95": self.p95,
        }
        return {name: None if value != value else value for name, value in numbers.items()}


def reach(cell: float) -> float:
    """How far a detection may be from its corner, px: 0.35 cells, at most 3."""
    return min(3.0, 0.35 * cell)


def match(found: ArrayLike, truth: ArrayLike, distance: float) -> NDArray[np.int64]:
    """Pair detections and corners one to one, nearest first, below `distance`.

    found: (N, 2), truth: (M, 2), px. Returns (N,) the corner of each detection, -1 for none.
    """
    at, place = _places(found), _places(truth)
    partner = np.full(len(at), -1, np.int64)
    first, second, apart = _near(at, place, distance)
    taken = np.zeros(len(place), np.bool_)
    for k in np.argsort(apart, kind="stable"):
        if partner[first[k]] < 0 and not taken[second[k]]:
            partner[first[k]] = second[k]
            taken[second[k]] = True
    return partner


def score(found: ArrayLike, truth: ArrayLike, cell: float, ignored: ArrayLike = ()) -> Score:
    """Score the detections of one frame.

    found: (N, 2), truth: (M, 2) or (R, C, 2), px. cell: side of a cell, px.
    ignored: (K, 2), px, places where a detection is neither true nor false.
    """
    at, place, junctions = _places(found), _places(truth), _places(ignored)
    partner = match(at, place, reach(cell))
    hit = partner >= 0
    rest = at[~hit]
    near_junction, _, _ = _near(rest, junctions, reach(cell))
    false = len(rest) - len(np.unique(near_junction))
    missed = len(place) - int(hit.sum())
    return Score(
        expected=len(place),
        found=int(hit.sum()),
        missed=missed,
        false=false,
        frames=1,
        success=int(missed == 0 and false == 0),
        errors=np.hypot(*(at[hit] - place[partner[hit]]).T),
    )


def total(scores: Iterable[Score]) -> Score:
    """The score of all frames together."""
    parts = list(scores)
    return Score(
        expected=sum(part.expected for part in parts),
        found=sum(part.found for part in parts),
        missed=sum(part.missed for part in parts),
        false=sum(part.false for part in parts),
        frames=sum(part.frames for part in parts),
        success=sum(part.success for part in parts),
        errors=np.concatenate([np.empty(0), *(part.errors for part in parts)]),
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _places(points: ArrayLike) -> Places:
    places = np.asarray(points, np.float64).reshape(-1, 2)
    return places[np.isfinite(places).all(1)]


def _near(
    first: Places, second: Places, distance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """All pairs closer than distance: their indices and how far apart they are."""
    pairs = []
    order = np.argsort(second[:, 0], kind="stable")
    x = second[order, 0]
    low = np.searchsorted(x, first[:, 0] - distance)
    high = np.searchsorted(x, first[:, 0] + distance)
    for k, (start, end) in enumerate(zip(low, high, strict=True)):
        near = order[start:end]
        apart = np.hypot(*(second[near] - first[k]).T)
        close = apart < distance
        pairs.append((np.full(int(close.sum()), k), near[close], apart[close]))
    if not pairs:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    a, b, c = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return a.astype(np.int64), b.astype(np.int64), c
