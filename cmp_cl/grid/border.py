"""Where a pattern ends in the view."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.evidence import grey
from cmp_cl.grid.grid import Sides
from cmp_cl.grid.nodes import Index, Nodes, Points
from cmp_cl.image import GreyImage

BEYOND = 1.5  # cells from the last nodes: the middle of the cells that a longer pattern has there
FLAT = 0.3  # of the contrast of the cells before: below it those beyond are no cells
SPOTS = np.array([-0.15, 0.0, 0.15])  # cells: where a square's grey level is taken
MOST = 23  # squares of a side that are looked at; odd, so that of equal steps both colours come


def border(nodes: Nodes, image: GreyImage) -> Sides:
    """The sides on which nodes end in the picture, and what lies beyond is no cell."""
    at = nodes.at
    if min(at.shape) < 2:
        return Sides()
    lines = [_squares(way, *rows) for way in (at, at.T) for rows in ((0, 1), (-1, -2))]
    side = np.repeat(np.arange(4), [len(line.sign) for line in lines])
    middle, out, along = (np.concatenate([line[part] for line in lines]) for part in range(3))
    sign = np.concatenate([line.sign for line in lines])
    far = middle + (BEYOND + 0.25) * out
    rows, columns = image.shape
    shown = (far.real >= 0) & (far.real < columns) & (far.imag >= 0) & (far.imag < rows)
    spots = np.stack([middle + BEYOND * out, middle - out / 2])[..., None] + SPOTS * along[:, None]
    level = sign * grey(image, spots).sum(axis=2)
    ends = []
    for number, line in enumerate(lines):
        here = shown & (side == number)
        count = np.count_nonzero(here)
        if 2 * count < len(line.sign) or count < 2 or abs(int(sign[here].sum())) == count:
            ends.append(False)
            continue
        bright, dark = here & (sign > 0), here & (sign < 0)
        beyond, inside = level[:, bright].mean(axis=1) + level[:, dark].mean(axis=1)
        ends.append(bool(abs(beyond) < FLAT * abs(inside)))
    return Sides(*ends)


class _Squares(NamedTuple):
    """Squares between the first row of nodes and the second: the middle of their first sides,
    the steps out of the pattern and along it, px, and 1 or -1 in turn."""

    middle: Points
    out: Points
    along: Points
    sign: Index


def _squares(at: Points, first: int, second: int) -> _Squares:
    """Some squares of a side, none where less than half of the lines end there."""
    one, two = at[first], at[second]
    seen = ~np.isnan(one.real) & ~np.isnan(two.real)
    column = np.flatnonzero(seen[1:] & seen[:-1])
    lines = at.shape[1]
    if 2 * len(column) < lines - 1:  # perhaps the corners of a pattern that is turned
        lines = int(np.count_nonzero(~np.isnan(at.real).all(axis=0)))
    if 2 * len(column) < lines - 1:
        column = column[:0]
    if len(column) > MOST:
        column = column[np.arange(MOST) * len(column) // MOST]
    middle, inner = (one[column] + one[column + 1]) / 2, (two[column] + two[column + 1]) / 2
    return _Squares(middle, middle - inner, one[column + 1] - one[column], 1 - 2 * (column % 2))


def full_lines(there: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First and last row, first and last column that hold a fair part of the nodes of a line.

    there: (R, C), where nodes are; at least one.
    """
    ends: list[int] = []
    for axis in (1, 0):
        count = there.sum(axis=axis)
        full = np.flatnonzero(count >= max(np.median(count) / 4, 1))
        ends += [int(full[0]), int(full[-1])]
    return ends[0], ends[1], ends[2], ends[3]
