"""From a board with numbers to its grid."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Refusal
from cmp_cl.grid.choice import NOTHING, Asked, Found, K, Told
from cmp_cl.grid.grid import Grid, NodeStatus, Rival, Sides, check_size
from cmp_cl.lattice.arrays import LOOKED, Board, Mask
from cmp_cl.lattice.numbers import Decision, Numbering, seen_lines

LINES = ((0, 1), (1, 0))
CELLS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


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
    xy, sigma = _weighed(board, corners)
    looked = board.owner == LOOKED
    if looked.any():
        between = looked & _between(mine)
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


def _weighed(board: Board, corners: Corners) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the positions of the nodes, (R, C, 2), and their standard deviations, (R, C), px.

    A board averages a rough corner with its prediction. One that fits the corner model is worn, or
    the surface bends sharply there. Where it bends, the predictions of its neighbours scatter, and
    count as much less as they do so more than wear moves a corner.
    """
    xy: NDArray[np.float32] = np.stack([board.x, board.y], axis=2)
    mine = board.owner >= 0
    sigma = np.full(mine.shape, np.nan, np.float32)
    sigma[mine] = corners.sigma[board.owner[mine]]
    row, column = np.nonzero(board.torn & mine)
    corner = board.owner[row, column]
    fits = (corners.refusal[corner] == Refusal.NONE) & np.isfinite(corners.sigma[corner])
    row, column, corner = row[fits], column[fits], corner[fits]
    if not len(corner):
        return xy, sigma
    seen: NDArray[np.float32] = np.pad(xy, ((2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    seen[2:-2, 2:-2][mine] = corners.xy[board.owner[mine]]

    def at(rows: int, columns: int) -> NDArray[np.float32]:
        found: NDArray[np.float32] = seen[row + 2 + rows, column + 2 + columns]
        return found

    predicted = [at(r, 0) + at(0, c) - at(r, c) for r, c in CELLS]
    for r, c in LINES:
        middle = (at(-r, -c) + at(r, c)) / 2
        cubic = (8 * middle - at(-2 * r, -2 * c) - at(2 * r, 2 * c)) / 6
        predicted.append(np.where(np.isnan(cubic), middle, cubic))
    each, known = np.array(predicted), ~np.isnan(predicted)
    count = np.maximum(known.sum(axis=0), 1)
    off = each - each.sum(axis=0, where=known) / count
    scatter = ((off * off).sum(axis=0, where=known) / count).mean(axis=1)
    variance = (K.worn_sigmas * corners.sigma[corner]) ** 2
    share = variance / (variance + scatter)
    xy[row, column] = at(0, 0) + share[:, None] * (xy[row, column] - at(0, 0))
    sigma[row, column] = np.maximum(corners.sigma[corner], np.sqrt(share * scatter))
    return xy, sigma


def _between(there: Mask) -> Mask:
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
