"""The nodes of grids as the kernels of a plan take them, and grids of what they find."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.fits import completed
from cmp_cl.grid.grid import Grid, NodeStatus


def whole(xy: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the positions of a grid, (R, C, 2) px, with predictions in its holes."""
    return np.nan_to_num(completed(xy.astype(np.float64)))


def put(arrays: dict[str, NDArray[Any]], view: int, grid: Grid, corners: Corners) -> None:
    """Write the nodes of a grid of these corners into the inputs of a plan, with predictions in its
    holes."""
    arrays["nodes"][view] = whole(grid.xy)
    arrays["seen_status"][view] = grid.status
    known = grid.index[:, 0] >= 0
    sigma = np.full(grid.shape, np.nan, np.float32)
    sigma[tuple(grid.index[known].T)] = corners.sigma[known]
    arrays["seen_sigma"][view] = sigma


def positions_of(arrays: Mapping[str, NDArray[Any]], view: int) -> NDArray[np.float32]:
    """Return the positions of the nodes of a view, (R, C, 2) px, NaN where they are missing.

    arrays: of the frame, see `FieldPlan.read`.
    """
    there = arrays["seen_status"][view] != NodeStatus.MISSING
    return np.where(there[..., None], arrays["nodes"][view], np.float32(np.nan))


def grid_of(arrays: Mapping[str, NDArray[Any]], view: int, numbers: Grid, corners: int) -> Grid:
    """Return the grid of a view that was tracked.

    arrays: of the frame, see `FieldPlan.read`. numbers: the grid that its nodes have their numbers
    from. corners: their number.
    """
    owner, status = arrays["owner"][view], arrays["seen_status"][view]
    row, column = np.nonzero(owner >= 0)
    index = np.full((corners, 2), -1, np.int32)
    index[owner[row, column]] = np.stack([row, column], axis=1)
    there = status != NodeStatus.MISSING
    return dataclasses.replace(
        numbers,
        xy=positions_of(arrays, view),
        status=status,
        image_sigma=np.where(there, arrays["seen_sigma"][view], np.float32(np.nan)),
        index=index,
    )
