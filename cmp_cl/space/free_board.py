"""A board that is bent or not exact: its nodes are found together with the cameras."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.grid.grid import Grid
from cmp_cl.points import sides
from cmp_cl.space.adjustment import Adjusted, Look, State, adjust
from cmp_cl.space.lens import Lens

Array = NDArray[np.float64]

_LEAST_VIEWS = 4


def numbered_alike(grids: Sequence[Grid]) -> list[Grid]:
    """Return the grids of a free board with equal indices for the same node.

    If a half turn exchanges black and white, the colours show which way up the board is. Raises
    CalibrationError if the grids have different rows or columns.
    """
    for view, grid in enumerate(grids):
        if grid.shape != grids[0].shape:
            raise CalibrationError(
                "the views of a free board must be numbered alike: the first grid has "
                f"{grids[0].extent}, number {view} has {grid.extent}"
            )
    return [
        grid.turned(2) if sum(grid.shape) % 2 and grid.parity != grids[0].parity else grid
        for grid in grids
    ]


def adjust_board(
    lens: Lens,
    looks: Sequence[Look],
    start: State,
    free: NDArray[np.bool_],
    shape: tuple[int, int],
    spacing: float,
) -> tuple[Adjusted, Array]:
    """Adjust cameras and the board; return its nodes too, (R, C, 3), NaN where unseen.

    shape: (R, C). The views do not show how large a board is: the mean of its sides is `spacing`.
    The other arguments are those of `adjust`. Raises CalibrationError for fewer than four views.
    """
    views = len(start.poses)
    if views < _LEAST_VIEWS:
        raise CalibrationError(f"{views} views of a free board, at least {_LEAST_VIEWS} are needed")
    adjusted = adjust(lens, looks, start, free, spacing)
    shown = np.unique(np.concatenate([look.nodes for look in looks]))
    board = np.full_like(start.board, np.nan)
    board[shown] = adjusted.state.board[shown]
    board = board.reshape(*shape, 3)
    lengths = np.concatenate([each.ravel() for each in sides(board)])
    if not np.isfinite(lengths).any():
        return adjusted, board
    scale = spacing / float(np.nanmean(lengths))
    centre = np.nanmean(board, axis=(0, 1))
    return _scaled(adjusted, free, scale), centre + (board - centre) * scale


def _scaled(adjusted: Adjusted, free: NDArray[np.bool_], scale: float) -> Adjusted:
    """Return the cameras with the distances between them multiplied by a factor."""
    factors = np.ones(free.shape)
    factors[:, -3:] = scale
    return dataclasses.replace(
        adjusted,
        state=dataclasses.replace(adjusted.state, cameras=adjusted.state.cameras * factors),
        covariance=adjusted.covariance * np.outer(factors[free], factors[free]),
    )
