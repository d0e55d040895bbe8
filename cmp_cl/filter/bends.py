"""The shift of corners by bent edges, from the curvature of the lattice."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.holes import completed
from cmp_cl.filter.polynomials import LEAST_SUPPORT, polynomial

Array = NDArray[np.float64]

_HALF = 2  # nodes on each side of a node that show the curvature of a line
_LEAST_SINE = math.sin(math.radians(10))  # of the angle between the two lines at a corner


def bent_sigma(
    xy: NDArray[np.float32], sigma: NDArray[np.float32], radius: float
) -> NDArray[np.float32]:
    """Return the standard deviation of raw positions with the shift by bent edges, (R, C), px.

    xy, sigma, radius: the grid's `xy`, its `sigma` without that shift, and its `edge_radius`. The
    shift is known, but raw positions keep it, so half of its square is added to the variance per
    axis. It is computed from raw positions, whose noise adds a hundredth of itself. Nodes around
    which too few show it get the mean of the others.
    """
    variance = np.square(bend_shift(xy.astype(np.float64), radius)).sum(axis=2) / 2
    known = variance > 0
    if known.any():
        variance[~known] = variance[known].mean()
    whole: NDArray[np.float32] = np.sqrt(np.square(sigma) + variance).astype(np.float32)
    return whole


def bend_shift(xy: Array, radius: float) -> Array:
    """Return the shift of each corner by bent edges, (R, C, 2) float64, in the unit of `xy`.

    xy: (R, C, 2), filtered positions, NaN where missing. radius: the radius within which the
    refinement takes edges to be straight, in the same unit; NaN if it does not. The straight line
    that fits an arc of curvature k best within the radius r lies k r^2 / 6 from its middle, on the
    inner side; the corner moves with both of its lines. The shift is 0 if too few nodes show the
    curvature, or if the lines enclose less than 10 degrees.
    """
    there = np.isfinite(xy).all(axis=2)
    rows, columns = there.shape
    if not math.isfinite(radius) or min(rows, columns) < 3 or not there.any():
        return np.zeros_like(xy)
    data = completed(xy).transpose(2, 0, 1)
    down, along = _derivatives(rows), _derivatives(columns)
    near = [np.not_equal(fit[0], 0) / (2 * _half(len(fit[0])) + 1) for fit in (down, along)]
    support = near[0] @ there @ near[1].T
    # Let t and k be the first and second derivatives along a line of nodes, by the number of the
    # node, and q = |t|^2. The straight fit to that edge lies (t x k) r^2 / (6 q^1.5) off the node,
    # along the normal. The fits to both edges meet at
    # r^2 / 6 ((t0 x k0) / q0 t1 - (t1 x k1) / q1 t0) / (t0 x t1) from the node.
    t, k = (
        np.stack([down[order] @ data @ along[0].T, down[0] @ data @ along[order].T])
        for order in (1, 2)
    )
    x, y = t[:, 0], t[:, 1]
    q = np.maximum(x * x + y * y, 1e-30)
    area = x[0] * y[1] - y[0] * x[1]
    known = (area * area > _LEAST_SINE**2 * q[0] * q[1]) & (support >= LEAST_SUPPORT)
    share = np.where(known, radius**2 / 6 / np.where(known, area, 1), 0)
    bend = (x * k[:, 1] - y * k[:, 0]) / q
    shift: Array = share[..., None] * (bend[0] * t[1] - bend[1] * t[0]).transpose(1, 2, 0)
    return shift


@functools.lru_cache(maxsize=64)
def _derivatives(n: int) -> Array:
    """Return three matrices, (3, n, n): the value of the line fitted to five nodes, and the first
    and second derivative of the parabola fitted to five. The five are moved inwards at the ends. On
    a line of three or four nodes, the fits are to three."""
    return np.stack([polynomial(n, _half(n), *each) for each in ((1, 0), (2, 1), (2, 2))])


def _half(n: int) -> int:
    """Return the half width of the window along lines of n nodes, at least 3."""
    return min(_HALF, (n - 1) // 2)
