"""The filtered positions of a grid."""

import dataclasses
import math

import numpy as np

from cmp_cl.errors import GridError, check_kind
from cmp_cl.fits import bend_shift
from cmp_cl.grid.grid import Grid
from cmp_cl.motion.moments import AtRest, Moment
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.opencl.device import Device, select_device


def filter_positions(grid: Grid, *, device: Device | str | None = None) -> Grid:
    """Return a grid with filtered positions, with their sigma from the lattice.

    The shift by bent edges is subtracted. Interpolated nodes follow their neighbours. If the
    lattice is too small for an estimate, sigma is that of the corners. device: a Device, a text for
    `select_device`, or None for the default device. For two moments see `cmp_cl.displacement`.

    Raises GridError if grid is of another type, DeviceError.
    """
    check_kind("grid", grid, Grid, GridError)
    found = AtRest(Moment.in_plane(grid, PlaneScale.pixels()), select_device(device)).filtered
    values = found.values - bend_shift(found.values, grid.edge_radius)
    sigma = np.sqrt(found.covariance[..., 0, 0])
    return dataclasses.replace(
        grid,
        xy=values.astype(np.float32),
        image_sigma=sigma.astype(np.float32),
        edge_radius=math.nan,
    )
