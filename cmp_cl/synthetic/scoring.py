"""Detections scored against the truth: missed corners, false corners, errors."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import FieldError, as_numbers, check_positive

Points = NDArray[np.float64]  # (N, 2), px


@dataclasses.dataclass(frozen=True)
class Score:
    """The counts and errors of one frame, or of several added by `total`.

    expected: number of true corners.
    found, missed: number of them that were found, and that were not.
    false: number of detections that match no corner.
    frames: number of frames.
    success: number of frames with no missed and no false corner.
    errors: (found,) float64, distance of each found corner from the truth, px.
    """

    expected: int
    found: int
    missed: int
    false: int
    frames: int
    success: int
    errors: NDArray[np.float64] = dataclasses.field(repr=False)

    @property
    def rmse(self) -> float:
        """Return the root mean square of the errors, px, NaN if nothing was found."""
        return float(np.sqrt(np.mean(self.errors**2))) if self.found else float("nan")


def reach(cell: float) -> float:
    """Return the largest distance of a detection from its corner, px: 0.35 cells, at most 3."""
    return min(3.0, 0.35 * cell)


def match(found: ArrayLike, truth: ArrayLike, distance: float) -> NDArray[np.int64]:
    """Match detections to corners one to one, the nearest pairs first.

    found: (N, 2), truth: (M, 2), distance: the largest of a pair, px.
    Returns (N,) int64, the index of each detection's corner, -1 for none.
    """
    detections, corners = _points("found", found), _points("truth", truth)
    partner = np.full(len(detections), -1, np.int64)
    first, second, apart = _near(detections, corners, distance)
    taken = np.zeros(len(corners), np.bool_)
    for k in np.argsort(apart, kind="stable"):
        if partner[first[k]] < 0 and not taken[second[k]]:
            partner[first[k]] = second[k]
            taken[second[k]] = True
    return partner


def score(
    found: ArrayLike,
    truth: ArrayLike,
    cell: float,
    ignored: ArrayLike = (),
    *,
    within: float | None = None,
) -> Score:
    """Score the detections of one frame.

    found: (N, 2), truth: (M, 2) or (R, C, 2), px. cell: side of a cell, px.
    ignored: (K, 2), px, points where a detection is neither true nor false.
    within: largest distance of a detection from its corner, px; None: 0.35 cells, at most 3.

    Raises FieldError if cell is not positive, or the others are not arrays of such a shape.
    """
    check_positive("cell", cell, FieldError)
    detections, corners, junctions = (
        _points("found", found),
        _points("truth", truth),
        _points("ignored", ignored),
    )
    within = reach(cell) if within is None else within
    partner = match(detections, corners, within)
    hit = partner >= 0
    unmatched = detections[~hit]
    near_junction, _, _ = _near(unmatched, junctions, within)
    false = len(unmatched) - len(np.unique(near_junction))
    missed = len(corners) - int(hit.sum())
    return Score(
        expected=len(corners),
        found=int(hit.sum()),
        missed=missed,
        false=false,
        frames=1,
        success=int(missed == 0 and false == 0),
        errors=np.hypot(*(detections[hit] - corners[partner[hit]]).T),
    )


def total(scores: Iterable[Score]) -> Score:
    """Add the scores of several frames."""
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


def agreeing(
    numbers: NDArray[np.integer], truth: NDArray[np.integer], whole: tuple[int, int] | None = None
) -> NDArray[np.bool_]:
    """Return which numbers of nodes are right, up to one motion of the lattice.

    numbers, truth: (N, 2), row and column. whole: rows and columns of a board that the motion must
    map onto itself; None: any motion, a turn by quarters, perhaps mirrored, and a shift.
    Returns (N,) bool, by the motion for which most agree.
    """
    here, there = numbers @ [1j, 1], truth @ [1j, 1]
    ends = np.zeros(2) if whole is None else np.array([0, whole[1] - 1 + 1j * (whole[0] - 1)])
    best = np.zeros(len(here), np.bool_)
    for mirrored in (False, True):
        for quarters in range(4):
            moved, rim = ((z.conj() if mirrored else z) * 1j**quarters for z in (there, ends))
            shift = np.rint(here - moved)
            values, counts = np.unique(shift, return_counts=True)
            wanted = -(rim.real.min() + 1j * rim.imag.min())
            if whole is None and len(values):
                wanted = values[counts.argmax()]
            best = max(best, shift == wanted, key=np.count_nonzero)
    return best


def _points(name: str, points: ArrayLike) -> Points:
    given = as_numbers(name, points, FieldError)
    if given.size and given.shape[-1:] != (2,):
        raise FieldError(f"{name} must be (N, 2), not {given.shape}")
    finite = given.reshape(-1, 2)
    return finite[np.isfinite(finite).all(1)]


def _near(
    first: Points, second: Points, distance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return all pairs closer than `distance`: two arrays of indices, and their distances, px."""
    order = np.argsort(second[:, 0], kind="stable")
    x = second[order, 0]
    low = np.searchsorted(x, first[:, 0] - distance)
    count = np.searchsorted(x, first[:, 0] + distance) - low
    a = np.repeat(np.arange(len(first)), count)
    b = order[np.arange(len(a)) + np.repeat(low - np.cumsum(count) + count, count)]
    apart = np.hypot(*(second[b] - first[a]).T)
    close = apart < distance
    return a[close], b[close], apart[close]
