"""Strain of a plane or of a surface from its nodes, principal strains, and normals of a surface."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, as_numbers
from cmp_cl.filter import STRAIN_REACH

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_LEAST_NODES = 6  # fewest nodes of a window to which a plane is fitted
_AXES = {2: [(0, 1)], 3: [(0, 1), (0, 2), (1, 2)]}  # pairs of coordinates
_UNKNOWN = math.pi / math.sqrt(12)  # rad, standard deviation of a completely unknown direction
_DISTINCT = 3.0  # standard deviations: noise alone exceeds them in 1 % of cases (Rayleigh)


def green_lagrange(rest: Array, now: Array) -> Array:
    """Return the Green-Lagrange strain of a plane, or of a surface in its tangent plane at rest.

    rest, now: (R, C, 2) or (R, C, 3) positions of the same nodes, NaN where missing. Around each
    node a plane in (column, row) is fitted to both by least squares, over the valid ones of the
    5 x 5 nodes, to give the tangent vectors A = (a1, a2) at rest and B now. With A = Q U in
    orthonormal axes Q, E = (U^-T B^T B U^-1 - I) / 2. In a plane, the axes are x and y. On a
    surface, axis 1 runs along the rows, and axis 2 is perpendicular to it, towards the columns. A
    rigid motion gives 0. On an outer line the window lies to one side: the strain is that of its
    middle, one cell inwards, and half a cell on the next line.

    Returns (R, C, 3) E11, E22, E12 (half the engineering shear); NaN if the node is missing, if its
    window has fewer than 6 nodes, or if these lie on a line.

    Raises FieldError if rest or now has another shape.
    """
    rest, now = as_numbers("rest", rest, FieldError), as_numbers("now", now, FieldError)
    if rest.ndim != 3 or rest.shape[2] not in (2, 3) or now.shape != rest.shape:
        raise FieldError(
            f"rest and now must be (R, C, 2) or (R, C, 3), not {rest.shape} and {now.shape}"
        )
    both = np.concatenate([rest, now], axis=2)
    valid = np.isfinite(both).all(axis=2)
    size, slopes = rest.shape[2], _slopes_of(both, valid)
    at_rest = slopes[..., :size]
    one, two = at_rest[..., 0, :], at_rest[..., 1, :]
    turns = [one[..., i] * two[..., j] - one[..., j] * two[..., i] for i, j in _AXES[size]]
    area = np.sqrt(np.square(turns).sum(axis=0))
    good = valid & (area > 1e-9 * np.square(at_rest).sum(axis=(2, 3)))
    first = at_rest[good]
    in_axes = first if size == 2 else np.linalg.cholesky(first @ first.transpose(0, 2, 1))
    along = np.linalg.solve(in_axes, slopes[good][..., size:])  # the current tangents
    tensor = (along @ along.transpose(0, 2, 1) - np.eye(2)) / 2
    strain = np.full((*good.shape, 3), np.nan)
    strain[good] = tensor[:, [0, 1, 0], [0, 1, 1]]
    return strain


def principal_of(strain: Array, covariance: Array) -> tuple[Array, Array, Array, Array]:
    """Return the principal strains and their standard deviations, (R, C, 2), and the direction of
    the larger one and its standard deviation, rad, (R, C).

    strain: (R, C, 3). covariance: (R, C, 3, 3). Where half the difference of the principal strains
    is below three of its standard deviations, the direction counts as unknown.
    """
    e11, e22, e12 = np.moveaxis(strain, 2, 0)
    mean, half = (e11 + e22) / 2, np.hypot((e11 - e22) / 2, e12)
    direction = np.arctan2(e12, (e11 - e22) / 2) / 2
    cosine, sine = np.cos(direction), np.sin(direction)
    # Derivatives of v1'Ev1, v2'Ev2 and v1'Ev2 by E11, E22 and E12.
    by_strain = [
        [cosine**2, sine**2, 2 * sine * cosine],
        [sine**2, cosine**2, -2 * sine * cosine],
        [-sine * cosine, sine * cosine, cosine**2 - sine**2],
    ]
    rows = np.array(by_strain).transpose(2, 3, 0, 1)
    deviation = np.sqrt(((rows @ covariance) * rows).sum(axis=3).clip(0))
    mixed = deviation[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(half > _DISTINCT * mixed, mixed / (2 * half), _UNKNOWN)
    return (
        np.stack([mean + half, mean - half], axis=2),
        deviation[..., :2],
        direction,
        np.where(np.isnan(direction), np.nan, turn),
    )


def _slopes_of(values: Array, valid: Bools) -> Array:
    """Return the slopes per step along a row and along a column, (R, C, 2, K), of the plane that
    fits the valid nodes of the window around each node best; NaN where no plane is determined.

    values: (R, C, K). valid: (R, C).
    """
    down, along = (_window(n) for n in valid.shape)
    data = np.where(valid[..., None], values, 0).transpose(2, 0, 1)
    sums = [down[p] @ data @ along[q].T for p, q in ((0, 0), (0, 1), (1, 0))]
    inverse = _inverse_moments(valid)
    slopes: Array = inverse[:, :, 1:] @ np.stack(sums).transpose(2, 3, 0, 1)
    return slopes


def surface_normals(positions: Array) -> Array:
    """Return the unit normals of a surface (R, C, 3) in the frame of the left camera.

    positions: (R, C, 3), NaN where missing. A normal is that of the plane through the 5 x 5 nodes
        around a node, and points to the side on which the origin is. It is NaN if the node is
        missing, if fewer than 6 of these nodes are valid, or if all lie on a line.

    Raises FieldError if positions are of another shape.
    """
    positions = as_numbers("positions", positions, FieldError)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise FieldError(f"positions must be (R, C, 3), not {positions.shape}")
    valid: NDArray[np.bool_] = np.all(np.isfinite(positions), axis=2)
    along, down = np.moveaxis(_slopes_of(positions, valid), 2, 0)
    normal = np.cross(along, down)
    length = np.linalg.norm(normal, axis=2)
    flat = length <= 1e-9 * np.linalg.norm(along, axis=2) * np.linalg.norm(down, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: Array = normal / np.where(flat, np.nan, length)[..., None]
    away = (unit * positions).sum(axis=2) > 0
    return np.where(valid[..., None], np.where(away[..., None], -unit, unit), np.nan)


@functools.lru_cache(maxsize=64)
def _window(n: int) -> Array:
    """Return three matrices (3, n, n): the offset from node to node to the power 0, 1 and 2, within
    the window; 0 outside."""
    offset = np.arange(n) - np.arange(n)[:, None]
    inside = np.abs(offset) <= STRAIN_REACH
    return np.stack([inside * offset.astype(np.float64) ** power for power in range(3)])


def _inverse_moments(valid: Bools) -> Array:
    """Return the inverse (R, C, 3, 3) of the normal equations of a plane a + b column + c row in
    the window around each node; NaN where they determine none."""
    down, along = (_window(n) for n in valid.shape)
    there = valid.astype(np.float64)
    one, c, r, cc, rc, rr = (
        down[p] @ there @ along[q].T for p, q in ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))
    )
    moments = np.array([[one, c, r], [c, cc, rc], [r, rc, rr]]).transpose(2, 3, 0, 1)
    fixed = (one >= _LEAST_NODES) & (np.linalg.det(moments) > 1e-6)
    inverse = np.full(moments.shape, np.nan)
    inverse[fixed] = np.linalg.inv(moments[fixed])
    return inverse
