"""A board without lines that are none of it, and what is seen at its sides.

Positions are float32 with + - * in a fixed order, levels and shares are integers, so that the
kernels give the same bits.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import UNSEEN, WHOLE, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.reference.lattice.nodes import Plane, inverse, seen_at
from cmp_cl.reference.lattice.parts import NOWHERE, F, Mask, Places, Whole, length_of, read

PAIRS = 16  # pairs of neighbouring squares of a side that are read
DEPTHS = range(2, 10)  # steps, where the last squares may end


def trimmed(board: Board, shape: tuple[int, int], k: LatticeConstants) -> Board:
    """Return the board without empty outer lines, and without those that hold less than
    `least_line` of their places in the image, and less than half of them with firm nodes. A place
    is where the next two lines predict it. The line that lacks most goes first."""
    rows, columns = np.array(shape) - 1
    edge = F(k.contrast_radius_px)
    box = [0, board.x.shape[0], 0, board.x.shape[1]]
    while True:
        all_of = board.owner, seen_at(board), board.firm
        owner, at, firm = (a[box[0] : box[1], box[2] : box[3]] for a in all_of)
        if not owner.size:
            box = [0, 0, 0, 0]
            break
        sides = list(zip(*map(ways, (owner, at, firm)), strict=True))
        empty = [not (line[0] != -1).any() for line, *_ in sides]
        worst, lines = F(0), [False] * 4
        for side, (line, place, firm_of) in enumerate(sides if not any(empty) else ()):
            if len(line) < 3:
                continue
            there = line != -1
            next_one = F(2) * place[1] - place[2]
            inside = there[1] & there[2]
            for each, size in ((next_one.real, columns), (next_one.imag, rows)):
                inside &= (each > edge) & (each < F(size) - edge)
            asked = np.count_nonzero(there[0] | inside)
            lack = F(k.least_line) * F(asked) - F(np.count_nonzero(there[0]))
            if lack > worst and 2 * np.count_nonzero(firm_of[0]) < asked:
                worst, lines = lack, [n == side for n in range(4)]
        if not any(empty) and not any(lines):
            break
        for n, cut in enumerate(empty if any(empty) else lines):
            box[n] += (1 - 2 * (n % 2)) * cut
    here = np.s_[box[0] : box[1], box[2] : box[3]]
    sign = board.sign * (1 - 2 * ((box[0] + box[2]) % 2))
    return board.changed(lambda plane: plane[here], sign=sign)


def ways(a: NDArray[Any]) -> list[NDArray[Any]]:
    """Return an array as seen from the top, the bottom, the left and the right: row 0 is the last
    line there."""
    turned = np.swapaxes(a, 0, 1)
    return [a, a[::-1], turned, turned[::-1]]


class Sides:
    """What is seen at the sides of a board, (4,) each: top, bottom, left, right.

    room: most places of a further line lie in the image. follows: cells follow. reach: of the last
    squares beyond the last nodes, 1/4096 cell, UNSEEN where the pattern is not seen to end.
    """

    def __init__(self, board: Board, plane: Plane, k: LatticeConstants) -> None:
        there = board.owner >= 0
        self.plane, self.k = plane, k
        seen = ways(np.where(there, seen_at(board), NOWHERE))
        self.room = np.array([self._has_room(way) for way in seen])
        self.follows, self.reach = np.zeros(4, np.bool_), np.full(4, UNSEEN)
        if min(there.shape) < 2:
            return
        reach = np.zeros(4, np.float32)
        for n, way in enumerate(seen):
            self.follows[n], reach[n] = self._read(way)
        cells = reach * np.array([self._last_over_next(way) for way in seen])
        reach[cells > F(1) + F(k.border_step_cells)] = 0
        self.reach = np.where(reach > 0, np.floor(F(WHOLE) * cells), UNSEEN).astype(np.int64)

    def found(self) -> list[int]:
        """Return all in the order of the kernel, after rows, columns and sign."""
        return [*self.room.tolist(), *self.follows.tolist(), *self.reach.tolist()]

    def _in_view(self, at: Places) -> Mask:
        rows, columns = self.plane.shape
        inside: Mask = (at.real >= 0) & (at.imag >= 0)
        return inside & (at.real < F(columns)) & (at.imag < F(rows))

    def _has_room(self, at: Places) -> bool:
        known = inside = 0
        far = F(self.k.beyond_cells)
        for column in at.T:
            nodes = np.flatnonzero(~np.isnan(column))
            if len(nodes) < 2 or nodes[1] != nodes[0] + 1:
                continue
            last, before = column[nodes[:2]]
            known += 1
            inside += bool(self._in_view(last + far * (last - before)))
        return 2 * inside > known

    def _read(self, nodes: Places) -> tuple[bool, np.float32]:
        """Return whether cells follow at a side, and its reach in last steps, 0 where unseen."""
        middle, before = F(0.5) * (nodes[:2, 1:] + nodes[:2, :-1])
        out, along = middle - before, nodes[0, 1:] - nodes[0, :-1]
        square = ~np.isnan(out)
        pairs = max(len(square) - 1, 0)
        some = min(pairs, PAIRS)
        first = np.arange(some) * pairs // max(some, 1)
        first = first[square[first] & square[first + 1]]
        both = np.stack([first, first + 1], axis=1)
        both = np.where(first[:, None] % 2, both[:, ::-1], both)  # an even square comes first

        def at(depth: np.float32, spot: np.float32) -> Places:
            places: Places = (middle[both] + depth * out[both]) + spot * along[both]
            return places

        further, step = F(self.k.beyond_cells), F(self.k.border_step_cells)
        both = both[self._in_view(at(further, F(0))).all(axis=1)]
        if not len(both):
            return False, F(0)
        depths = [F(-0.5), further, *(step * F(n) for n in DEPTHS)]
        spots = [step * F(n) for n in (-1, 0, 1)]
        level = np.array([sum(read(self.plane, at(d, spot)) for spot in spots) for d in depths])
        inside, beyond = (abs(int((level[n, :, 0] - level[n, :, 1]).sum())) for n in (0, 1))
        change = int(np.abs(level[0] - level[1]).sum())
        follows = bool(F(change) < F(2) * F(self.k.passing) * F(inside))
        if not F(beyond) < F(self.k.passing) * F(inside):
            return follows, F(0)
        reach = self._common(np.abs(level[..., 0] - level[..., 1]))
        return follows, F(0) if reach == UNSEEN else step * (F(1.5) + F(reach) * F(0.5 / WHOLE))

    def _last_over_next(self, at: Places) -> np.float32:
        """Return the step of the last two lines, in cells that lie past it, if steps grow on."""
        step = at[:2] - at[1:3]
        known = ~np.isnan(step).any(axis=0)
        if len(at) < 3 or not known.any():
            return F(1)
        steps = np.floor(F(32) * length_of(step[:, known], 1e-6) + F(0.5))
        last, before = steps.sum(axis=1, dtype=np.int64).astype(np.float32)[:, None]
        return F((before * inverse(last))[0])

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
