"""Finds the numbers that leave nodes nearest to a reference: the frame at rest, or the previous
one."""

import cmath
import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cmp_cl.grid.grid import Grid
from cmp_cl.grid.lattice import Complex
from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Nodes, Points, median

VOTERS = 384  # nodes that are compared with the reference
ALONE = 0.5  # cells: the cost of a node without a counterpart in the reference
MOST_ALONE = 0.75  # largest share of such nodes
TURNED = np.deg2rad(30)  # from this angle on, the next quarter turn is compared too
NEIGHBOURS = np.array(
    [(0, 0), *((r, c) for r in range(-2, 3) for c in range(-2, 3) if abs(r) + abs(c) == 2)]
)
FAR = 1 << 30  # rows or columns: no bound


class Reference(NamedTuple):
    """A grid that others are compared with.

    at: (R, C), px, NaN where missing; parity, origin: as in `Grid`; along: mean step to the
    next column, px; cell: mean side, px.
    """

    at: Points
    parity: int
    origin: tuple[int, int]
    shape: tuple[int, int]
    along: complex
    cell: float

    @classmethod
    def of(cls, grid: Grid) -> "Reference":
        """Take the nodes of a grid. The last few are kept for the other frames of a recording."""
        return _kept(grid.xy.dtype, grid.xy.tobytes(), grid.shape, grid.parity, grid.origin)

    @classmethod
    def at_places(cls, at: Points, parity: int, origin: tuple[int, int]) -> "Reference":
        """Take nodes from their positions, (R, C), and the parity and origin of their grid."""
        along, down = _mean_step(at), _mean_step(at.T)
        known = [abs(step) for step in (along, down) if step]
        return cls(
            at=at,
            parity=parity,
            origin=origin,
            shape=(at.shape[0], at.shape[1]),
            along=along or -1j * down,
            cell=float(np.mean(known)) if known else 1.0,
        )


@functools.lru_cache(maxsize=4)
def _kept(
    kind: DTypeLike, xy: bytes, shape: tuple[int, int], parity: int, origin: tuple[int, int]
) -> Reference:
    at = np.frombuffer(xy, kind).astype(np.float64).view(np.complex128).reshape(shape)
    return Reference.at_places(at, parity, origin)


def _mean_step(at: Points) -> complex:
    """Return the mean step from one column to the next; 0 if there is none."""
    step = at[:, 1:] - at[:, :-1]
    if not step.size:
        return 0j
    mean = complex(step.mean())
    if not cmath.isnan(mean):
        return mean
    known = step[~np.isnan(step.real)]
    return complex(known.mean()) if len(known) else 0j


class Bounds(NamedTuple):
    """The numbers that the first row and the first column can have, both ends included."""

    top: int = -FAR
    last_top: int = FAR
    left: int = -FAR
    last_left: int = FAR

    @property
    def only(self) -> tuple[int, int] | None:
        """Return the number within the bounds if there is exactly one, else None."""
        one = (self.top, self.left) == (self.last_top, self.last_left)
        return (self.top, self.left) if one else None

    def hold(self, top: Index, left: Index) -> Mask:
        return (
            (top >= self.top)
            & (top <= self.last_top)
            & (left >= self.left)
            & (left <= self.last_left)
        )


class Choice(NamedTuple):
    """A numbering: quarter turns, then the number of the first row and column.

    motion: the motion of the pattern's middle from the reference, cells. cost: the motion,
        increased by nodes without a counterpart there.
    """

    cost: float
    motion: float
    quarters: int
    top: int
    left: int

    @property
    def number(self) -> tuple[int, int, int]:
        return self.quarters, self.top, self.left


def quarter_turns(
    at: Points, reference: Reference, *, every: bool = False
) -> list[tuple[int, float]]:
    """Return the quarter turns that keep rows most parallel to the reference's, and their angles,
        rad.

    The second is there if it is nearly as good as the first. every: return all four.
    """
    along, down = _mean_step(at), _mean_step(at.T)
    along = along or -1j * down
    down = down or 1j * along
    ways = (along, down, -along, -down)
    angles = [abs(cmath.phase(way / reference.along)) for way in ways]
    turns = sorted(enumerate(angles), key=lambda turn: turn[1])
    return turns[: 4 if every else 2 if turns[0][1] > TURNED else 1]


