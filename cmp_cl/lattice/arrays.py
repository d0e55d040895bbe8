"""The arrays of the lattice, from parts to boards."""

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from cmp_cl.lattice.borders import Border

Whole = NDArray[np.int64]
Real = NDArray[np.float32]
Float = NDArray[np.float64]
Numbers = NDArray[np.complex128]  # column + 1j row
Mask = NDArray[np.bool_]

NONE, LOOKED = -1, -2  # owners of a node: missing, or seen where no corner was found


class Units(NamedTuple):
    """Nodes of parts, each by itself: a corner in two parts is two units.

    corner: (M,). part: (M,) rank of the part, in order, the largest 0. number, rotation: in the
    frame of the part. rim: it has fewer than four faces there. at: (M,) complex, px.
    """

    corner: Whole
    part: Whole
    number: Numbers
    rotation: Whole
    rim: Mask
    at: Numbers


class Votes(NamedTuple):
    """Ways between units of two parts along which the colours change after every step.

    first, second: (V,) units. boundary, other: the boundaries at both ends. steps: of the way.
    weight: of the vote.
    """

    first: Whole
    second: Whole
    boundary: Whole
    other: Whole
    steps: Whole
    weight: Float


@dataclasses.dataclass(eq=False, kw_only=True)
class Board:
    """Nodes of one board, (R, C).

    x, y: px, NaN where missing. owner: their corner, LOOKED or NONE. torn: the position of the
    corner is rough, so that x, y come in part from the neighbours. sign: +1 if the boundary of node
    (0, 0) towards greater columns is from white to black, clockwise, else -1. border: what is seen
    at its sides, None if that is not measured.
    """

    x: Real
    y: Real
    owner: NDArray[np.integer[Any]]
    torn: Mask
    sign: int
    border: "Border | None" = None

    @property
    def there(self) -> Mask:
        there: Mask = self.owner != NONE
        return there

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
        return Board(
            x=np.rot90(self.x, quarters),
            y=np.rot90(self.y, quarters),
            owner=np.rot90(self.owner, quarters),
            torn=np.rot90(self.torn, quarters),
            sign=self.sign * (1 - 2 * odd),
            border=self.border and self.border.turned(quarters),
        )
