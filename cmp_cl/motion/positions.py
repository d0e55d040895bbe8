"""The filtered positions of a grid."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import GridError, check_kind
from cmp_cl.filter import (
    Filtered,
    bend_shift,
    bent_sigma,
    filter_at_rest,
    filter_grid,
    noise_of_change,
)
from cmp_cl.grid.grid import MEASURED, Grid

Array = NDArray[np.float64]


def filter_positions(now: Grid, *, rest: Grid | None = None) -> tuple[Grid, Grid]:
    """Return the grid with filtered positions, and with raw ones, each with sigma from the lattice.

    now: the grid.
    rest: the same pattern at rest, numbered alike. With it the displacements are filtered and added
        to the filtered positions at rest; a node that is missing at rest keeps its position. The
        shift by bent edges is subtracted from filtered positions, and is part of the sigma of raw
        ones. Interpolated nodes follow their neighbours. If the lattice is too small for an
        estimate, sigma is that of the corners.

    Raises GridError if an argument is not a Grid, or if the grid does not have all rows and columns
    of the one at rest.
    """
    check_kind("now", now, Grid, GridError)
    own_now = now.image_sigma
    if rest is None:
        found = filter_grid(now.xy, measured=np.isin(now.status, MEASURED))
        values = found.values - bend_shift(found.values, now.edge_radius)
        return _with(now, values, found.sigma, own_now), _raw(now, found.noise, own_now)
    check_kind("rest", rest, Grid, GridError)
    if not now.covers(rest):
        raise GridError(f"the grid at rest has {rest.extent}, the other {now.extent}")
    rest = rest.cut_to(now)
    measured = np.isin(rest.status, MEASURED)
    start = filter_at_rest(rest.xy, measured=measured)
    moved = now.xy.astype(np.float64) - rest.xy
    own = rest.image_sigma, own_now
    change = filter_grid(
        moved,
        measured=measured & np.isin(now.status, MEASURED),
        bends=True,
        most_noise=noise_of_change(start, *own),
    )
    values = np.where(np.isnan(moved), now.xy, start.values + change.values)
    values -= bend_shift(values, now.edge_radius)
    sigma, noise = _deviations(start, change, *own)
    return _with(now, values, sigma, own_now), _raw(now, noise, own_now)


def _deviations(
    start: Filtered, change: Filtered, own_rest: Array, own_now: Array
) -> tuple[Array, Array]:
    """Return the standard deviations (R, C) of filtered positions and of raw ones.

    The noise of the image at rest is also in the displacement, with the opposite sign, so that the
    parts that both filters leave cancel in the sum. Its size is given by own_rest and own_now, the
    standard deviations of the corners from their images, and is at most its share of the noise of
    the displacement.
    """
    before, after = np.square(own_rest), np.square(own_now)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.square(change.noise) * before / (before + after)
        own = np.fmin(np.fmin(before, np.square(start.noise)), share)
        own = np.where(before + after > 0, own, 0)
        left = np.square(np.fmin(start.sigma / start.noise, change.sigma / change.noise))
        both = [np.square(each.sigma) for each in (start, change)]
        raw = [np.square(each.noise) for each in (start, change)]
        return np.sqrt(sum(both) - 2 * own * left), np.sqrt(sum(raw) - 2 * own)


def _raw(grid: Grid, noise: Array, own: Array) -> Grid:
    """Return the grid with raw positions; sigma combines the noise and the shift by bent edges."""
    sigma = _with(grid, grid.xy, noise, own).sigma
    return dataclasses.replace(grid, sigma=bent_sigma(grid.xy, sigma, grid.edge_radius))


def _with(grid: Grid, values: NDArray[np.floating[Any]], sigma: Array, own: Array) -> Grid:
    """Return the grid with other positions, and with their sigma, or `own` where it is unknown."""
    return dataclasses.replace(
        grid,
        xy=values.astype(np.float32),
        sigma=np.where(np.isfinite(sigma), sigma, own).astype(np.float32),
    )
