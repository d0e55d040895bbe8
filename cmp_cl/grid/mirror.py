"""Tests whether a part of a grid is the reflection of another part.

A mirror whose edge falls on a line of cells continues the pattern: the reflection has the right
colours and no border. Two things reveal it.

The seam. The edge of a mirror lies in the middle of a line of cells only by chance, and a reflected
row continues in another direction. So the steps across that line differ from those before and
after, more than across any other line. Two patterns side by side, or a pattern torn from edge to
edge, have such a seam too, and their numbers are equally doubtful.

The printing errors, see `fingerprint`. They are repeated beyond the edge, reversed.

A perfect print in a mirror without a seam looks like a larger pattern, unless the reflection is
darker, see `dimming`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.nodes import NOWHERE, Float, Points

LINES = 16  # most rows or columns that are examined
HINT = 3.5  # correlation of errors on these from which all lines are examined
CROSSING = 4  # of them that must cross a seam, besides a quarter of all, or half if nodes are lost
LOST = 2  # successive nodes that may be lost at a seam
SHARE = 0.4  # share of the rows that may cross a seam without a step
SEAM, SEAM_PIXELS = 0.03, 0.6  # cells and px: least step at a seam; drawn edges may step by .5 px
ABOVE_OTHERS = 2.5  # times the step at any other line
ABOVE_OTHERS_ACROSS = 4.0  # the same for diagonal lines
APART = 1.5  # lines: nearer ones show a part of the seam's step
OTHERS = 3  # least number of other lines to compare with
CLIP = 2.5  # times the median: a larger error counts as that
ABOVE_CHANCE = 6.0  # correlation of errors, over the root of the number of pairs
ABOVE_SECOND = 1.6  # times the second best correlation, in any direction
ALIKE = 0.5  # least share of the errors that is common
LEAST_COUNT = 16  # least number of errors with a counterpart
PRINTED = 0.05  # px per axis: smaller errors may be the camera's
GAIN = 9 / 4  # factor on an error's variance, see `_errors`
MEDIAN = 1.18  # median length of errors, over their standard deviation per axis
BESIDE = 4  # half cells: lines so near to the best share its errors
# factors that make the product of an error, along rows plus 1j along columns, and its reflection
# real
COLUMNS, ROWS, FALLING, RISING = WAYS = -1, 1, 1j, -1j


def has_seam(at: Points) -> bool:
    """Return whether the steps across one line of cells differ from those across all others.

    at: (R, C) measured nodes, px, NaN where there is none.
    """
    return _has_seam(at, ABOVE_OTHERS) or _has_seam(at.T, ABOVE_OTHERS)


def has_diagonal_seam(at: Points) -> bool:
    """Return whether the steps along diagonals differ across one of the diagonals that cross them.

    at: (R, C) measured nodes, px, NaN where there is none. Waves bend diagonals more than rows, and
    short diagonals have few steps to compare with, so the difference must be larger.
    """
    return any(
        _has_seam(lines, ABOVE_OTHERS_ACROSS)
        for way in (at, at[:, ::-1])
        for lines in map(_some, _diagonals(way, NOWHERE))
    )


def _has_seam(at: Points, above_others: float) -> bool:
    """Return whether the steps differ across one line between columns.

    above_others: the least difference there, times the largest at any other line.
    """
    at = _some(at)
    step = at[:, 1:] - at[:, :-1]
    known = ~np.isnan(step.real)
    if at.shape[1] < 6 or not known.any():
        return False
    lost = 0 if known.all() else LOST
    lines = [_off(at, step, nodes) for nodes in range(lost + 1)]
    off, cell = np.concatenate(lines), float(np.abs(step[known]).mean())
    place = np.concatenate([np.arange(len(line)) + n / 2 for n, line in enumerate(lines)])
    best = int(off.argmax())
    others = off[(np.abs(place - place[best]) > APART) & (off > 0)]
    if len(others) < OTHERS:
        return False
    return bool(off[best] >= max(SEAM * cell, SEAM_PIXELS, above_others * others.max()))


def _off(at: Points, step: Points, lost: int) -> Float:
    """Return the deviation of the step across `lost` missing nodes from the steps beside it, px.

    It is a quantile over the rows that cross each line, 0 if few do.
    """
    ahead = lost + 1
    before, after = step[:, : -1 - ahead], step[:, 1 + ahead :]
    off = at[:, 1 + ahead : -1] - at[:, 1 : -1 - ahead] - ahead * (before + after) / 2
    if lost:
        off[~np.isnan(at[:, 2 : -1 - lost])] = NOWHERE
    size = np.sort(np.abs(off), axis=0)  # unknown ones are last
    count = (size == size).sum(axis=0)
    least = max(CROSSING, len(at) / (2 if lost else 4))
    typical: Float = size[(SHARE * count).astype(np.int64), np.arange(len(count))]
    typical[count < least] = 0
    return typical


def repeats_reversed(at: Points) -> bool:
    """Return whether the printing errors are repeated beyond a line, reversed.

    at: (R, C) measured nodes, px, NaN where there is none. The lines are the middles of cells
    along rows or columns, and the diagonals. If no errors show, a seam along a diagonal counts.
    """
    error, cell = _errors(at)
    if not error.size:
        return has_diagonal_seam(at)
    lines = [[error], [error.T], _diagonals(error), _diagonals(error[:, ::-1])]
    scores = [
        _scores([_some(each) for each in group], way, cell)
        for group, way in zip(lines, WAYS, strict=True)
    ]
    if not _stands_out(scores) and max(scores)[0] >= HINT:
        best = scores.index(max(scores))
        scores[best] = _scores(lines[best], WAYS[best], cell)
    return _stands_out(scores)


def _stands_out(scores: list[tuple[float, float, bool]]) -> bool:
    """Return whether the best of the scores of all directions shows a reflection."""
    best, second, alike = max(scores)
    others = sorted(score for score, *_ in scores)[-2]
    return alike and best >= max(ABOVE_CHANCE, ABOVE_SECOND * max(others, second))


def _errors(at: Points) -> tuple[Points, float]:
    """Return the errors of nodes against the 3 x 3 nodes around, cells, (R - 2, C - 2), and the
    cell, px.

    An error is x minus the mean of its neighbours on the row, and the result minus the same mean on
    the column. It is zero if x is a function of the row plus a function of the column. Independent
    errors of variance 1 give it the variance GAIN. It is 0 if a node is unknown; the array is empty
    if few are known or all are small.
    """
    nothing = np.zeros((0, 0), np.complex128), 0.0
    if min(at.shape) < 3:
        return nothing
    error = at[:, 1:-1] - (at[:, :-2] + at[:, 2:]) / 2
    error = error[1:-1] - (error[:-2] + error[2:]) / 2
    known = ~np.isnan(error.real)
    if np.count_nonzero(known) < LEAST_COUNT:
        return nothing
    size = np.abs(error)
    ordinary = float(np.median(size[known]))
    if ordinary < MEDIAN * np.sqrt(GAIN) * PRINTED:
        return nothing
    step = (at[1:-1, 2:] - at[1:-1, :-2]) / 2
    length = np.maximum(np.abs(step), 1e-6)
    clipped = np.minimum(1, CLIP * ordinary / np.maximum(size, 1e-12))
    with np.errstate(invalid="ignore"):
        error = np.where(known, error * clipped * step.conj() / length**2, 0)
    return error, float(np.median(length[known]))


def _some(lines: NDArray[Any]) -> NDArray[Any]:
    """Return at most LINES of the lines, evenly spread."""
    return lines[:: max(-(-len(lines) // LINES), 1)]


def _diagonals(values: Points, nothing: complex = 0) -> list[Points]:
    """Return the falling diagonals: (K, L) those on which row plus column is even, then odd.

    A diagonal's values lie by half that sum, with `nothing` beside them.
    """
    high, wide = values.shape
    half = np.arange((high + wide) // 2)
    found = []
    for odd in (0, 1):
        every = np.arange(1 - wide, high)
        ahead = every[every % 2 == odd][:, None]
        row = half + (ahead + odd) // 2
        column = row - ahead
        inside = (row >= 0) & (row < high) & (column >= 0) & (column < wide)
        found.append(np.where(inside, values[row * inside, column * inside], nothing))
    return found


def _scores(lines: list[Points], way: complex, cell: float) -> tuple[float, float, bool]:
    """Return the agreement of errors with those on the other side of a point on the lines.

    Returns the best score of all points and the second best, some points away, in standard
    deviations of independent errors; and whether enough errors agree.
    """
    size = 1 << (2 * lines[0].shape[1] - 1).bit_length()
    agreed, power = np.zeros(size), np.zeros(size)
    for odd, line in enumerate(lines):
        square = line.real**2 + line.imag**2
        both = np.zeros((2, len(line), size), np.complex64)
        both[0, :, : line.shape[1]] = line
        both[1, :, : line.shape[1]].real = square > 0
        both[1, :, : line.shape[1]].imag = square
        both = np.fft.fft(both)
        first, second = np.fft.ifft((both * both).sum(axis=1))
        agreed += np.roll((way * first).real, odd)
        power += np.roll(second.imag / 2, odd)
    errors = np.concatenate([line[line != 0] for line in lines])
    if not len(errors):
        return 0.0, 0.0, False
    variance = float((errors.real**2 + errors.imag**2).mean())
    met = power >= LEAST_COUNT * variance
    if way in (COLUMNS, ROWS):
        met[::2] = False  # a reflection in a line of nodes has the wrong colours
    score = np.where(met, agreed / np.sqrt(np.maximum(power, variance) * variance), 0)
    best = int(score.argmax())
    highest, common = float(score[best]), float(agreed[best]) / max(float(power[best]), variance)
    score[max(best - BESIDE, 0) : best + BESIDE + 1] = 0
    printed = common * variance / GAIN / 2 * cell**2 >= PRINTED**2
    return highest, float(score.max()), printed and common >= ALIKE
