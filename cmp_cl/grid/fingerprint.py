"""The fingerprint of a pattern: its printing errors, which move with it.

No print is perfect: each of its corners is misplaced by some hundredths of a cell. Without their
smooth part, the positions leave these errors and noise. The errors of two frames agree under the
right numbers, and under no others.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from cmp_cl.grid.grid import MEASURED, Grid
from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Points, median, turned_lines

CLIP = 2.5  # times the median: larger errors are clipped to it
PRINTED = 0.1  # px per axis: smaller errors may be the camera's, which do not move with the pattern
ABOVE_CHANCE = 6.0  # standard deviations of the correlations under all numberings
ABOVE_SECOND = 2.0  # times the second best correlation
LEAST_COMMON = 0.25  # least share of the errors with a counterpart
LEAST_COUNT = 100  # least number of errors with a counterpart
GAIN = 1 + 68 / 144  # factor on an error's variance, see `_rough`
FROM_CUBICS = np.zeros((5, 5))  # a node minus the mean of the cubics along its row and column
FROM_CUBICS[2] = FROM_CUBICS[:, 2] = np.array([1, -4, 12, -4, 1]) / 12


class Fingerprint(NamedTuple):
    """The printing errors of a pattern.

    error: (R, C) complex, cells, along rows plus 1j along columns, 0 where unknown. known: (R, C)
        bool. cell: mean side of a cell, px. power: the mean square of the errors, cells^2.
    """

    error: Points
    known: Mask
    cell: float
    power: float

    @classmethod
    def of(cls, at: Points) -> "Fingerprint":
        """Take the fingerprint of measured nodes; at: (R, C), x + 1j y, px, NaN where missing."""
        error, known = np.zeros(at.shape, np.complex128), np.zeros(at.shape, np.bool_)
        rough, length = _rough(at)
        inner = ~np.isnan(rough.real)
        if not inner.any():
            return cls(error, known, 0.0, 0.0)
        size = np.abs(rough)
        limit = CLIP * median(size[inner])
        rough *= np.minimum(1, limit / np.maximum(size, 1e-12))
        known[2:-2, 2:-2] = inner
        np.copyto(error[2:-2, 2:-2], rough, where=inner)
        power = float(np.vdot(error, error).real) / int(np.count_nonzero(inner))
        return cls(error, known, float(length[inner].mean()), power)

    @classmethod
    def at_rest(cls, rest: Grid) -> "Fingerprint":
        """Take the fingerprint of a grid at rest. The last few are kept for the other frames of a
        recording."""
        return _kept(rest.shape, rest.xy.dtype, rest.xy.tobytes(), rest.status.tobytes())

    @property
    def pixels(self) -> float:
        """Return the root mean square of the errors per axis, px."""
        return self.cell * math.sqrt(self.power / GAIN / 2)


@functools.lru_cache(maxsize=4)
def _kept(shape: tuple[int, int], kind: DTypeLike, xy: bytes, status: bytes) -> Fingerprint:
    at = np.frombuffer(xy, kind).astype(np.float64).view(np.complex128).reshape(shape)
    measured = np.isin(np.frombuffer(status, np.uint8), MEASURED).reshape(shape)
    return Fingerprint.of(np.where(measured, at, NOWHERE))


def _rough(at: Points) -> tuple[Points, Float]:
    """Return the distances of nodes from the cubics through their neighbours, cells, and the
    lengths of the steps, px.

    (R - 4, C - 4) each, without the two outermost lines of each side, or empty. A distance is the
    mean of x - (4 (L + R) - (LL + RR)) / 6 along the row and along the column, divided by the step
    along the row. Independent errors of variance 1 give it the variance GAIN.
    """
    if min(at.shape) < 5:
        return np.zeros((0, 0), np.complex128), np.zeros((0, 0))
    pixels = np.ascontiguousarray(at).view(np.float64).reshape(*at.shape, 2)
    border = cv2.BORDER_CONSTANT  # the fastest; it is cut off
    filtered = cv2.filter2D(pixels, -1, FROM_CUBICS, borderType=border)
    off = np.ascontiguousarray(filtered[2:-2, 2:-2])
    step = 0.5 * (at[2:-2, 3:-1] - at[2:-2, 1:-3])
    length = np.abs(step)
    step[~(length > 1e-6)] = NOWHERE
    with np.errstate(invalid="ignore"):  # NaN over NaN
        return off.view(np.complex128)[..., 0] / step, length


def turn_to(rest: Fingerprint, now: Fingerprint, turns: Sequence[int]) -> int | None:
    """Return the quarter turn that takes the errors now to those at rest; None if unclear.

    turns: the quarter turns to compare, after each of which the whole pattern has the rows and
        columns at rest. Its correlation must stand out as in `shift_to`. Errors from the pixel grid
        of the camera may look the same after a turn, but they are too small.
    """
    scores: list[float] = []
    common: list[float] = []
    deviation = math.sqrt(max(now.power * rest.power, 1e-30) / 2)  # of the product of two errors
    for quarters in turns:
        error, known = turned_lines(now.error, quarters), turned_lines(now.known, quarters)
        count = max(int(np.count_nonzero(known & rest.known)), 1)
        agreed = float((np.vdot(error, rest.error) * 1j**quarters).real)
        scores.append(agreed / (deviation * math.sqrt(count)))
        common.append(agreed / count)
    best = scores.index(max(scores))
    second = max(score for place, score in enumerate(scores) if place != best)
    clear = scores[best] >= max(ABOVE_CHANCE, ABOVE_SECOND * second)
    return turns[best] if clear and _printed(common[best], now, rest) else None


def shift_to(rest: Fingerprint, now: Fingerprint) -> tuple[int, int] | None:
    """Return the rows and columns from a node's index now to its index at rest; None if unclear.

    It is clear if its correlation is six times the standard deviation of all correlations and twice
    the second best, and if the common errors are larger than those that a camera makes at the same
    pixels of every image.
    """
    if min(now.pixels, rest.pixels) < PRINTED:
        return None
    rows, columns = np.add(now.known.shape, rest.known.shape).tolist()
    size = [cv2.getOptimalDFTSize(rows - 1), cv2.getOptimalDFTSize(columns - 1)]
    total = _correlation(now.error, rest.error, size)
    count = np.rint(_correlation(now.known, rest.known, size))
    compared = count >= max(LEAST_COMMON * np.count_nonzero(now.known), LEAST_COUNT)
    if not compared.any():
        return None
    score = np.where(compared, total / np.sqrt(np.maximum(count, 1)), 0).ravel()
    best = int(score.argmax())
    second = np.delete(score, best).max()
    chance = median(np.abs(score[compared.ravel()])) / 0.6745
    if score[best] < max(ABOVE_CHANCE * chance, ABOVE_SECOND * second):
        return None
    if not _printed(total.ravel()[best] / count.ravel()[best], now, rest):
        return None
    place: Index = np.array(np.unravel_index(best, size))
    row, column = (place - np.where(place < rest.known.shape, 0, size)).tolist()
    return row, column


def _printed(common: float, now: Fingerprint, rest: Fingerprint) -> bool:
    """Return whether the common errors, a mean product, are larger than errors of a camera."""
    return bool(common / GAIN / 2 * now.cell * rest.cell >= PRINTED**2)


def _correlation(
    now: NDArray[np.generic], rest: NDArray[np.generic], size: list[int]
) -> NDArray[np.float64]:
    """Return the real part of the sum of conj(now[n]) rest[n + k] over n, by k; k < 0 is last."""
    product = np.conj(np.fft.fft2(now, size)) * np.fft.fft2(rest, size)
    real: NDArray[np.float64] = np.fft.ifft2(product).real
    return real
