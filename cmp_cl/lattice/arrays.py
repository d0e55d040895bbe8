"""The arrays of the lattice, from parts to boards."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.int64]
Real = NDArray[np.float32]
Float = NDArray[np.float64]
Numbers = NDArray[np.complex128]  # column + 1j row
Mask = NDArray[np.bool_]
T = TypeVar("T")
FULL = 7 / 8  # of the places of a full rectangle hold a corner, of those of a disc four fifths

NONE, LOOKED = -1, -2  # owners of a node: missing, or seen where no corner was found
UNSEEN, WHOLE = -(2**31), 4096  # a reach that is not seen, and one of a whole cell


def turned_sides(sides: tuple[T, T, T, T], quarters: int) -> tuple[T, T, T, T]:
    """Return values of (top, bottom, left, right) after quarter turns, as np.rot90 turns arrays."""
    for _ in range(quarters % 4):
        top, bottom, left, right = sides
        sides = right, left, top, bottom
    return sides


# Of arrays (R, C), as np.rot90 turns them, which takes ten times as long for a board.
_TURNS: tuple[Callable[[NDArray[Any]], NDArray[Any]], ...] = (
    lambda plane: plane,
    lambda plane: plane.T[::-1],
    lambda plane: plane[::-1, ::-1],
    lambda plane: plane.T[:, ::-1],
)


class Units(NamedTuple):
    """Nodes of parts, each by itself: a corner in two parts is two units.

    corner: (M,). part: (M,) rank of the part, in order, the largest 0. number, rotation: in the
    frame of the part. rim: it has fewer than four faces there. at: (M,) complex, px. faces: (P,) of
    each part.
    """

    corner: Whole
    part: Whole
    number: Numbers
    rotation: Whole
    rim: Mask
    at: Numbers
    faces: Whole

    def chosen(self, some: Whole | Mask | slice) -> "Units":
        """Return some of the nodes, in this order."""
        *nodes, faces = self
        return Units._make([*(each[some] for each in nodes), faces])


class Votes(NamedTuple):
    """Placements of one part beside another that have votes, each once.

    first, second: (V,) ranks of the parts, the larger one first. quarter, offset: the numbers of
    the second times so many quarter turns, plus the offset, are numbers of the first. weight: of
    all votes for it.
    """

    first: Whole
    second: Whole
    quarter: Whole
    offset: Numbers
    weight: Float

    def chosen(self, some: Whole | Mask) -> "Votes":
        """Return some of the votes, in this order."""
        return Votes._make(each[some] for each in self)


class Border(NamedTuple):
    """The sides of a board: top, bottom, left, right, each (4,).

    reach: cells, of its last squares beyond its last nodes, 1 if they are whole; NaN where the
    pattern is not seen to end. follows: the pattern goes on. room: most places of a further line
    lie in the image. beyond: lines, as far as corners lie on the lattice there that are no nodes.
    """

    reach: Float
    follows: Mask
    room: Mask
    beyond: Whole = np.zeros(4, np.int64)

    @classmethod
    def of(cls, found: NDArray[np.int32]) -> "Border":
        """Return the sides from what kernels/borders.cl found: the numbers after FOUND."""
        room, follows, share = found.reshape(3, 4)
        reach = np.where(share == UNSEEN, np.nan, share / WHOLE)
        return cls(reach, follows.astype(np.bool_), room.astype(np.bool_))

    @property
    def ends(self) -> Mask:
        ends: Mask = ~np.isnan(self.reach)
        return ends

    def turned(self, quarters: int) -> "Border":
        """Return the same after as many quarter turns of the board, as np.rot90 turns arrays."""
        order = list(turned_sides((0, 1, 2, 3), quarters))
        return Border._make(values[order] for values in self)


NOT_SEEN = Border(
    reach=np.full(4, np.nan),
    follows=np.zeros(4, np.bool_),
    room=np.zeros(4, np.bool_),
)


@dataclasses.dataclass(eq=False, kw_only=True)
class Board:
    """Nodes of one board, (R, C).

    x, y: px, NaN where missing. owner: their corner, LOOKED or NONE. torn: the position of the
    corner is rough, so that x, y come in part from the neighbours. firm: it is not, and the two
    cells of each colour are alike; empty if unknown. spread: px^2, the variance that the neighbours
    leave a rough corner, 0 of others; empty if unknown. sign: +1 if the boundary of node (0, 0)
    towards greater columns is from white to black, clockwise, else -1. border: what is seen at its
    sides.
    """

    x: Real
    y: Real
    owner: NDArray[np.integer[Any]]
    torn: Mask
    sign: int
    border: Border = NOT_SEEN
    firm: Mask = dataclasses.field(default_factory=lambda: np.zeros((0, 0), np.bool_))
    spread: Real = dataclasses.field(default_factory=lambda: np.zeros((0, 0), np.float32))

    @property
    def there(self) -> Mask:
        there: Mask = self.owner != NONE
        return there

    @functools.cached_property
    def at(self) -> Numbers:
        """Return the positions of corners, px, NaN where there is none, (R, C)."""
        at = np.empty(self.x.shape, np.complex128)
        at.real, at.imag = self.x, self.y
        at[self.owner < 0] = np.nan
        return at

    @functools.cached_property
    def outer_lines(self) -> tuple[int, int, int, int]:
        """Return the first and last row, first and last column that hold corners."""
        rows, columns = (np.flatnonzero(line).tolist() for line in self.lines)
        return rows[0], rows[-1], columns[0], columns[-1]

    @property
    def farthest_lines(self) -> tuple[int, int, int, int]:
        """Return the same with the lines beyond, on which corners lie that are no nodes."""
        top, bottom, left, right = self.outer_lines
        above, below, before, after = self.border.beyond.tolist()
        return top - above, bottom + below, left - before, right + after

    @functools.cached_property
    def steps(self) -> tuple[complex, complex]:
        """Return the mean steps between corners to the next column and the next row, px."""
        steps = []
        for step in (self.at[:, 1:] - self.at[:, :-1], self.at[1:] - self.at[:-1]):
            known = step[~np.isnan(step)]
            steps.append(complex(known.sum() / len(known)) if len(known) else 0j)
        along, down = steps
        return along or -1j * down, down or 1j * along

    @functools.cached_property
    def lines(self) -> tuple[Mask, Mask]:
        """Return which of its rows, and which of its columns, hold a corner."""
        mine = self.owner >= 0
        rows, columns = (np.logical_or.reduce(mine, axis=axis) for axis in (1, 0))
        return rows, columns

    @functools.cached_property
    def regions(self) -> list[Whole]:
        """Return the corners of the two largest regions of cells whose four nodes are firm.

        A pattern that goes on as another by chance hangs on it by a single side, or by rough
        corners, or by ones on its outline, where cells of one colour differ. Lines without a corner
        are left out.
        """
        held = np.ix_(*self.lines)
        firm, owner = self.firm[held], self.owner[held]
        cells = np.pad(firm[:-1, :-1] & firm[1:, :-1] & firm[:-1, 1:] & firm[1:, 1:], 1)
        _, region, of_region, _ = cv2.connectedComponentsWithStats(
            cells.astype(np.uint8), connectivity=4
        )
        found = []
        for largest in 1 + np.argsort(-of_region[1:, cv2.CC_STAT_AREA], kind="stable")[:2]:
            own = region == largest
            nodes = own[:-1, :-1] | own[1:, :-1] | own[:-1, 1:] | own[1:, 1:]
            found.append(owner[nodes].astype(np.int64))
        return found

    @property
    def hanging(self) -> int:
        """Return the corners of the second region, 0 without one."""
        return len(self.regions[1]) if len(self.regions) > 1 else 0

    @property
    def has_firm_sides(self) -> bool:
        """Return whether half of the nodes of each outer line, or more, are firm."""
        sides = self.firm[0], self.firm[-1], self.firm[:, 0], self.firm[:, -1]
        return all(2 * np.count_nonzero(side) >= len(side) for side in sides)

    @property
    def ended(self) -> int:
        """Return on how many sides its border is seen, if it is a full rectangle but for a few
        corners, else 0; 4 if it has every corner, and a further line on any side would be in view.
        """
        held = np.count_nonzero(self.owner >= 0) / max(self.owner.size, 1)
        if held == 1 and (self.border.room & ~self.border.follows).all():
            return 4
        return int(np.count_nonzero(self.border.ends)) if held >= FULL else 0

    @property
    def ends_nowhere(self) -> bool:
        """Return whether no border of it is seen, as of the ground behind a board."""
        return not (self.ended or self.border.ends.any())

    def layout(self, some: Mask) -> tuple[Whole, Numbers, Whole]:
        """Return some of its corners, (R, C); their numbers; and quarter turns that are odd where
        the first boundary of a corner runs down a column."""
        row, column = np.nonzero(some)
        corner = self.owner[row, column].astype(np.int64)
        return corner, column + 1j * row, row + column + (self.sign < 0)

    def parity(self) -> Whole:
        """Return `sign` at every node, (R, C)."""
        rows, columns = self.x.shape
        return self.sign * (1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) & 1))

    def turned(self, quarters: int) -> "Board":
        """Return the board after quarter turns: after one, row 0 is the former last column."""
        if not quarters % 4:
            return self
        rows, columns = self.x.shape
        odd = (0, columns, rows + columns, rows)[quarters % 4] % 2
        return self.changed(
            _TURNS[quarters % 4],
            sign=self.sign * (1 - 2 * odd),
            border=self.border.turned(quarters),
        )

    def upright(self) -> "Board":
        """Return the board turned so that its rows follow the image's x axis: the steps to the next
        column, and those to the next row, turned back by a quarter, are nearest to it."""
        along, down = self.steps
        way = along - 1j * down
        if abs(way.real) >= abs(way.imag):
            return self.turned(2 if way.real < 0 else 0)
        return self.turned(1 if way.imag < 0 else 3)

    def changed(self, change: Callable[[NDArray[Any]], NDArray[Any]], **others: Any) -> "Board":
        """Return the board with what `change` makes of each of its arrays (R, C), and others."""
        for name in ("x", "y", "owner", "torn", "firm", "spread"):
            others[name] = change(vars(self)[name])
        return dataclasses.replace(self, **others)
