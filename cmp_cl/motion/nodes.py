"""The nodes of grids as the kernels of a plan take them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.holes import filled
from cmp_cl.grid.grid import Grid


def put(arrays: dict[str, NDArray[Any]], view: int, grid: Grid) -> None:
    """Write the nodes of a grid into the inputs of a plan, with predictions in its holes.

    A grid's sigma without the shift by bent edges is that of its corners.
    """
    there = grid.valid
    xy = grid.xy
    if not there.all() and there.any():
        middle = xy[there].mean(axis=0)
        moved = np.where(there[..., None], xy - middle, 0).transpose(2, 0, 1)
        xy = filled(moved.astype(np.float32), there).transpose(1, 2, 0) + middle
    arrays["nodes"][view] = np.nan_to_num(xy)
    arrays["seen_status"][view] = grid.status
    arrays["seen_sigma"][view] = grid.image_sigma
