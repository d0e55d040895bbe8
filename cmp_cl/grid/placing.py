"""From a board with numbers to its grid."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.grid.choice import Asked, Found
from cmp_cl.grid.grid import Grid, NodeStatus, Rival, Sides, empty_grid
from cmp_cl.grid.limits import check_size
from cmp_cl.lattice.arrays import LOOKED, Board
from cmp_cl.lattice.numbers import Decision, Numbering, Seen, outer_lines, seen_lines


class Given(NamedTuple):
    """Corners of a view: xy (N, 2) px, edges (N, 4) rad, sigma (N,) px, refusal (N,) of `Refusal`;
    edge_radius as of `Corners`."""

    xy: NDArray[np.float32]
    edges: NDArray[np.float32]
    sigma: NDArray[np.float32]
    refusal: NDArray[np.uint8]
    edge_radius: float = math.nan

    @classmethod
    def of(cls, corners: Corners) -> "Given":
        return cls(corners.xy, corners.edges, corners.sigma, corners.refusal, corners.edge_radius)


def empty_like(corners: int, asked: Asked) -> Grid:
    """Return the grid of so many corners of which none is a node."""
    return empty_grid(corners, asked.shape, asked.like)


def placed(found: Found, given: Given, asked: Asked, others: int) -> Grid:
    """Return the grid of a board with the numbers that were decided."""
    best = found.decision.best
    board, border = found.board.turned(best.quarters), found.border.turned(best.quarters)
    size = board.owner.shape[0], board.owner.shape[1]
    first, shape = _extent(board, best, asked)
    check_size(*shape)
    top, left = first[0] - best.row, first[1] - best.column
    owner, torn, x, y = board.owner, board.torn, board.x, board.y
    if (top, left, shape) != (0, 0, size):
        owner, torn = _window(owner, top, left, shape, -1), _window(torn, top, left, shape, 0)
        x, y = (_window(each, top, left, shape, np.nan) for each in (x, y))
    xy = np.stack([x, y], axis=2)
    mine = owner >= 0
    status = mine.astype(np.uint8) * np.uint8(NodeStatus.DETECTED)
    status[mine & torn] = NodeStatus.ATTACHED
    status[owner == LOOKED] = NodeStatus.INTERPOLATED
    row, column = np.nonzero(mine)
    corner = owner[row, column]
    index = np.full((len(given.xy), 2), -1, np.int32)
    index[corner] = np.stack([row, column], axis=1)
    sigma = np.full(shape, np.nan, np.float32)
    sigma[row, column] = given.sigma[corner]
    ends = border.ends
    misfit = asked.like is None and asked.shape is not None and not found.fits
    if asked.like is None and size == asked.shape and found.fits:
        ends = ends | border.room  # a further line would be in view
    return Grid(
        xy=xy,
        status=status,
        image_sigma=sigma,
        index=index,
        parity=((board.sign < 0) + top + left) % 2,
        origin=first,
        border=Sides(*ends.tolist()),
        reach=tuple(border.reach.tolist()),
        past=tuple(border.past.tolist()),
        seen_shape=seen_lines(Seen.of(board)) if misfit else None,
        confidence=found.decision.margin,
        rival=_rival(found.decision, size, first, shape),
        others=others,
        edge_radius=given.edge_radius,
    )


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
    lines = outer_lines(board.owner >= 0)
    first, shape = [], []
    ends = asked.like.border or Sides()
    for axis, start in enumerate((best.row, best.column)):
        low, high = asked.like.origin[axis], asked.like.origin[axis] + asked.like.shape[axis]
        before, after = 2 * axis, 2 * axis + 1
        ended = ends[before] and start + lines[before] >= low
        first.append(low if ended else min(low, start))
        ended = ends[after] and start + lines[after] < high
        shape.append((high if ended else max(high, start + size[axis])) - first[-1])
    return (first[0], first[1]), (shape[0], shape[1])


def _window(
    values: NDArray[Any], top: int, left: int, shape: tuple[int, int], empty: float
) -> NDArray[Any]:
    """Return the rows and columns of an array from (top, left) on, `empty` where it has none."""
    window = np.full(shape, empty, values.dtype)
    here = np.s_[max(top, 0) : max(top + shape[0], 0), max(left, 0) : max(left + shape[1], 0)]
    part = values[here]
    at = max(-top, 0), max(-left, 0)
    window[at[0] : at[0] + part.shape[0], at[1] : at[1] + part.shape[1]] = part
    return window


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
