"""The filtered positions of a grid."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import GridError
from cmp_cl.grid.filter.lattice import filter_at_rest, filter_grid, noise_of_change
from cmp_cl.grid.grid import MEASURED, Grid

Array = NDArray[np.float64]


def filter_positions(now: Grid, *, rest: Grid | None = None) -> tuple[Grid, Grid]:
    """Return the grid with filtered positions, and the raw one, each with the sigma from the
    lattice.

    rest: the same pattern at rest, numbered alike. Then the displacements are filtered and
    added to the filtered positions at rest; a node that is missing there keeps its position.
    Interpolated nodes follow their neighbours. Where the lattice is too small to tell, sigma is
    that of the corners.

    Raises GridError where the grid has not all rows and columns of the one at rest.
    """
    if rest is None:
        found = filter_grid(now.xy, measured=np.isin(now.status, MEASURED))
        return _with(now, found.values, found.sigma), _with(now, now.xy, found.noise)
    if not now.covers(rest):
        raise GridError(f"the grid at rest has {rest.extent}, the other {now.extent}")
    rest = rest.cut_to(now)
    measured = np.isin(rest.status, MEASURED)
    start = filter_at_rest(rest.xy, measured=measured)
    moved = now.xy.astype(np.float64) - rest.xy
    change = filter_grid(
        moved,
        measured=measured & np.isin(now.status, MEASURED),
        bends=True,
        most_noise=noise_of_change(start, rest.sigma, now.sigma),
    )
    values = np.where(np.isnan(moved), now.xy, start.values + change.values)
    return (
        _with(now, values, np.hypot(start.sigma, change.sigma)),
        _with(now, now.xy, np.hypot(start.noise, change.noise)),
    )


def _with(grid: Grid, values: NDArray[np.floating[Any]], sigma: Array) -> Grid:
    """Return the grid with other positions, and that sigma where it is known."""
    return dataclasses.replace(
        grid,
        xy=values.astype(np.float32),
        sigma=np.where(np.isfinite(sigma), sigma, grid.sigma).astype(np.float32),
    )
