"""The border of a pattern: the sides on which it ends in the view."""

import math
import statistics
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.evidence import HIDDEN, grey, in_view
from cmp_cl.grid.grid import NO_SIDES, UNSEEN, Grid, Sides, turned_sides
from cmp_cl.grid.nodes import (
    NOWHERE,
    Entry,
    Float,
    Index,
    Mask,
    Nodes,
    Points,
    kept_by_mask,
    median,
)
from cmp_cl.image import GreyImage

BEYOND = 1.5  # cells from the last nodes: the middle of the cells that a longer pattern has there
JUST_BEYOND = (0.8, 1.1, 1.2)  # cells: late in the first squares beyond, early in the second
FLAT = 0.3  # share of the contrast of the last cells: below it, no cells follow
SAME = 0.2  # share of it: if levels two cells apart differ by less in the mean, cells follow
# Cells from a square's middle: points at which its grey level is sampled.
SPOTS = np.array([-0.15, 0.0, 0.15])
MOST = 23  # most squares of a side that are examined; odd, so that equal steps reach both colours
STEP = 0.1  # cells
# Cells from the last nodes: depths at which the last squares may end.
DEPTHS = np.arange(0.3, 1.45, STEP)
PROFILE = np.concatenate([[-0.5], DEPTHS])  # the middle of the squares, then these depths
PARALLEL = 0.11  # cells: three of four reaches must be as near to their median, and the halves'
ALIKE = 0.12  # cells: greatest difference between the reach of a side in two images
PAST = np.array([0.3, 0.6, 0.9])  # cells past the pattern, where its border line has ended
ACROSS_LINE = np.array([[-0.3], [0.3]])  # cells to either side of the border's line
ROWS = np.array([0, 0, -1, -1, 0, -1, 0, -1])  # the corners at the ends of the four sides
COLUMNS = np.array([0, -1, 0, -1, 0, 0, -1, -1])
INNER_ROWS, INNER_COLUMNS = np.where(ROWS, -2, 1), np.where(COLUMNS, -2, 1)
ASIDE = np.array([2, 3, 2, 3, 0, 1, 0, 1])  # the sides that meet them there
STEPPED = 0.2  # share of the contrast of two squares: least step between the sides of that line
PAIRS = 16  # pairs of neighbouring squares of a side whose ends are searched


FourSides = tuple[float, float, float, float]  # top, bottom, left, right; NaN where unknown


class Border(NamedTuple):
    """The border of a pattern in the view, by side.

    reach: how far its last squares reach beyond its last nodes, cells, NaN where it does not
    end. past: the difference of the image between the two sides of that line past the pattern, as a
    share of the pattern's contrast; NaN where that is not in view. followed: the sides on which
    further cells follow.
    """

    reach: FourSides = UNSEEN
    past: FourSides = UNSEEN
    followed: Sides = NO_SIDES

    @classmethod
    def of(cls, grid: Grid) -> "Border":
        return cls(grid.reach, grid.past)

    @property
    def sides(self) -> Sides:
        """Return the sides on which the pattern ends in the view."""
        return Sides(*(not math.isnan(reach) for reach in self.reach))

    @property
    def passing(self) -> Sides:
        """Return the sides whose line continues past the pattern.

        The edge of an object that hides a part of the pattern continues past its end. So does the
        edge of a sheet that was cut along its squares.
        """
        return Sides(*(abs(step) > STEPPED for step in self.past))

    @property
    def opposed(self) -> "Border":
        """Return the same with only the sides whose opposite side is a border too."""
        return self.without(Sides(*(not both for both in self.sides.opposed)))

    @property
    def lone(self) -> Sides:
        """Return the sides whose line continues past the pattern, and whose opposite side is no
        border."""
        sides = zip(self.passing, self.sides.opposed, strict=True)
        return Sides(*(passes and not both for passes, both in sides))

    def without(self, sides: Sides) -> "Border":
        """Return the same with no border on those sides."""
        return self._replace(reach=_without(self.reach, sides), past=_without(self.past, sides))

    def turned(self, quarters: int) -> "Border":
        """Return the same after the numbers are turned as in `Grid.turned`."""
        return Border(
            turned_sides(self.reach, quarters),
            turned_sides(self.past, quarters),
            self.followed.turned(quarters),
        )

    def contradicts(self, other: "Border") -> Sides:
        """Return the sides on which one of the two borders is the edge of an object that hides the
            pattern.

        Both patterns end there, but their squares do not reach equally far, or the line continues
        past the pattern in only one of the two.
        """
        sides = zip(self.reach, other.reach, self.past, other.past, strict=True)
        return Sides(*(abs(a - b) > ALIKE or abs(c - d) > STEPPED for a, b, c, d in sides))


