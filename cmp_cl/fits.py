"""Fits to the nodes around a node: its place where it is missing, and the bend of its edges."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]

_LEAST_SUPPORT = 0.75  # least share of a window's nodes that are measured
_HALF = 2  # nodes on each side of a node that show the curvature of a line
_LEAST_SINE = math.sin(math.radians(10))  # of the angle between the two lines at a corner
_FILL_REACH = (3, 6)  # nodes around a hole that predict its value


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
    down, along = derivatives(rows), derivatives(columns)
    near = [np.not_equal(fit[0], 0) / (2 * bend_half(len(fit[0])) + 1) for fit in (down, along)]
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
    known = (area * area > _LEAST_SINE**2 * q[0] * q[1]) & (support >= _LEAST_SUPPORT)
    share = np.where(known, radius**2 / 6 / np.where(known, area, 1), 0)
    bend = (x * k[:, 1] - y * k[:, 0]) / q
    shift: Array = share[..., None] * (bend[0] * t[1] - bend[1] * t[0]).transpose(1, 2, 0)
    return shift


@functools.lru_cache(maxsize=64)
def derivatives(n: int) -> Array:
    """Return three matrices, (3, n, n): the value of the line fitted to five nodes, and the first
    and second derivative of the parabola fitted to five. The five are moved inwards at the ends. On
    a line of three or four nodes, the fits are to three."""
    return np.stack([polynomial(n, bend_half(n), *each) for each in ((1, 0), (2, 1), (2, 2))])


def bend_half(n: int) -> int:
    """Return the half width of the window along lines of n nodes, at least 3."""
    return min(_HALF, (n - 1) // 2)


@functools.lru_cache(maxsize=4)
def surface_slopes(half: int, degree: int) -> Array:
    """Return the weights of n x n nodes in the slopes of the surface that fits them best.

    half: half width of the window of n nodes. degree: of the polynomial in (column, row).

    Returns (n, n, 2, n, n): by row and column of the node in the window, the slopes per step along
    the row and along the column.
    """
    size = 2 * half + 1
    off = np.arange(size) - np.arange(size)[:, None]
    powers = [(p, q) for p in range(degree + 1) for q in range(degree + 1 - p)]
    weights = np.empty((size, size, 2, size, size))
    for r, c in np.ndindex(size, size):
        terms = [np.outer(off[r] ** p, off[c] ** q).ravel() for p, q in powers]
        fit = np.linalg.pinv(np.transpose(terms).astype(np.float64))
        slopes = fit[[powers.index((0, 1)), powers.index((1, 0))]]
        weights[r, c] = slopes.reshape(2, size, size)
    return weights


def polynomial(n: int, half: int, degree: int, order: int = 0) -> Array:
    """Return the matrix (n, n) of the value at each node of the polynomial fitted to its window.

    half: half width of the window, nodes; it is moved inwards at the ends. degree: of the
        polynomial.
    order: the derivative to take, 0 for the value.
    """
    whole = np.zeros((n, n))
    for node in range(n):
        first = min(max(node - half, 0), n - 2 * half - 1)
        window = np.arange(first, first + 2 * half + 1)
        powers = (window - node)[:, None].astype(np.float64) ** np.arange(degree + 1)
        whole[node, window] = math.factorial(order) * np.linalg.pinv(powers)[order]
    return whole


def completed(positions: Array) -> Array:
    """Return positions (R, C, K), NaN where missing, with predictions there, if any is known."""
    there = np.asarray(np.isfinite(positions).all(axis=2), np.bool_)
    if there.all() or not there.any():
        return positions
    plane = bilinear_surface(positions, there)
    bent = np.where(there[..., None], positions - plane, 0).transpose(2, 0, 1)
    return plane + filled(bent.astype(np.float32), there).transpose(1, 2, 0)


def bilinear_surface(values: Array, votes: NDArray[np.bool_]) -> Array:
    """Return the bilinear surface that fits the values best, (R, C, K).

    values: (R, C, K). votes: (R, C) bool, the nodes to fit, at least one. The filters do not change
    such surfaces; without the surface, float32 is exact enough for the residual.
    """
    r, c = np.meshgrid(*(np.linspace(-1, 1, n) for n in votes.shape), indexing="ij")
    terms = np.stack([np.ones_like(r), r, c, r * c], axis=-1)
    fit, *_ = np.linalg.lstsq(terms[votes], values[votes], rcond=None)
    plane: Array = terms @ fit
    return plane


def filled(data: Single, votes: Bools) -> Single:
    """Return the data with predictions at nodes without a vote.

    A prediction comes from a quadratic surface through the votes around the node, and is 0 if there
    are too few.
    data: (K, R, C). votes: (R, C) bool.
    """
    result = np.where(votes, data, np.float32(0))
    holes = np.argwhere(~votes)
    for reach in _FILL_REACH:
        if not len(holes):
            break
        predicted, sure = _predicted(data, votes, holes, reach)
        at = holes[sure]
        result[:, at[:, 0], at[:, 1]] = predicted[sure].T
        holes = holes[~sure]
    return result


def _predicted(
    data: Single, votes: Bools, holes: NDArray[np.int64], reach: int
) -> tuple[Array, Bools]:
    """Return predictions (H, K) for H holes from the votes within `reach` nodes, and a mask of
    those with enough votes."""
    offset = np.arange(-reach, reach + 1)
    r, c = (
        each.reshape(-1).astype(np.float64) for each in np.meshgrid(offset, offset, indexing="ij")
    )
    terms = np.stack([np.ones_like(r), r, c, r * r, r * c, c * c], axis=1)
    near = np.exp(-(r * r + c * c) / (2 * (reach / 2) ** 2))
    rows = holes[:, 0, None] + r.astype(np.int64) + reach
    columns = holes[:, 1, None] + c.astype(np.int64) + reach
    weight = near * np.pad(votes, reach)[rows, columns]
    padded = np.pad(data, ((0, 0), (reach, reach), (reach, reach)))
    around = padded[:, rows, columns].astype(np.float64)
    normal = np.einsum("hs,si,sj->hij", weight, terms, terms)
    right = np.einsum("hs,si,khs->hik", weight, terms, around)
    ridge = np.diag([0, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])
    sure = np.count_nonzero(weight, axis=1) >= 8
    normal[~sure] = np.eye(6)
    predicted = np.linalg.solve(normal + ridge, right)[:, 0]
    return predicted, sure
