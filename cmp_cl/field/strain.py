"""The strain of a surface from the positions of its nodes, and its standard deviation."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, as_numbers, check_range

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEAST_NODES = 6  # fewest nodes of a window to which a plane is fitted


def green_lagrange(rest: Array, now: Array, *, radius: int = 2) -> Array:
    """Return the Green-Lagrange strain of a surface in its tangent plane at rest.

    rest, now: (R, C, 3) positions of the same nodes, NaN where missing. Around each node a plane in
    (column, row) is fitted to both by least squares, over the valid ones of the (2 radius + 1)^2
    nodes, to give the tangent vectors A = (a1, a2) at rest and B now. In the orthonormal basis of
    the plane at rest, axis 1 along a1 and axis 2 towards a2, with A = Q U:
    E = (U^-T B^T B U^-1 - I) / 2. A rigid motion of the surface gives 0.

    Returns (R, C, 3) E11, E22, E12 (half the engineering shear); NaN if the node is missing, if its
    window has fewer than 6 nodes, or if these lie on a line.

    Raises ConfigError if radius is not a whole number from 1 to 50, FieldError if rest or now has
    another shape.
    """
    rest, now = as_numbers("rest", rest, FieldError), as_numbers("now", now, FieldError)
    if rest.ndim != 3 or rest.shape[2] != 3 or now.shape != rest.shape:
        raise FieldError(f"rest and now must be (R, C, 3), not {rest.shape} and {now.shape}")
    check_range("radius", radius, 1, 50, kind=int)
    good, _, second, inverse = _local_frames(rest, now, radius)
    deformed = second @ second.transpose(0, 2, 1)
    relative = inverse @ deformed @ inverse.transpose(0, 2, 1)
    strain = np.full((*good.shape, 3), np.nan)
    strain[good, 0] = (relative[:, 0, 0] - 1) / 2
    strain[good, 1] = (relative[:, 1, 1] - 1) / 2
    strain[good, 2] = relative[:, 0, 1] / 2
    return strain


def slope_weights(valid: Bools, radius: int) -> tuple[Array, Array]:
    """Return the neighbours' weights in the slopes by column and by row, (R, C, S, S) each.

    S = 2 radius + 1. The slopes are those of the plane that fits the valid nodes of the window
    best. The weights are 0 if the node is missing, or if no plane can be fitted.
    """
    rows, columns = valid.shape
    side = 2 * radius + 1
    padded = np.pad(valid.astype(np.float64), radius)
    there = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    offset = np.arange(-radius, radius + 1, dtype=np.float64)
    basis = np.stack(
        np.broadcast_arrays(np.ones((side, side)), offset[None, :], offset[:, None])
    ).reshape(3, -1)
    flat = there.reshape(rows, columns, -1)
    moments = np.einsum("rcs,is,js->rcij", flat, basis, basis, optimize=True)
    solvable = valid & fixes_plane(moments)
    moments[~solvable] = np.eye(3)
    weights = (np.linalg.inv(moments)[:, :, 1:] @ basis) * flat[:, :, None]
    weights = np.where(solvable[..., None, None], weights, 0)
    by_column, by_row = weights.reshape(rows, columns, 2, side, side).transpose(2, 0, 1, 3, 4)
    return by_column, by_row


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Slopes:
    """The covariance of the slopes of positions or displacements over the lattice.

    by_column, by_row: (R, C), their variances per node step and coordinate. covariance: (R, C, 3,
        3), of the values; the correlation of the coordinates is taken from it.
    """

    by_column: Array
    by_row: Array
    covariance: Array


def strain_deviation(
    rest: Array, now: Array, *, rest_slopes: Slopes, slopes: Slopes, radius: int = 2
) -> Array:
    """Return the standard deviations of the strain of `green_lagrange`, (R, C, 3).

    Q are the orthonormal axes of the plane at rest, F the current tangents along them, and dG and
    dA the errors of the slopes of the displacement and of the position at rest, along the same
    axes. To first order dE = sym(F^T dG + (F - Q F^T F)^T dA), plus a term for the rotation of
    axis 1 by Q2 . dA1, which changes the components. rest, now: (R, C, 3). rest_slopes, slopes: of
    the position and of the displacement. radius: as in `green_lagrange`. The result is NaN if the
    strain is NaN or an error is unknown.
    """
    good, first, second, inverse = _local_frames(rest, now, radius)
    axes, along = inverse @ first, inverse @ second
    strain = (along @ along.transpose(0, 2, 1) - np.eye(2)) / 2
    e11, e22, e12 = (strain[:, i, j, None] for i, j in ((0, 0), (1, 1), (0, 1)))
    one, two = along[:, 0], along[:, 1]
    turned = axes[:, 1]  # rotation of axis 1 by its own error
    off_one, off_two = np.moveaxis(along - (2 * strain + np.eye(2)) @ axes, 1, 0)
    none = np.zeros_like(one)
    parts = (
        (one, none, off_one + 2 * e12 * turned, none),
        (none, two, -2 * e12 * turned, off_two),
        (two / 2, one / 2, off_two / 2 + (e22 - e11) * turned, off_one / 2),
    )
    deviation = np.full((*good.shape, 3), np.nan)
    for number, (now_one, now_two, rest_one, rest_two) in enumerate(parts):
        variance = _variance(now_one, now_two, inverse, slopes, good)
        variance += _variance(rest_one, rest_two, inverse, rest_slopes, good)
        deviation[good, number] = np.sqrt(variance)
    return deviation


def _variance(one: Array, two: Array, inverse: Array, slopes: Slopes, good: Bools) -> Array:
    """Return the variance (N,) of one . g1 + two . g2, with g1, g2 the slopes' errors by axis."""
    mean = np.trace(slopes.covariance[good], axis1=1, axis2=2) / 3
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = slopes.covariance[good] / mean[:, None, None]
    both = np.stack([one, two], axis=1)
    sizes = both @ alike @ both.transpose(0, 2, 1)
    steps = np.stack([slopes.by_column[good], slopes.by_row[good]], axis=1)
    spread = np.einsum("nik,njk,nk->nij", inverse, inverse, steps)
    total: Array = (sizes * spread).sum(axis=(1, 2)).clip(0)
    return total