def _without(values: FourSides, sides: Sides) -> FourSides:
    top, bottom, left, right = (
        math.nan if side else value for value, side in zip(values, sides, strict=True)
    )
    return top, bottom, left, right


class Ends(NamedTuple):
    """The ends of a pattern in the view.

    border: the sides on which nodes end inside the image, with no cell beyond. cut: the sides on
        which the image ends before the next nodes. passing: the sides of a border whose line
        continues past the pattern.
    """

    border: Sides = NO_SIDES
    cut: Sides = NO_SIDES
    passing: Sides = NO_SIDES

    def turned(self, quarters: int) -> "Ends":
        """Return the same after the numbers are turned as in `Grid.turned`."""
        return Ends(*(sides.turned(quarters) for sides in self))


def border_of(nodes: Nodes, image: GreyImage) -> Border:
    """Return the border: the sides on which nodes end in the image and no cell follows.

    The last squares must reach equally far along the whole side, because the edge of an object in
    front of the pattern cuts squares at any depth.
    """
    if min(nodes.at.shape) < 2:
        return Border()
    squares = _squares(nodes.at)
    ended, followed = _ends_at(nodes, squares, image, BEYOND, BEYOND + 0.25)
    if not any(ended):
        return Border(followed=followed)
    reach = _reaches(nodes, squares, ended, image)
    return Border(reach, _past(nodes, image, reach), followed)


def _reaches(nodes: Nodes, squares: Points, ended: Sides, image: GreyImage) -> FourSides:
    """Return how far the squares before the last nodes of those sides reach, cells.

    squares: as of `_squares`. A square ends where its contrast to the one beside it does. The reach
    of the two is the sum of that contrast over depths, as a share of that between the last two
    lines of nodes. The visible part of the squares beyond, in which black and white are exchanged,
    is included. The result is NaN if the squares do not reach equally far.
    """
    side, first = _pairs(nodes.there)
    asked = np.array(ended)[side]
    side, first = side[asked], first[asked]
    pairs = squares[:, side[:, None], first[:, None] + [0, 1]]
    shown = in_view(pairs[0] + DEPTHS[-1] * pairs[1], image).all(axis=1)
    middle, out, along = pairs[:, shown, :, None]
    spots = middle + PROFILE * out + SPOTS[:, None, None, None] * along
    level = grey(image, spots).sum(axis=0)
    contrast = np.abs(level[:, 0] - level[:, 1])
    share = np.minimum(contrast[:, 1:] / np.maximum(contrast[:, :1], 1), 1)
    around = np.zeros((len(share), len(DEPTHS) + 4))
    around[:, 2:-2] = share
    before = np.maximum(around[:, :-4], around[:, 1:-3])
    after = np.maximum(around[:, 3:-1], around[:, 4:])
    share = np.maximum(share, np.minimum(before, after))  # where black and white change places
    reach = DEPTHS[0] - STEP / 2 + STEP * share.sum(axis=1)
    side = side[shown]
    rows, columns = nodes.at.shape
    top, bottom, left, right = (
        common_reach(reach[side == number], size)
        for number, size in enumerate((columns, columns, rows, rows))
    )
    return top, bottom, left, right


