"""Where a pattern ends in the view."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.evidence import grey
from cmp_cl.grid.grid import NO_SIDES, Sides
from cmp_cl.grid.nodes import Index, Mask, Nodes, Points
from cmp_cl.image import GreyImage

BEYOND = 1.5  # cells from the last nodes: the middle of the cells that a longer pattern has there
HIDDEN = 0.4  # cells: nodes nearer than that to the edge of the picture may not be seen
FLAT = 0.3  # of the contrast of the cells before: below it those beyond are no cells
SPOTS = np.array([-0.15, 0.0, 0.15])  # cells: where a square's grey level is taken
MOST = 23  # squares of a side that are looked at; odd, so that of equal steps both colours come


class Ends(NamedTuple):
    """How a pattern ends in the view.

    border: the sides on which nodes end in the picture, and what lies beyond is no cell.
    cut: the sides on which the picture ends before the next nodes.
    """

    border: Sides = NO_SIDES
    cut: Sides = NO_SIDES

    def turned(self, quarters: int) -> "Ends":
        """Return the same after the numbers are turned as in `Grid.turned`."""
        return Ends(self.border.turned(quarters), self.cut.turned(quarters))


def border_of(nodes: Nodes, image: GreyImage) -> Sides:
    """Return the sides on which nodes end in the image, where no cell follows."""
    at = nodes.at
    if min(at.shape) < 2:
        return NO_SIDES
    lines = [_squares(way, *rows) for way in (at, at.T) for rows in ((0, 1), (-1, -2))]
    side = np.repeat(np.arange(4), [len(line.sign) for line in lines])
    middle: Points = np.concatenate([line.middle for line in lines])
    out: Points = np.concatenate([line.out for line in lines])
    along = np.concatenate([line.along for line in lines])
    sign = np.concatenate([line.sign for line in lines])
    far: Points = middle + (BEYOND + 0.25) * out
    shown = _inside(far, image)
    spots = np.stack([middle + BEYOND * out, middle - out / 2])[..., None] + SPOTS * along[:, None]
    level = sign * grey(image, spots).sum(axis=2)
    borders = []
    for number, line in enumerate(lines):
        here = shown & (side == number)
        count = np.count_nonzero(here)
        if 2 * count < len(line.sign) or count < 2 or abs(int(sign[here].sum())) == count:
            borders.append(False)
            continue
        bright, dark = here & (sign > 0), here & (sign < 0)
        beyond, inside = level[:, bright].mean(axis=1) + level[:, dark].mean(axis=1)
        borders.append(bool(abs(beyond) < FLAT * abs(inside)))
    return Sides(*borders)


def cut_of(nodes: Nodes, image: GreyImage) -> Sides:
    """Return the sides on which the image ends before the next nodes."""
    at, across = nodes.at, nodes.at.T
    return Sides(
        _cut(at, image), _cut(at[::-1], image), _cut(across, image), _cut(across[::-1], image)
    )


def _cut(at: Points, image: GreyImage) -> bool:
    """Return whether most columns, (R, C) px, have no space in the image before the first node."""
    seen = ~np.isnan(at.real)
    column = np.flatnonzero(seen.any(axis=0))
    first = seen.argmax(axis=0)[column]
    second = np.minimum(first + 1, len(at) - 1)
    one, two = at[first, column], at[second, column]
    known = ~np.isnan(two.real) & (second > first)
    beyond = ~_inside((one + (1 + HIDDEN) * (one - two))[known], image)
    return 2 * int(np.count_nonzero(beyond)) > len(beyond)


def _inside(at: Points, image: GreyImage) -> Mask:
    """Return which of those points the image shows."""
    rows, columns = image.shape
    inside: Mask = (at.real >= 0) & (at.real < columns) & (at.imag >= 0) & (at.imag < rows)
    return inside


class _Squares(NamedTuple):
    """Squares between the first row of nodes and the second: the middle of their first sides,
    the steps out of the pattern and along it, px, and 1 or -1 in turn."""

    middle: Points
    out: Points
    along: Points
    sign: Index


def _squares(at: Points, first: int, second: int) -> _Squares:
    """Sample some squares of a side, none where less than half of the lines end there."""
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
    """Return first and last row, first and last column that hold a fair part of a line's nodes.

    there: (R, C), where nodes are; at least one.
    """
    ends: list[int] = []
    for axis in (1, 0):
        count = there.sum(axis=axis)
        full = np.flatnonzero(count >= max(np.median(count) / 4, 1))
        ends += [int(full[0]), int(full[-1])]
    return ends[0], ends[1], ends[2], ends[3]