def _voters(nodes: Nodes) -> tuple[Index, Index, Points]:
    """Return rows, columns and positions of some nodes, spread over the grid."""
    places = np.flatnonzero(nodes.there)
    some = np.linspace(0, len(places) - 1, min(VOTERS, len(places))).astype(np.int64)
    row, column = np.divmod(places[some], nodes.at.shape[1])
    return row, column, nodes.at[row, column]


def colour(parity: int, near: Reference) -> int:
    """Return the sum of the first row's and column's number modulo 2, by the checker colours.

    parity: of the nodes.
    """
    return (sum(near.origin) + near.parity + parity) % 2


def climb(nodes: Nodes, near: Reference, bounds: Bounds, quarters: int) -> list[Choice]:
    """Return the numbers of the right colour around the least mean displacement, the nearest first.

    nodes: already turned by `quarters` quarter turns. The result is empty if no number is within
        the bounds.
    """
    row, column, at = _voters(nodes)
    middle = int(np.argmin(np.abs(at - at.mean())))
    place = int(np.nanargmin(np.abs(near.at - at[middle])))
    first = np.array(np.divmod(place, near.shape[1])) + near.origin
    start: Index = first - [row[middle], column[middle]]
    start = np.clip(start, (bounds.top, bounds.left), (bounds.last_top, bounds.last_left))
    start = start + np.array([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)])
    top, left = start.T
    start = start[((top + left) % 2 == colour(nodes.parity, near)) & bounds.hold(top, left)]
    if not len(start):
        return []
    here = start[0]
    while True:
        around = here + NEIGHBOURS
        around = around[bounds.hold(around[:, 0], around[:, 1])]
        moved = _displacement(near, around, row, column, at) / near.cell
        alone = np.isnan(moved).mean(axis=1)  # share of nodes without a counterpart
        mean = np.nansum(np.abs(moved), axis=1) / np.maximum(1 - alone, 1e-9) / len(at)
        cost = np.where(alone <= MOST_ALONE, mean + ALONE * alone, np.inf)
        best = int(np.argmin(cost))
        if best == 0 or not np.isfinite(cost[best]):
            break
        here = around[best]
    motion = np.abs(_motion(at, near.cell, moved[0]) + _differences(moved))
    if len(around) > 1:  # the motion is unknown for numbers that hardly overlap the reference
        motion[alone > MOST_ALONE] = np.inf
    choices = [
        Choice(float(off + ALONE * lost), float(off), quarters, int(top), int(left))
        for off, lost, (top, left) in zip(motion, alone, around, strict=True)
    ]
    return sorted(choices)


def chosen(nodes: Nodes, near: Reference, quarters: int, top: int, left: int) -> Choice:
    """Return a numbering of nodes that are already turned, with its motion."""
    (choice,) = climb(nodes, near, Bounds(top, top, left, left), quarters)
    return choice


def _displacement(
    near: Reference, first: NDArray[np.int64], row: Index, column: Index, at: Points
) -> Points:
    """Return displacements, (S, M) px, for each number (S, 2) of row 0 and column 0."""
    rows = row + (first[:, :1] - near.origin[0])
    columns = column + (first[:, 1:] - near.origin[1])
    inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
    there = near.at[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    return np.where(inside, at - there, NOWHERE)


def _motion(at: Points, cell: float, moved: Points) -> complex:
    """Return the motion of the view's middle by the affine map that most nodes follow, cells.

    moved: (M,), cells. Infinite where fewer than four are known.
    """
    known = ~np.isnan(moved.real)
    moved, at = moved[known], at[known]
    if len(moved) < 4:
        return complex(np.inf)
    middle = complex(at.real.min() + at.real.max(), at.imag.min() + at.imag.max()) / 2
    from_middle = (at - middle) / cell
    model = np.stack([np.ones(len(at)), from_middle, from_middle.conj()])

    def fitted(weight: Float) -> Complex:
        weighted = model.conj() * weight
        return np.linalg.lstsq(weighted @ model.T, weighted @ moved, rcond=None)[0]

    affine = fitted(np.ones(len(at)))
    for _ in range(2):
        off = np.abs(moved - affine @ model)
        affine = fitted(np.where(off <= max(2.5 * median(off), 1e-3), 1.0, 0.0))
    return complex(affine[0])


def _differences(moved: Points) -> Points:
    """Return the mean difference of displacements (S, M) from the first, (S,), cells."""
    step = moved - moved[0]
    known = ~np.isnan(step.real)
    mean: Points = np.where(known, step, 0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return mean