def _outer(at: NDArray[Entry], nothing: complex) -> NDArray[Entry]:
    """Return the last line of nodes of each side and the one before it, (2, 4, L).

    at: (R, C), at least two of each; L is the larger. Shorter lines are filled with `nothing`.
    """
    lines = np.full((2, 4, max(at.shape)), nothing, at.dtype)
    for number, way in enumerate((at, at[::-1], at.T, at.T[::-1])):
        lines[:, number, : way.shape[1]] = way[:2]
    return lines


@kept_by_mask
def _pairs(there: Mask) -> tuple[Index, Index]:
    """Return the sides of some pairs of neighbouring squares, and the first nodes on them."""
    seen = np.logical_and(*_outer(there, False))
    return _sampled(seen[:, :-2] & seen[:, 1:-1] & seen[:, 2:], PAIRS)


@kept_by_mask
def _ends(there: Mask) -> tuple[Index, Index]:
    """Return the sides of some squares, and the first nodes on them.

    A side at which less than half of the lines end has none.
    """
    seen = np.logical_and(*_outer(there, False))
    square = seen[:, 1:] & seen[:, :-1]
    across, down = (np.count_nonzero(there.any(axis)) for axis in (0, 1))
    square[2 * np.count_nonzero(square, axis=1) < np.repeat([across, down], 2) - 1] = False
    return _sampled(square, MOST)


def _sampled(shown: Mask, most: int) -> tuple[Index, Index]:
    """Return the sides and the indices on them, evenly spread, of some entries that are True.

    shown: (4, L), by side. most: of each side.
    """
    count = np.count_nonzero(shown, axis=1)
    number = np.minimum(count, most)
    side = np.repeat(np.arange(4), number)
    rank = np.arange(len(side)) - (np.cumsum(number) - number)[side]
    chosen = (np.cumsum(count) - count)[side] + rank * count[side] // number[side]
    place = np.flatnonzero(shown)[chosen]
    return side, place - side * shown.shape[1]


def _squares(at: Points) -> Points:
    """Return the middle of the side that each last square has on the last line, and the steps
    out of the pattern and along it, px.

    at: (R, C), at least two of each. Returns (3, 4, L - 1), by side, then by the node on the
    line that a square begins at; L as of `_outer`.
    """
    lines = _outer(at, NOWHERE)
    one, other = lines[..., :-1], lines[..., 1:]
    middle, inner = (one + other) / 2
    return np.stack([middle, middle - inner, other[0] - one[0]])


