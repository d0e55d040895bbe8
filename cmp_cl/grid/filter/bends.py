"""The shift of corners by bent edges, from the curvature of the lattice."""

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.filter.holes import filled
from cmp_cl.grid.filter.lattice import bilinear_surface, filter_at_rest
from cmp_cl.grid.filter.polynomials import LEAST_SUPPORT, polynomial
from cmp_cl.grid.grid import MEASURED, Grid

Array = NDArray[np.float64]

_HALF = 2  # nodes on each side of a node that show the curvature of a line
_LEAST_SINE = math.sin(math.radians(10))  # of the angle between the two lines at a corner


def bend_shift_of(grid: Grid) -> Array:
    """Return the shift of the nodes of a grid by bent edges, (R, C, 2) float64, px, see
        `bend_shift`.

    It is 0 if the radius of the corners' refinement is unknown.

    """
    if not math.isfinite(grid.edge_radius):
        return np.zeros(grid.xy.shape)
    filtered = filter_at_rest(grid.xy, measured=np.isin(grid.status, MEASURED))
    return bend_shift(filtered.values, grid.edge_radius)


def with_bends(grid: Grid) -> Grid:
    """Return the grid with the shift by bent edges in its sigma, which was that of the corners.

    The shift is known, but raw positions keep it, so half of its square is added to the variance
    per axis. It comes from raw positions: their noise adds a hundredth of itself.
    """
    if not math.isfinite(grid.edge_radius):
        return grid
    return dataclasses.replace(
        grid, sigma=np.sqrt(np.square(grid.sigma) + _variance(grid)).astype(np.float32)
    )


def image_sigma(grid: Grid) -> Array:
    """Return the part of a grid's sigma that comes from the images of its corners, (R, C) float64,
        px: without the shift by bent edges.

    A sigma smaller than that shift does not contain it, and is returned as it is.
    """
    whole = np.square(grid.sigma, dtype=np.float64)
    if not math.isfinite(grid.edge_radius):
        return np.sqrt(whole)
    own = whole - _variance(grid)
    return np.sqrt(np.where(own > 0, own, whole))


def _variance(grid: Grid) -> Array:
    """Return the variance per axis of raw positions by bent edges, (R, C), px^2.

    Nodes whose neighbours do not show the bend get the mean of the others.
    """
    shift, known = _shift_of(grid.xy.astype(np.float64), grid.edge_radius)
    variance: Array = np.square(shift).sum(axis=2) / 2
    return (
        variance
        if known.all() or not known.any()
        else np.where(known, variance, variance[known].mean())
    )


def bend_shift(xy: Array, radius: float) -> Array:
    """Return the shift of each corner by bent edges, (R, C, 2) float64, in the unit of `xy`.

    xy: (R, C, 2), filtered positions, NaN where missing. radius: radius within which a refinement
    takes the edges to be straight, in the same unit; NaN for a refinement that does not. The
    straight line that fits an arc of curvature k best within the radius r lies k r^2 / 6 from its
    middle, on the inner side; the corner moves with both of its lines. The shift is 0 if too few
    nodes show the curvature, or if the lines enclose less than 10 degrees.
    """
    return _shift_of(xy, radius)[0]


def _shift_of(xy: Array, radius: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the shift, as `bend_shift` does, and whether it is known, (R, C)."""
    there = np.asarray(np.isfinite(xy).all(axis=2), np.bool_)
    rows, columns = there.shape
    if not math.isfinite(radius) or min(rows, columns) < 3 or not there.any():
        return np.zeros_like(xy), np.zeros((rows, columns), np.bool_)
    data = xy.transpose(2, 0, 1)
    support: Array | bool = True
    if not there.all():
        plane = bilinear_surface(xy, there)
        bent = np.where(there[..., None], xy - plane, 0).transpose(2, 0, 1)
        data = plane.transpose(2, 0, 1) + filled(bent.astype(np.float32), there)
        near = [np.not_equal(_derivatives(n)[2], 0) / (2 * _half(n) + 1) for n in there.shape]
        support = near[0] @ there @ near[1].T
    slope_down, second_down, mean_down = _derivatives(rows)
    slope_along, second_along, mean_along = _derivatives(columns)
    lines = (
        (slope_down @ data @ mean_along.T, second_down @ data @ mean_along.T),
        (mean_down @ data @ slope_along.T, mean_down @ data @ second_along.T),
    )
    (n0, off0), (n1, off1) = (_line(*each, radius) for each in lines)
    sine = n0[0] * n1[1] - n0[1] * n1[0]
    known = (np.abs(sine) > _LEAST_SINE) & (support >= LEAST_SUPPORT)
    divisor = np.where(known, sine, 1)
    x = (off0 * n1[1] - off1 * n0[1]) / divisor
    y = (off1 * n0[0] - off0 * n1[0]) / divisor
    return np.where(known[..., None], np.stack([x, y], axis=-1), 0), known


def _line(slope: Array, second: Array, radius: float) -> tuple[Array, Array]:
    """Return the normal of a line at each node, (2, R, C), and the shift of its straight fit along
    the normal, (R, C).

    slope, second: (2, R, C), the first and second derivatives by the number of the node.
    """
    square = np.maximum(np.square(slope).sum(axis=0), 1e-30)
    normal = np.stack([-slope[1], slope[0]]) / np.sqrt(square)
    return normal, (second * normal).sum(axis=0) / square * (radius**2 / 6)


@functools.lru_cache(maxsize=64)
def _derivatives(n: int) -> tuple[Array, Array, Array]:
    """Return three matrices (n, n): the first and second derivative of the parabola fitted to five
    nodes, and the value of the line fitted to five. The five are moved inwards at the ends. Where
    a line has three nodes or four, they are fitted to three."""
    half = _half(n)
    first, second = (polynomial(n, half, 2, order) for order in (1, 2))
    return first, second, polynomial(n, half, 1)


def _half(n: int) -> int:
    """Return the half width of the window along lines of n nodes, at least 3."""
    return min(_HALF, (n - 1) // 2)
