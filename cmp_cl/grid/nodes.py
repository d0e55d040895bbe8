"""The nodes of a grid that is being built."""

import cmath
import copy
import functools
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import GridError
from cmp_cl.grid.grid import NodeStatus
from cmp_cl.grid.lattice import Lattice

Points = NDArray[np.complex128]  # x + 1j y, px, NaN where there is none
Index = NDArray[np.int64]
Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOWHERE = complex(np.nan, np.nan)
Entry = TypeVar("Entry", bound=np.generic)
Answer = TypeVar("Answer")
KEPT, MOST_KEPT = 4, 1 << 14  # results that `kept_by_mask` keeps, and entries of their grids
MOST_NODES, NODES_EACH = 65536, 64  # the most of any grid, and the most for each corner


class Nodes:
    """The nodes of a grid that is being built.

    at: (R, C) complex128, px; owner: (R, C) number of the corner there, -1 for none;
    status: (R, C) uint8 of NodeStatus; changed: (R, C) bool, where a node was put or dropped
    since misfits were looked for; parity: as in Grid; free: (N,) bool, corners that have not
    been in the grid; astray: (N + 1,) bool, corners that were far from the prediction of their
    neighbours, and True at the end, for nodes without a corner; predicted: the predictions of
    all nodes, (R, C) px, and their weights, None if a node has changed since.
    """

    def __init__(self, shape: tuple[int, int], parity: int, free: Mask) -> None:
        self.at: Points = np.full(shape, NOWHERE)
        self.owner: Index = np.full(shape, -1)
        self.status: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        self.changed: Mask = np.zeros(shape, np.bool_)
        self.parity = parity
        self.free = free
        self.astray: Mask = np.arange(len(free) + 1) == len(free)
        self.predicted: tuple[Points, Float] | None = None

    @property
    def there(self) -> Mask:
        """Return (R, C) bool, True where there is a node."""
        return np.not_equal(self.status, NodeStatus.MISSING.value)  # twice as fast

    def put(self, row: Index, column: Index, at: Points, status: Any) -> None:
        self.at[row, column] = at
        self.status[row, column] = status
        self.changed[row, column] = True
        self.predicted = None

    def drop(self, row: Index, column: Index) -> None:
        self.put(row, column, np.full(len(row), NOWHERE), NodeStatus.MISSING)
        self.owner[row, column] = -1

    def pad(self) -> None:
        """Add a ring of missing nodes; the parity of node (0, 0) stays."""
        self.at = np.pad(self.at, 1, constant_values=NOWHERE)
        self.owner = np.pad(self.owner, 1, constant_values=-1)
        self.status = np.pad(self.status, 1)
        self.changed = np.pad(self.changed, 1)
        self.predicted = None

    def crop(self) -> None:
        """Remove the empty rows and columns around the nodes."""
        seen = self.there
        if seen.all() or not seen.any():
            return
        rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        self.at, self.owner = self.at[box], self.owner[box]
        self.status, self.changed = self.status[box], self.changed[box]
        self.parity = (self.parity + int(rows[0]) + int(columns[0])) % 2
        self.predicted = None

    def turned(self, quarters: int) -> "Nodes":
        """Return the same nodes with the numbers turned: row 0 is the last column, and so on."""
        if not quarters:
            return self
        turned = copy.copy(self)
        turned.parity, turned.predicted = self.turned_parity(quarters), None
        for name in ("at", "owner", "status", "changed"):
            setattr(turned, name, turned_lines(getattr(self, name), quarters))
        return turned

    def turned_parity(self, quarters: int) -> int:
        """Return the parity after the numbers are turned."""
        rows, columns = self.at.shape
        return (self.parity + (0, columns, rows + columns, rows)[quarters]) % 2

    def from_sides(self) -> tuple[tuple[Points, int], ...]:
        """Return the nodes from the top, the bottom, the left and the right, and their parity.

        Row 0 is the last line of that side.
        """
        at, parity, (rows, columns) = self.at, self.parity, self.at.shape
        return (
            (at, parity),
            (at[::-1], parity + rows - 1),
            (at.T, parity + 1),
            (at.T[::-1], parity + columns),
        )

    def window(self, top: int, left: int, shape: tuple[int, int]) -> "Nodes":
        """Return the nodes in a window of that shape, whose first row and column are top and
        left."""
        if (top, left, *shape) == (0, 0, *self.at.shape):
            return self
        cut = Nodes(shape, (self.parity + top + left) % 2, self.free)
        rows, columns = self.at.shape
        here = np.s_[
            max(top, 0) : max(min(rows, top + shape[0]), 0),
            max(left, 0) : max(min(columns, left + shape[1]), 0),
        ]
        there = np.s_[
            max(-top, 0) : max(min(rows - top, shape[0]), 0),
            max(-left, 0) : max(min(columns - left, shape[1]), 0),
        ]
        cut.astray = self.astray
        for name in ("at", "owner", "status"):
            getattr(cut, name)[there] = getattr(self, name)[here]
        return cut


