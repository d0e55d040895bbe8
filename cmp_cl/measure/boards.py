"""Rigid boards for calibration."""

import dataclasses
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import GridError, check_kind, check_shape
from cmp_cl.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage
from cmp_cl.measure.patterns import (
    Region,
    detected,
    find_pattern,
)
from cmp_cl.motion import filter_positions
from cmp_cl.opencl.device import Device
from cmp_cl.points import sides
from cmp_cl.space import Points3D

MAX_SIGMA = 0.2  # px; less certain corners of a board are not used


def find_board(
    view: GreyImage,
    shape: tuple[int, int],
    *,
    region: Region | None = None,
    full_scale: int | None = None,
    device: Device | str | None = None,
) -> Grid:
    """Find a rigid board in a view; return its grid, which `cmp_cl.calibrate` takes.

    view: (H, W) uint8 or uint16. shape: (rows, columns) of the board's inner corners. region,
        full_scale, device: as in `OneView`.

    The corners are those of `DetectorConfig()`, the settings of every caller that gives none.

    Raises GridError if the view does not show corners of all four sides of the board.
    """
    check_shape(shape, GridError)
    _, grid = find_pattern(view, shape=shape, region=region, full_scale=full_scale, device=device)
    seen = grid.status == NodeStatus.DETECTED
    if not (seen[[0, -1]].any(axis=1).all() and seen[:, [0, -1]].any(axis=0).all()):
        raise GridError(
            f"it shows {detected(grid)} of {seen.size} corners, and not those of every side"
        )
    return grid


def trusted(
    grid: Grid, max_sigma: float = MAX_SIGMA, *, device: Device | str | None = None
) -> Grid:
    """Return the filtered grid of a board with only the nodes that calibration may use.

    It leaves out nodes that were not detected, and nodes whose corner has a sigma above max_sigma,
    px. The sigma of the others is that of their filtered positions. device: as in `OneView`. Raises
    GridError if grid is of another type, or max_sigma is not above 0.
    """
    check_kind("grid", grid, Grid, GridError)
    check_kind("max_sigma", max_sigma, Real, GridError)
    if not max_sigma > 0:
        raise GridError(f"max_sigma must be above 0 px, not {max_sigma!r}")
    good = (grid.status == NodeStatus.DETECTED) & (grid.image_sigma <= max_sigma)
    kept = dataclasses.replace(
        grid,
        xy=np.where(good[..., None], grid.xy, np.float32(np.nan)),
        status=np.where(good, grid.status, NodeStatus.MISSING).astype(np.uint8),
        image_sigma=np.where(good, grid.image_sigma, np.float32(np.nan)),
    )
    return filter_positions(kept, device=device)


def square_sides(points: Points3D) -> NDArray[np.float64]:
    """Return the distances between neighbouring valid points, (N,), in their unit.

    Raises GridError if points is of another type.
    """
    check_kind("points", points, Points3D, GridError)
    every: NDArray[np.float64] = np.concatenate([each.ravel() for each in sides(points.xyz)])
    return every[np.isfinite(every)]