def _local_frames(rest: Array, now: Array, radius: int) -> tuple[Bools, Array, Array, Array]:
    """Return the nodes that have a strain, (R, C), and for these N nodes the tangent vectors at
    rest and now, (N, 2, 3), and the matrices (N, 2, 2) from steps between nodes to the axes."""
    both = np.concatenate([rest, now], axis=2)
    valid = ~np.isnan(both).any(axis=2)
    tangents = _tangents(np.where(valid[..., None], both, 0), valid, radius)
    area = np.linalg.norm(np.cross(tangents[..., 0, :3], tangents[..., 1, :3]), axis=-1)
    good = valid & (area > 1e-9 * np.square(tangents[..., :3]).sum(axis=(2, 3)))
    first, second = tangents[good, :, :3], tangents[good, :, 3:]
    inverse = np.linalg.inv(np.linalg.cholesky(first @ first.transpose(0, 2, 1)))
    return good, first, second, inverse


def _tangents(values: Array, valid: Bools, radius: int) -> Array:
    """Return slopes of the local plane by column and row: (R, C, K) -> (R, C, 2, K), or NaN."""
    sums, moments = plane_moments(values, valid[..., None], radius)
    count = moments[:, :, 0]
    solvable = fixes_plane(count)
    slopes = np.full((*valid.shape, 2, values.shape[2]), np.nan)
    slopes[solvable] = np.linalg.solve(count[solvable], sums[solvable])[:, 1:]
    return slopes


def plane_moments(values: Array, weights: NDArray[Any], radius: int) -> tuple[Array, Array]:
    """Return what the normal equations of a plane need from the window around each node.

    values: (R, C, K), 0 where they do not count. weights: (R, C, L). With the basis b = (1, column,
    row) from the node: the sums of b times the values, (R, C, 3, K), and of b b' times each weight,
    (R, C, L, 3, 3).
    """
    rows, columns = values.shape[:2]
    pad = ((radius, radius), (radius, radius), (0, 0))
    values, weights = np.pad(values, pad), np.pad(weights.astype(np.float64), pad)
    sums = np.zeros((rows, columns, 3, values.shape[2]))
    moments = np.zeros((rows, columns, weights.shape[2], 3, 3))
    for row in range(2 * radius + 1):
        for column in range(2 * radius + 1):
            at = slice(row, row + rows), slice(column, column + columns)
            basis = np.array([1.0, column - radius, row - radius])
            sums += basis[:, None] * values[at][:, :, None]
            moments += np.outer(basis, basis) * weights[at][..., None, None]
    return sums, moments


def fixes_plane(moments: Array) -> Bools:
    """Return whether the nodes of (..., 3, 3) moments are enough, and not on a line."""
    fixed: Bools = (moments[..., 0, 0] >= _LEAST_NODES) & (np.linalg.det(moments) > 1e-6)
    return fixed