def kept_by_mask(function: Callable[[Mask], Answer]) -> Callable[[Mask], Answer]:
    """Keep the last results of a function of the mask of nodes, which many frames share.

    Callers must not write to the arrays of a result. Results for large grids are not kept.
    """

    @functools.lru_cache(maxsize=KEPT)
    def of_bytes(shape: tuple[int, ...], there: bytes) -> Answer:
        return function(np.frombuffer(there, np.bool_).reshape(shape))

    @functools.wraps(function)
    def kept(there: Mask) -> Answer:
        if there.size > MOST_KEPT:
            return function(there)
        return of_bytes(there.shape, there.tobytes())

    return kept


def turned_lines(values: NDArray[Entry], quarters: int) -> NDArray[Entry]:
    """Return a view of values, (R, C), turned as by np.rot90, which is slower; quarters: 0 to 3."""
    if quarters % 2:
        values = values.T
    return (values, values[::-1], values[::-1, ::-1], values[:, ::-1])[quarters]


def median(values: Float) -> float:
    """Return the median of one or more values without NaN, in a third of np.median's time."""
    first, second = (len(values) - 1) // 2, len(values) // 2
    parted = np.partition(values, (first, second) if first < second else first)
    return float(parted[first] + parted[second]) / 2


def check_room(shape: tuple[int, int], corners: int) -> None:
    """Raise GridError if a grid of that shape is far too large for that many corners."""
    if shape[0] * shape[1] > MOST_NODES + NODES_EACH * corners:
        raise GridError(
            f"a grid of {shape[0]} x {shape[1]} nodes is too large for {corners} corners, "
            f"expected at most {MOST_NODES + NODES_EACH * corners} nodes"
        )


def upright(axis: complex) -> complex:
    """Return the unit that turns a lattice with that step along +1 so that its rows run right."""
    return (1, 1j, -1, -1j)[round(cmath.phase(axis) / (cmath.pi / 2)) % 4]


def boxed(z: Points, found: Lattice, component: int = 0) -> Nodes:
    """Return a component in the box that holds it, rows down and columns right.

    Raises GridError if the box is too large for its corners.
    """
    member = np.flatnonzero(found.component == component)
    unit = upright(complex(found.axis[component]))
    node, turn = found.node.take(member) * unit, found.turn.take(member) * unit
    row, column = node.imag.astype(np.int64), node.real.astype(np.int64)
    row -= row.min()
    column -= column.min()
    shape = int(row.max()) + 1, int(column.max()) + 1
    check_room(shape, len(z))
    odd = ((turn.imag != 0) + row + column) & 1
    free = np.ones(len(z), np.bool_)
    free[member] = False
    parity = int(2 * np.count_nonzero(odd) > len(odd))
    nodes = Nodes(shape, parity, free)
    place = row * shape[1] + column
    nodes.status.ravel()[place] = NodeStatus.DETECTED
    if np.count_nonzero(nodes.there) < len(member):  # of several with one number the last stays
        best_last = np.argsort(found.support[member], kind="stable")
        member, place = member[best_last], place[best_last]
    nodes.owner.ravel()[place] = member
    nodes.at.ravel()[place] = z.take(member)
    nodes.changed[:] = True
    return nodes
