"""Where a pattern ends in the view."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.evidence import grey
from cmp_cl.grid.grid import NO_SIDES, Sides, turned_sides
from cmp_cl.grid.nodes import Index, Mask, Nodes, Points
from cmp_cl.image import GreyImage

BEYOND = 1.5  # cells from the last nodes: the middle of the cells that a longer pattern has there
JUST_BEYOND = (0.8, 1.1, 1.2)  # cells: late in the first squares beyond, early in the second
HIDDEN = 0.4  # cells: nodes nearer than that to the edge of the picture may not be seen
FLAT = 0.3  # of the contrast of the cells before: below it those beyond are no cells
SPOTS = np.array([-0.15, 0.0, 0.15])  # cells: where a square's grey level is taken
MOST = 23  # squares of a side that are looked at; odd, so that of equal steps both colours come
STEP = 0.1  # cells
DEPTHS = np.arange(0.3, 1.45, STEP)  # cells from the last nodes: where the last squares may end
PARALLEL = 0.16  # cells: so near to one reach are three of four
ALIKE = 0.12  # cells: between the reach of a side of a pattern and that in another picture
PAIRS = 16  # neighbouring squares of a side that are looked at for where they end


NONE = float("nan")


class Border(NamedTuple):
    """How far the last squares of a pattern reach beyond its last nodes, cells, by side.

    NaN where the pattern does not end in the view.
    """

    top: float = NONE
    bottom: float = NONE
    left: float = NONE
    right: float = NONE

    @property
    def sides(self) -> Sides:
        """The sides on which the pattern ends in the view."""
        return Sides(*(not math.isnan(reach) for reach in self))

    def turned(self, quarters: int) -> "Border":
        """Return the same after the numbers are turned as in `Grid.turned`."""
        return Border(*turned_sides(self, quarters))

    def contradicts(self, other: "Border") -> Sides:
        """Return the sides on which both end, and the squares do not reach as far.

        On such a side one of them is the edge of what hides the pattern.
        """
        return Sides(*(abs(a - b) > ALIKE for a, b in zip(self, other, strict=True)))


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


def border_of(nodes: Nodes, image: GreyImage) -> Border:
    """Return where nodes end in the image, and no cell follows, and how far the last squares reach.

    They must reach as far along all of the side: the edge of what lies in front of a pattern
    cuts them anywhere.
    """
    ended = _ends_at(nodes, image, BEYOND, BEYOND + 0.25)
    at, across = nodes.at, nodes.at.T
    ways = (at, at[::-1], across, across[::-1])
    return Border(
        *(_reach(way, image) if end else NONE for end, way in zip(ended, ways, strict=True))
    )


def _reach(at: Points, image: GreyImage) -> float:
    """Return how far the squares before the first row of nodes, (R, C) px, reach, cells.

    A square ends where its contrast to the one beside it does: the mean of that contrast over
    depths, as a share of that between the first two rows, is how far it reaches. NaN where they
    do not reach equally far.
    """
    one, two = at[0], at[1]
    seen = ~np.isnan(one.real) & ~np.isnan(two.real)
    column = np.flatnonzero(seen[:-2] & seen[1:-1] & seen[2:])
    if len(column) > PAIRS:
        column = column[np.arange(PAIRS) * len(column) // PAIRS]
    beside = np.stack([column, column + 1], axis=1)
    middle = (one[beside] + one[beside + 1]) / 2
    out = middle - (two[beside] + two[beside + 1]) / 2
    along = one[beside + 1] - one[beside]
    shown = _inside(middle + DEPTHS[-1] * out, image).all(axis=1)
    if not shown.any():
        return NONE
    middle, out, along = middle[shown, :, None], out[shown, :, None], along[shown, :, None]
    depths = np.concatenate([[-0.5], DEPTHS])
    level = grey(image, (middle + depths * out)[..., None] + SPOTS * along[..., None]).sum(axis=3)
    contrast = level[:, 0] - level[:, 1]
    inside = contrast[:, :1]  # of the other sign
    share = np.clip(-contrast[:, 1:] / np.where(inside == 0, np.inf, inside), 0, 1)
    reach = DEPTHS[0] - STEP / 2 + STEP * share.sum(axis=1)
    middling = float(np.median(reach))
    return middling if np.quantile(np.abs(reach - middling), 0.75) <= PARALLEL else NONE


def cut_of(nodes: Nodes, image: GreyImage) -> Sides:
    """Return the sides on which the image ends before the next nodes, and shows cells there."""
    at, across = nodes.at, nodes.at.T
    cut = [_cut(way, image) for way in (at, at[::-1], across, across[::-1])]
    if any(cut):
        for depth in JUST_BEYOND:
            ended = _ends_at(nodes, image, depth, depth + 0.05)
            cut = [hidden and not end for hidden, end in zip(cut, ended, strict=True)]
    return Sides(*cut)


def _ends_at(nodes: Nodes, image: GreyImage, depth: float, shown: float) -> Sides:
    """Return the sides on which there are no cells that many cells from the last nodes.

    shown: how far the image must reach, cells; else the side is none of them.
    """
    at = nodes.at
    if min(at.shape) < 2:
        return NO_SIDES
    lines = [_squares(way, *rows) for way in (at, at.T) for rows in ((0, 1), (-1, -2))]
    side = np.repeat(np.arange(4), [len(line.sign) for line in lines])
    middle: Points = np.concatenate([line.middle for line in lines])
    out: Points = np.concatenate([line.out for line in lines])
    along = np.concatenate([line.along for line in lines])
    sign = np.concatenate([line.sign for line in lines])
    far: Points = middle + shown * out
    seen = _inside(far, image)
    spots = np.stack([middle + depth * out, middle - out / 2])[..., None] + SPOTS * along[:, None]
    level = sign * grey(image, spots).sum(axis=2)
    ends = []
    for number, line in enumerate(lines):
        here = seen & (side == number)
        count = np.count_nonzero(here)
        if 2 * count < len(line.sign) or count < 2 or abs(int(sign[here].sum())) == count:
            ends.append(False)
            continue
        bright, dark = here & (sign > 0), here & (sign < 0)
        beyond, inside = level[:, bright].mean(axis=1) + level[:, dark].mean(axis=1)
        ends.append(bool(abs(beyond) < FLAT * abs(inside)))
    return Sides(*ends)


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
    """Return the first and last row, first and last column with a fair share of the nodes.

    there: (R, C), where nodes are; at least one.
    """
    ends: list[int] = []
    for axis in (1, 0):
        count = there.sum(axis=axis)
        full = np.flatnonzero(count >= max(np.median(count) / 4, 1))
        ends += [int(full[0]), int(full[-1])]
    return ends[0], ends[1], ends[2], ends[3]
