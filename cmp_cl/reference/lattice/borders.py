"""A board without lines that are none of it, and what is seen at its sides.

Positions are float32 with + - * in a fixed order, levels and shares are integers, so that the
kernels give the same bits.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import UNSEEN, WHOLE, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.reference.lattice.nodes import Plane, inverse
from cmp_cl.reference.lattice.parts import (
    F,
    Mask,
    Real,
    Whole,
    length_of,
    read,
)

PAIRS = 16  # pairs of neighbouring squares of a side that are read
DEPTHS = range(2, 10)  # steps, where the last squares may end
Positions = tuple[Real, Real]  # x, y, px, NaN where missing


def trimmed(board: Board, shape: tuple[int, int], k: LatticeConstants) -> Board:
    """Return the board without empty outer lines, and without those that hold less than
    `least_line` of their places in the image, and less than half of them with firm nodes. A place
    is where the next two lines predict it. The line that lacks most goes first."""
    rows, columns = np.array(shape) - 1
    edge = F(k.contrast_radius_px)
    box = [0, board.x.shape[0], 0, board.x.shape[1]]
    while True:
        all_of = board.owner, board.x, board.y, board.firm
        owner, x, y, firm = (a[box[0] : box[1], box[2] : box[3]] for a in all_of)
        if not owner.size:
            box = [0, 0, 0, 0]
            break
        sides = list(zip(*map(_ways, (owner, x, y, firm)), strict=True))
        empty = [not (line[0] != -1).any() for line, *_ in sides]
        worst, lines = F(0), [False] * 4
        for side, (line, x_of, y_of, firm_of) in enumerate(sides if not any(empty) else ()):
            if len(line) < 3:
                continue
            there = line != -1
            px, py = F(2) * x_of[1] - x_of[2], F(2) * y_of[1] - y_of[2]
            inside = there[1] & there[2] & (px > edge) & (px < F(columns) - edge)
            inside &= (py > edge) & (py < F(rows) - edge)
            asked = np.count_nonzero(there[0] | inside)
            lack = F(k.least_line) * F(asked) - F(np.count_nonzero(there[0]))
            if lack > worst and 2 * np.count_nonzero(firm_of[0]) < asked:
                worst, lines = lack, [n == side for n in range(4)]
        if not any(empty) and not any(lines):
            break
        for n, cut in enumerate(empty if any(empty) else lines):
            box[n] += (1 - 2 * (n % 2)) * cut
    here = np.s_[box[0] : box[1], box[2] : box[3]]
    return Board(
        x=board.x[here],
        y=board.y[here],
        owner=board.owner[here],
        torn=board.torn[here],
        sign=board.sign * (1 - 2 * ((box[0] + box[2]) % 2)),
        firm=board.firm[here],
    )


def upright(board: Board) -> Board:
    """Return the board turned so that its columns follow the image's x axis: the sum of the steps
    to the next column, and of those to the next row, turned back by a quarter, 1/32 px."""
    x, y = (np.where(board.owner >= 0, each, F(np.nan)) for each in (board.x, board.y))
    (ax, ay), (dx, dy) = ([_sum_of(np.diff(each, axis=axis)) for each in (x, y)] for axis in (1, 0))
    way = ax + dy, ay - dx
    if abs(way[0]) >= abs(way[1]):
        return board.turned(2 if way[0] < 0 else 0)
    return board.turned(1 if way[1] < 0 else 3)


def _sum_of(steps: Real) -> int:
    return int(np.floor(F(32) * steps[~np.isnan(steps)] + F(0.5)).astype(np.int64).sum())


def _ways(a: NDArray[Any]) -> list[NDArray[Any]]:
    """Return an array as seen from the top, the bottom, the left and the right: row 0 is the last
    line there."""
    return [a, a[::-1], a.T, a.T[::-1]]


class Sides:
    """What is seen at the sides of a board, (4,) each: top, bottom, left, right.

    room: most places of a further line lie in the image, and it can be seen that there is none.
    follows: cells follow. reach: of the last squares beyond the last nodes, 1/4096 cell, UNSEEN
    where the pattern is not seen to end.
    """

    def __init__(self, board: Board, plane: Plane, k: LatticeConstants) -> None:
        there = board.owner >= 0
        self.plane, self.k = plane, k
        self.x = np.where(there, board.x, F(np.nan))
        self.y = np.where(there, board.y, F(np.nan))
        self.ways = list(zip(_ways(self.x), _ways(self.y), strict=True))
        self.room = np.array([self._has_room(*way) for way in self.ways])
        self.follows, self.reach = np.zeros(4, np.bool_), np.full(4, UNSEEN)
        if min(there.shape) < 2:
            return
        reach = np.zeros(4, np.float32)
        for n, way in enumerate(self.ways):
            self.follows[n], reach[n] = self._read(*way)
        cells = reach * np.array([self._last_over_next(*way) for way in self.ways])
        longer = cells > F(1) + F(k.border_step_cells)
        reach[longer] = 0
        self.reach = np.where(reach > 0, np.floor(F(WHOLE) * cells), UNSEEN).astype(np.int64)
        self.room &= ~(self.follows | longer.any())

    def found(self) -> list[int]:
        """Return all in the order of the kernel, after rows, columns and sign."""
        return [
            *self.room.tolist(),
            *self.follows.tolist(),
            *self.reach.tolist(),
        ]

    def _in_view(self, x: Real, y: Real) -> Mask:
        rows, columns = self.plane.shape
        inside: Mask = (x >= 0) & (y >= 0) & (x < F(columns)) & (y < F(rows))
        return inside

    def _has_room(self, x: Real, y: Real) -> bool:
        known = inside = 0
        far = F(self.k.beyond_cells[0])
        for column in range(x.shape[1]):
            nodes = np.flatnonzero(~np.isnan(x[:, column]))
            if len(nodes) < 2 or nodes[1] != nodes[0] + 1:
                continue
            (x1, x2), (y1, y2) = x[nodes[:2], column], y[nodes[:2], column]
            known += 1
            inside += bool(self._in_view(x1 + far * (x1 - x2), y1 + far * (y1 - y2)))
        return 2 * inside > known

    def _read(self, x: Real, y: Real) -> tuple[bool, np.float32]:
        """Return whether cells follow at a side, and its reach in last steps, 0 where unseen."""
        middle, out, along = [], [], []
        for a in (x, y):
            middles = F(0.5) * (a[:2, 1:] + a[:2, :-1])
            middle.append(middles[0])
            out.append(middles[0] - middles[1])
            along.append(a[0, 1:] - a[0, :-1])
        square = ~np.isnan(out[0])
        first = np.flatnonzero(square[:-1] & square[1:])
        asked = min(len(first), PAIRS)
        first = first[np.arange(asked) * len(first) // max(asked, 1)]
        both = np.stack([first, first + 1], axis=1)
        both = np.where(first[:, None] % 2, both[:, ::-1], both)  # an even square comes first

        def at(depth: np.float32, spot: np.float32) -> Positions:
            return tuple((middle[n][both] + depth * out[n][both]) + spot * along[n][both]
                         for n in (0, 1))  # fmt: skip

        cells = [F(each) for each in self.k.beyond_cells]
        seen = [self._in_view(*at(depth, F(0))).all(axis=1) for depth in cells]
        near = bool(2 * np.count_nonzero(seen[0]) < asked)
        both = both[seen[near]]
        if not len(both) or 2 * len(both) < asked:
            return False, F(0)
        step = F(self.k.border_step_cells)
        depths = [F(-0.5), cells[near], *(step * F(n) for n in DEPTHS)]
        spots = [step * F(n) for n in (-1, 0, 1)]
        level = np.array([sum(read(self.plane, *at(d, spot)) for spot in spots) for d in depths])
        inside, beyond = (abs(int((level[n, :, 0] - level[n, :, 1]).sum())) for n in (0, 1))
        change = int(np.abs(level[0] - level[1]).sum())
        follows = bool(F(change) < F(2) * F(self.k.passing) * F(inside))
        if not F(beyond) < F(self.k.passing) * F(inside):
            return follows, F(0)
        reach = self._common(np.abs(level[..., 0] - level[..., 1]))
        return follows, F(0) if reach == UNSEEN else step * (F(1.5) + F(reach) * F(0.5 / WHOLE))

    def _last_over_next(self, x: Real, y: Real) -> np.float32:
        """Return the step of the last two lines, in cells that lie past it, if steps grow on."""
        dx, dy = x[:2] - x[1:3], y[:2] - y[1:3]
        known = ~np.isnan(dx).any(axis=0)
        if len(x) < 3 or not known.any():
            return F(1)
        steps = np.floor(F(32) * self._length(dx[:, known], dy[:, known]) + F(0.5))
        last, before = steps.sum(axis=1, dtype=np.int64).astype(np.float32)[:, None]
        return F((before * inverse(last))[0])

    @staticmethod
    def _length(x: Real, y: Real) -> Real:
        return length_of(np.maximum(x * x + y * y, F(1e-6)))

    @staticmethod
    def _common(contrast: Whole) -> int:
        """Return the median reach of pairs of squares, doubled, if they reach equally far.

        contrast: (depths, pairs). The medians of both halves may differ by a step.
        """
        inside = np.maximum(contrast[0], 1)
        reach = (np.minimum(contrast[2:], inside) * WHOLE // inside).sum(axis=0)
        part = (len(reach) + 1) // 2
        apart = abs(_doubled_median(reach[:part]) - _doubled_median(reach[-part:]))
        return _doubled_median(reach) if apart <= 2 * WHOLE else UNSEEN


def _doubled_median(values: Whole) -> int:
    ordered = np.sort(values)
    return int(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
