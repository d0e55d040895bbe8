"""The shift of corners by bent edges, from the curvature of the lattice."""

import functools
import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.holes import completed
from cmp_cl.filter.polynomials import LEAST_SUPPORT, polynomial

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Float = TypeVar("Float", np.float32, np.float64)

_HALF = 2  # nodes on each side of a node that show the curvature of a line
_WHOLE_SUPPORT = 1 - 1e-6
_LEAST_SINE = math.sin(math.radians(10))  # of the angle between the two lines at a corner


def bent_sigma(
    xy: NDArray[np.float32], sigma: NDArray[np.float32], radius: float
) -> NDArray[np.float32]:
    """Return the standard deviation of raw positions with the shift by bent edges, (R, C), px.

    xy, sigma, radius: the grid's `xy`, its `sigma` without that shift, and its `edge_radius`. The
    shift is known, but raw positions keep it, so half of its square is added to the variance per
    axis. It is computed from raw positions, whose noise adds a hundredth of itself.
    """
    if not math.isfinite(radius):
        return sigma
    whole: NDArray[np.float32] = np.sqrt(np.square(sigma) + bend_variance(xy, radius)).astype("f4")
    return whole


def bend_variance(xy: Single, radius: float) -> Single:
    """Return the variance per axis that bent edges add to raw positions, (R, C), px^2.

    Nodes of which not all neighbours are there get the mean of the others. Single precision, which
    raw positions have, changes their sigma by less than a thousandth.
    """
    there = np.asarray(~np.isnan(xy[..., 0]), np.bool_)
    data: Single = np.ascontiguousarray(xy.transpose(2, 0, 1))
    if not there.all():
        data = np.where(there, data, np.float32(0))
    shift, known = _shift_of(data, there, radius, _WHOLE_SUPPORT)
    variance: Single = (shift[0] * shift[0] + shift[1] * shift[1]) / 2
    return (
        variance
        if known.all() or not known.any()
        else np.where(known, variance, variance[known].mean())
    )


def bend_shift(xy: Array, radius: float) -> Array:
    """Return the shift of each corner by bent edges, (R, C, 2) float64, in the unit of `xy`.

    xy: (R, C, 2), filtered positions, NaN where missing. radius: the radius within which the
    refinement takes edges to be straight, in the same unit; NaN if it does not. The straight line
    that fits an arc of curvature k best within the radius r lies k r^2 / 6 from its middle, on the
    inner side; the corner moves with both of its lines. The shift is 0 if too few nodes show the
    curvature, or if the lines enclose less than 10 degrees.
    """
    there = np.asarray(np.isfinite(xy).all(axis=2), np.bool_)
    data = np.ascontiguousarray(completed(xy).transpose(2, 0, 1))
    shift, _ = _shift_of(data, there, radius, LEAST_SUPPORT)
    return np.ascontiguousarray(shift.transpose(1, 2, 0))


def _shift_of(
    data: NDArray[Float], there: NDArray[np.bool_], radius: float, least_support: float
) -> tuple[NDArray[Float], NDArray[np.bool_]]:
    """Return the shift of `bend_shift` by coordinate, (2, R, C), and where it is known, (R, C).

    data: (2, R, C), finite; there: (R, C), the measured nodes; least_support: share of the nodes
    around one that must be. Let t and k be the first and second derivatives along a line of
    nodes, by the number of the node, and q = |t|^2. The straight fit to that edge lies
    (t x k) r^2 / (6 q^1.5) off the node, along the normal. The fits to both edges meet at
    r^2 / 6 ((t0 x k0) / q0 t1 - (t1 x k1) / q1 t0) / (t0 x t1) from the node.
    """
    rows, columns = there.shape
    if not math.isfinite(radius) or min(rows, columns) < 3 or not there.any():
        return np.zeros_like(data), np.zeros((rows, columns), np.bool_)
    left, right = _derivatives(rows, data.dtype)[0], _derivatives(columns, data.dtype)[1]
    support: Array | bool = True
    if not there.all():
        near = [np.not_equal(m, 0) / (2 * _half(len(m)) + 1) for m in (left[0], right[0])]
        support = near[0] @ there @ near[1]
    change = np.empty((2, 2, *data.shape), data.dtype)  # both derivatives, down and along
    np.matmul(left[1:, None], data @ right[0], out=change[0])
    np.matmul(left[0] @ data, right[1:, None], out=change[1])
    t, k = change[:, 0], change[:, 1]
    x, y = t[:, 0], t[:, 1]
    q = np.maximum(x * x + y * y, 1e-30)
    area = x[0] * y[1] - y[0] * x[1]
    known = (area * area > _LEAST_SINE**2 * q[0] * q[1]) & (support >= least_support)
    share = np.where(known, radius**2 / 6 / np.where(known, area, 1), 0)
    bend = (x * k[:, 1] - y * k[:, 0]) / q
    return share * (bend[0] * t[1] - bend[1] * t[0]), known


@functools.lru_cache(maxsize=64)
def _derivatives(n: int, kind: np.dtype[Float]) -> tuple[NDArray[Float], NDArray[Float]]:
    """Return three matrices, (3, n, n), and their transposes: the value of the line fitted to five
    nodes, and the first and second derivative of the parabola fitted to five. The five are moved
    inwards at the ends. On a line of three or four nodes, the fits are to three."""
    half = _half(n)
    degrees = (1, 0), (2, 1), (2, 2)
    left = np.stack([polynomial(n, half, *each) for each in degrees]).astype(kind)
    return left, np.ascontiguousarray(left.transpose(0, 2, 1))


def _half(n: int) -> int:
    """Return the half width of the window along lines of n nodes, at least 3."""
    return min(_HALF, (n - 1) // 2)
