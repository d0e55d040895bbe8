"""From a board with numbers to its grid."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.grid.choice import NOTHING, Asked, Found, Told
from cmp_cl.grid.grid import Grid, NodeStatus, Rival, Sides, check_size
from cmp_cl.lattice.arrays import LOOKED, Board, Mask
from cmp_cl.lattice.numbers import Decision, Numbering, seen_lines


def placed(found: Found, corners: Corners, asked: Asked, told: Told = NOTHING) -> Grid:
    """Return the grid of a board with the numbers that were decided."""
    best = found.decision.best
    board = found.board.turned(best.quarters)
    size = board.owner.shape[0], board.owner.shape[1]
    first, shape = _extent(board, best, asked)
    check_size(*shape)
    mine = board.owner >= 0
    status = mine.astype(np.uint8) * np.uint8(NodeStatus.DETECTED)
    status[mine & board.torn] = NodeStatus.ATTACHED
    xy: NDArray[np.float32] = np.stack([board.x, board.y], axis=2)
    sigma = np.full(mine.shape, np.nan, np.float32)
    sigma[mine] = np.maximum(corners.sigma[board.owner[mine]], np.sqrt(board.spread[mine]))
    looked = board.owner == LOOKED
    if looked.any():
        between = looked & _amid(mine)
        status[between] = NodeStatus.INTERPOLATED
        xy[looked & ~between] = np.nan
    corner = board.owner[mine]
    index = np.full((len(corners), 2), -1, np.int32)
    index[corner, 0], index[corner, 1] = np.nonzero(mine)
    ends = board.border.ends
    misfit = asked.like is None and asked.shape is not None and not found.fits
    if asked.like is None and size == asked.shape and found.fits:
        ends = ends | board.border.room  # a further line would be in view
    grid = Grid(
        xy=xy,
        status=status,
        image_sigma=sigma,
        index=index,
        parity=int(board.sign < 0),
        origin=(best.row, best.column),
        border=Sides(*ends.tolist()),
        reach=tuple(board.border.reach.tolist()),
        seen_shape=seen_lines(board) if misfit else None,
        confidence=found.decision.margin,
        rival=_rival(found.decision, size, first, shape),
        others=told.number,
        others_are=told.what,
        edge_radius=corners.edge_radius,
    )
    return grid.within(first, shape)


def _amid(there: Mask) -> Mask:
    """Return which places have a corner on both sides, in their row or in their column, (R, C)."""
    between = np.zeros_like(there)
    between[:, 1:-1] = there[:, 2:] & there[:, :-2]
    between[1:-1] |= there[2:] & there[:-2]
    return between


def _extent(board: Board, best: Numbering, asked: Asked) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the number of the grid's first node, and its rows and columns.

    The grid has the rows and columns of the known shape or at rest, and those beyond a side that is
    open at rest. A side at which whole lines are seen beyond the border at rest was hidden then.
    """
    size = board.owner.shape
    if asked.shape is None:
        return (0, 0), (size[0], size[1])
    if asked.like is None:
        return (0, 0), asked.shape
    first, shape = [], []
    ends = asked.like.border or Sides()
    for axis, start in enumerate((best.row, best.column)):
        low, high = asked.like.origin[axis], asked.like.origin[axis] + asked.like.shape[axis]
        before, after = 2 * axis, 2 * axis + 1
        ended = ends[before] and start + board.outer_lines[before] >= low
        first.append(low if ended else min(low, start))
        ended = ends[after] and start + board.outer_lines[after] < high
        shape.append((high if ended else max(high, start + size[axis])) - first[-1])
    return (first[0], first[1]), (shape[0], shape[1])


def _rival(
    decision: Decision, size: tuple[int, int], first: tuple[int, int], shape: tuple[int, int]
) -> Rival | None:
    """Return the second numbering, as a turn of the grid and what is added to its numbers then.

    size: of the board; first, shape: of the grid.
    """
    best, second = decision.best, decision.second
    if second is None:
        return None
    turn = (second.quarters - best.quarters) % 4
    top, left = first[0] - best.row, first[1] - best.column
    below, right = shape[0] + top - size[0], shape[1] + left - size[1]
    skipped = ((-top, -left), (right, -top), (below, right), (-left, below))[turn]
    row, column = second.row - skipped[0], second.column - skipped[1]
    return Rival(row - first[0], column - first[1], turn)