def common_reach(reach: Float, columns: int) -> float:
    """Return the median reach of pairs, (columns,); NaN if they do not reach equally far.

    Three of four must be near the median, and the medians of both halves near each other: along an
    oblique edge they differ. A single pair cannot show whether squares reach equally far.
    """
    count = len(reach)
    if count < max(min(2, columns - 2), 1):
        return math.nan
    reaches = reach.tolist()
    middling = statistics.median(reaches)
    off = sorted(abs(each - middling) for each in reaches)
    half = count // 2
    halves = (reaches[:half], reaches[-half:]) if half > 2 else (reaches, reaches)
    first, last = map(statistics.median, halves)
    near = max(off[(3 * count - 1) // 4], abs(first - last)) <= PARALLEL
    return middling if near else math.nan


def cut_of(nodes: Nodes, image: GreyImage) -> Sides:
    """Return the sides on which the image ends before the next nodes but shows their cells."""
    at, across = nodes.at, nodes.at.T
    cut = [_cut(way, image) for way in (at, at[::-1], across, across[::-1])]
    if any(cut) and min(at.shape) > 1:
        squares = _squares(at)
        for depth in JUST_BEYOND:
            ended, _ = _ends_at(nodes, squares, image, depth, depth + 0.05)
            cut = [hidden and not end for hidden, end in zip(cut, ended, strict=True)]
    return Sides(*cut)


def _past(nodes: Nodes, image: GreyImage, reach: FourSides) -> FourSides:
    """Return the difference of the image between the two sides of each border line, past the
        pattern.

    If both corners of a side are in view it is the smaller of two differences, or 0 if their signs
    differ: the edge of an object that hides the pattern continues past both.
    """
    at, middle = nodes.at, len(nodes.at) // 2
    squares = (at[middle - 1, 1:] + at[middle, :-1]) / 2
    level = np.sort(grey(image, squares[~np.isnan(squares.real)]))
    if len(level) < 2:
        return UNSEEN
    contrast = max(float(level[3 * len(level) // 4] - level[len(level) // 4]), 1.0)
    corner = at[ROWS, COLUMNS]
    down, across = corner - at[INNER_ROWS, COLUMNS], corner - at[ROWS, INNER_COLUMNS]
    out = np.concatenate([down[:4], across[4:]])[:, None, None]
    along = np.concatenate([across[:4], down[4:]])[:, None, None]
    reaches = np.array(reach)[:, None, None]
    depth = reaches.repeat(2, axis=0) + ACROSS_LINE
    spots = corner[:, None, None] + depth * out + (reaches[ASIDE] + PAST) * along
    shown = in_view(spots, image).all(axis=(1, 2))
    spots[~shown] = 0
    level = grey(image, spots).mean(axis=2)
    step = np.where(shown, (level[:, 1] - level[:, 0]) / contrast, math.nan)
    first, second = step[::2], step[1::2]
    least = np.minimum(np.maximum(0, np.fmin(first, second)), np.fmax(first, second))
    top, bottom, left, right = least.tolist()
    return top, bottom, left, right


def _ends_at(
    nodes: Nodes, squares: Points, image: GreyImage, depth: float, shown: float
) -> tuple[Sides, Sides]:
    """Return the sides on which no cells follow at a depth beyond the last nodes, and those on
    which cells of the pattern follow.

    squares: as of `_squares`. depth: cells. shown: the image must reach that far, cells, or the
        side is left out.
    """
    side, first = _ends(nodes.there)
    middle, out, along = squares[:, side, first]
    sign = 1 - 2 * (first % 2)
    far: Points = middle + shown * out
    seen = in_view(far, image)
    spots = np.array([middle + depth * out, middle - out / 2]) + SPOTS[:, None, None] * along
    level = (sign * grey(image, spots).sum(axis=0))[:, seen]
    group = (2 * side + (sign > 0))[seen]  # dark squares of the first side, bright ones, ...
    count = np.bincount(group, minlength=8)
    total = np.array([np.bincount(group, each, 8) for each in level])
    beyond, inside = np.abs((total / np.maximum(count, 1)).reshape(2, 4, 2).sum(axis=2))
    dark, bright = count.reshape(4, 2).T
    change = np.bincount(side[seen], np.abs(level[0] - level[1]), 4) / np.maximum(dark + bright, 1)
    looked = np.bincount(side, minlength=4)
    both = (2 * (dark + bright) >= looked) & (dark > 0) & (bright > 0)
    ended, followed = beyond < FLAT * inside, change < SAME * inside
    return Sides(*(both & ended).tolist()), Sides(*(both & followed).tolist())


def _cut(at: Points, image: GreyImage) -> bool:
    """Return whether most columns, (R, C) px, have no space in the image before the first node."""
    seen = ~np.isnan(at.real)
    column = np.flatnonzero(seen.any(axis=0))
    first = seen.argmax(axis=0)[column]
    second = np.minimum(first + 1, len(at) - 1)
    one, two = at[first, column], at[second, column]
    known = ~np.isnan(two.real) & (second > first)
    beyond = ~in_view((one + (1 + HIDDEN) * (one - two))[known], image)
    return 2 * int(np.count_nonzero(beyond)) > len(beyond)


def full_lines(there: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the first and last row, first and last column with a fair share of the nodes.

    there: (R, C), where nodes are; at least one.
    """
    if there.all():
        return 0, there.shape[0] - 1, 0, there.shape[1] - 1
    ends: list[int] = []
    for axis in (1, 0):
        count = there.sum(axis=axis)
        full = np.flatnonzero(count >= max(median(count) / 4, 1))
        ends += [int(full[0]), int(full[-1])]
    return ends[0], ends[1], ends[2], ends[3]
