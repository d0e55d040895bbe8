"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Board, Mask
from cmp_cl.lattice.joins import Placed, joined
from cmp_cl.lattice.plan import LatticePlan

LEAST_FACES = 4  # of a part where no other is larger
LEAST_PIECE = 12  # corners


def boards(plan: LatticePlan, xy: NDArray[np.float32]) -> Iterator[Board]:
    """Yield the boards of a frame that was started, upright, with their borders, the largest part's
    first.

    xy: (N, 2), the corners of the plan, px. A corner is a node of one board at most. If no part has
    `least_part` faces, four are enough, which 3 x 3 corners have.
    """
    k = plan.constants
    alone = plan.alone()
    if alone is not None and alone.owner.size:
        if np.count_nonzero(alone.there) >= k.least_board:
            yield from _apart(plan, alone)
        return
    units = plan.units(xy, k.least_part)
    if not len(units.part):
        units = plan.units(xy, LEAST_FACES)
    votes = plan.votes(units)
    taken = np.zeros(len(xy), np.bool_)
    left = list(range(int(units.part.max(initial=-1)) + 1))
    while left:
        main, *left = left
        placed = joined(units, votes, len(xy), k, main, left)
        placed.part[taken] = -1
        board = plan.settle(numbers_of(placed))
        owner = board.owner[board.owner >= 0]
        if np.count_nonzero(board.there) < k.least_board:
            continue
        taken[owner] = True
        left = [part for part in left if _is_free(taken[units.corner[units.part == part]])]
        yield from _apart(plan, board)


def _is_free(taken: Mask) -> bool:
    """Return whether no more than half of a part's corners are taken."""
    return 2 * int(np.count_nonzero(taken)) <= len(taken)


def numbers_of(placed: Placed) -> NDArray[np.int32]:
    """Return column, row, quarter turn, and 1 of every corner that is placed, (N, 4)."""
    number = np.where(placed.there, placed.number, 0)
    column, row = np.rint(number.real), np.rint(number.imag)
    return np.stack([column, row, placed.rotation, placed.there], axis=1).astype(np.int32)


def _apart(plan: LatticePlan, board: Board) -> list[Board]:
    """Return a board, or several if a piece of it that touches no other ends where others follow.

    Colours counted across plain ground can join two boards that lie in one plane.
    """
    seen = board.owner >= 0
    if seen.all():
        return [board]
    count, label = cv2.connectedComponents(seen.astype(np.uint8), connectivity=4)
    pieces = [label == n for n in range(1, count)]
    pieces = sorted(
        (each for each in pieces if each.sum() >= LEAST_PIECE), key=lambda each: -each.sum()
    )
    found, rest = [], seen
    for piece in pieces[1:]:
        top, bottom, left, right = _box(piece)
        others = seen & ~piece
        follow = (
            others[:top, left:right].any(),
            others[bottom:, left:right].any(),
            others[top:bottom, :left].any(),
            others[top:bottom, right:].any(),
        )
        alone = _cropped(board.only(piece))
        alone.border, quarters = plan.measured(alone)
        if (alone.border.ends & follow).any():
            found.append(alone.turned(quarters))
            rest = rest & ~piece
    if not found:
        return [board]
    left_over = _cropped(board.only(rest))
    left_over.border, quarters = plan.measured(left_over)
    return [left_over.turned(quarters), *found]


def _cropped(board: Board) -> Board:
    """Return the board without the empty rows and columns around it."""
    if not board.there.any():
        return board
    top, bottom, left, right = _box(board.there)
    box = np.s_[top:bottom, left:right]
    return Board(
        x=board.x[box],
        y=board.y[box],
        owner=board.owner[box],
        torn=board.torn[box],
        sign=board.sign * (1 - 2 * ((top + left) % 2)),
    )


def _box(there: Mask) -> tuple[int, int, int, int]:
    """Return the first row that has any, the one after the last, and the same of columns."""
    row, column = (np.flatnonzero(there.any(axis)) for axis in (1, 0))
    return int(row[0]), int(row[-1]) + 1, int(column[0]), int(column[-1]) + 1
