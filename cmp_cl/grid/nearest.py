"""The numbers that leave nodes nearest to a reference: the frame at rest, or the one before."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.grid import Grid
from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Nodes, Points

VOTERS = 384  # nodes that are compared with the reference
HALF = 0.5  # cells: displacements above it count less and less
UNMATCHED = 0.5  # cost of a node without a counterpart in the reference
LEAST_COMMON = 0.25  # share of the nodes that must have a counterpart in the reference
TURNED = np.deg2rad(30)  # from here on the next quarter turn is compared too
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
        at = grid.xy[..., 0] + 1j * grid.xy[..., 1].astype(np.float64)
        return cls.at_places(at, grid.parity, grid.origin)

    @classmethod
    def at_places(cls, at: Points, parity: int, origin: tuple[int, int]) -> "Reference":
        """Of positions by row and column."""
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


def _mean_step(at: Points) -> complex:
    """The mean step from a column to the next; 0 where there is none."""
    step = at[:, 1:] - at[:, :-1]
    known = step[~np.isnan(step.real)]
    return complex(known.mean()) if len(known) else 0j


class Bounds(NamedTuple):
    """The numbers that the first row and the first column can have, both ends included."""

    top: int = -FAR
    last_top: int = FAR
    left: int = -FAR
    last_left: int = FAR

    def hold(self, top: Index, left: Index) -> Mask:
        return (
            (top >= self.top)
            & (top <= self.last_top)
            & (left >= self.left)
            & (left <= self.last_left)
        )


class Choice(NamedTuple):
    """A numbering: quarter turns, then the number of the first row and column.

    cost: grows with the displacement from the reference, see `_costs`, infinite where too few
    nodes can be compared. rms: the RMS displacement, cells.
    """

    cost: float
    rms: float
    quarters: int
    top: int
    left: int

    @property
    def number(self) -> tuple[int, int, int]:
        return self.quarters, self.top, self.left


def quarter_turns(at: Points, reference: Reference) -> list[tuple[int, float]]:
    """The quarter turns that leave rows most parallel to the reference's, and the angles, rad.

    The second is there if it is nearly as good as the first.
    """
    along, down = _mean_step(at), _mean_step(at.T)
    along = along or -1j * down
    down = down or 1j * along
    ways = (along, down, -along, -down)
    angles = [abs(float(np.angle(way / reference.along))) for way in ways]
    order = np.argsort(angles, kind="stable")
    kept = order[: 2 if angles[order[0]] > TURNED else 1]
    return [(int(turn), angles[turn]) for turn in kept]


def _voters(nodes: Nodes) -> tuple[Index, Index, Points]:
    """Rows, columns and positions of some nodes all over the grid."""
    places = np.flatnonzero(nodes.there)
    some = np.linspace(0, len(places) - 1, min(VOTERS, len(places))).astype(np.int64)
    row, column = np.divmod(places[some], nodes.at.shape[1])
    return row, column, nodes.at[row, column]


def climb(nodes: Nodes, near: Reference, bounds: Bounds, quarters: int) -> list[Choice]:
    """The numbers of the right colour with the least displacement and those around them.

    Empty where no number is within the bounds.
    """
    row, column, at = _voters(nodes)
    middle = int(np.argmin(np.abs(at - at.mean())))
    away = np.abs(near.at - at[middle])
    place = int(np.nanargmin(away))
    first_row, first_column = np.divmod(place, near.shape[1])
    start: Index = np.array([first_row - row[middle], first_column - column[middle]])
    start = start + np.array(near.origin)
    start = np.clip(start, (bounds.top, bounds.left), (bounds.last_top, bounds.last_left))
    start = start + np.array([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)])
    sums = start.sum(axis=1) - sum(near.origin) + near.parity - nodes.parity
    start = start[(sums % 2 == 0) & bounds.hold(start[:, 0], start[:, 1])]
    if not len(start):
        return []
    here = start[0]
    while True:
        around = here + NEIGHBOURS
        around = around[bounds.hold(around[:, 0], around[:, 1])]
        cost, rms = _costs(near, around, row, column, at)
        best = int(np.argmin(cost))
        if (around[best] == here).all() or not np.isfinite(cost[best]):
            break
        here = around[best]
    return [
        Choice(float(each), float(off), quarters, int(top), int(left))
        for each, off, (top, left) in zip(cost, rms, around, strict=True)
        if np.isfinite(each) or len(around) == 1
    ]


def chosen(nodes: Nodes, near: Reference, quarters: int, top: int, left: int) -> Choice:
    """That numbering of nodes that are turned already, with its displacement."""
    cost, rms = _costs(near, np.array([[top, left]]), *_voters(nodes))
    return Choice(float(cost[0]), float(rms[0]), quarters, top, left)


def _displacement(
    near: Reference, first: NDArray[np.int64], row: Index, column: Index, at: Points
) -> Points:
    """From the reference's nodes, (S, M) px, for each number (S, 2) of row 0 and column 0."""
    rows = row + (first[:, :1] - near.origin[0])
    columns = column + (first[:, 1:] - near.origin[1])
    inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
    there = near.at[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    return np.where(inside, at - there, NOWHERE)


def _costs(
    near: Reference, first: NDArray[np.int64], row: Index, column: Index, at: Points
) -> tuple[Float, Float]:
    """The mean of log(1 + (d / HALF)^2) over displacements d, and their RMS, cells, (S,).

    Most of a pressed gel stays near its place, whatever the rest does: so the logarithm. Nodes
    without a counterpart add a little to the cost, and it is infinite where few have one.
    """
    away = np.abs(_displacement(near, first, row, column, at))
    known = ~np.isnan(away)
    count = known.sum(axis=1)
    away[~known] = 0
    squares = (away / near.cell) ** 2
    cost = np.log1p(squares / HALF**2).sum(axis=1) / np.maximum(count, 1)
    cost += UNMATCHED * (1 - count / len(at))
    cost[count < max(LEAST_COMMON * len(at), 1)] = np.inf
    return cost, np.sqrt(squares.sum(axis=1) / np.maximum(count, 1))


def motion(nodes: Nodes, near: Reference, choice: Choice) -> float:
    """By how much the pattern as a whole has moved by those numbers, cells.

    That is the motion of the middle of the view by the affine map that most nodes follow;
    infinite where fewer than four nodes have a counterpart.
    """
    row, column, at = _voters(nodes.turned(choice.quarters))
    moved = _displacement(near, np.array([[choice.top, choice.left]]), row, column, at)[0]
    known = ~np.isnan(moved.real)
    moved, at = moved[known] / near.cell, at[known]
    if len(moved) < 4:
        return np.inf
    middle = complex(at.real.min() + at.real.max(), at.imag.min() + at.imag.max()) / 2
    from_middle = (at - middle) / near.cell
    model = np.stack([np.ones(len(at)), from_middle, from_middle.conj()])
    weight = np.ones(len(at))
    for _ in range(3):
        weighted = model.conj() * weight
        affine = np.linalg.lstsq(weighted @ model.T, weighted @ moved, rcond=None)[0]
        off = np.abs(moved - affine @ model)
        weight = np.where(off <= max(2.5 * float(np.median(off)), 1e-3), 1.0, 0.0)
    return float(np.abs(affine[0]))
