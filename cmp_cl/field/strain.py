"""Strain of a plane or of a surface from its nodes, principal strains, and normals of a surface."""

import functools
import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, as_numbers
from cmp_cl.fits import surface_slopes

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

_MOST_VARIANCE = 10.0  # of a slope, where that of each node is 1
_TERMS = ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))  # powers of row and column of a surface
_AXES = {2: [(0, 1)], 3: [(0, 1), (0, 2), (1, 2)]}  # pairs of coordinates
_UNKNOWN = math.pi / math.sqrt(12)  # rad, standard deviation of a completely unknown direction
_DISTINCT = 3.0  # standard deviations: noise alone exceeds them in 1 % of cases (Rayleigh)


def green_lagrange(rest: Array, now: Array) -> Array:
    """Return the Green-Lagrange strain of a plane, or of a surface in its tangent plane at rest.

    rest, now: (R, C, 2) or (R, C, 3) positions of the same nodes, NaN where missing. Around each
    node a surface in (column, row) is fitted to both by least squares. In the middle of 5 x 5 nodes
    it is a cubic one. Where one of these is missing it is a quadratic one over 3 x 3, or over the
    valid ones of 5 x 5; at a border they lie to one side. Its tangent vectors at the node are A =
    (a1, a2) at rest and B now. With A = Q U in orthonormal axes Q, E = (U^-T B^T B U^-1 - I) / 2.
    In a plane, the axes are x and y. On a surface, axis 1 runs along the rows, and axis 2 is
    perpendicular to it, towards the columns. A rigid motion gives 0. The noise of unfiltered
    positions is not averaged over more nodes than these.

    Returns (R, C, 3) E11, E22, E12 (half the engineering shear); NaN if the node is missing, or if
    the valid nodes do not determine the tangents.

    Raises FieldError if rest or now has another shape.
    """
    rest, now = as_numbers("rest", rest, FieldError), as_numbers("now", now, FieldError)
    if rest.ndim != 3 or rest.shape[2] not in (2, 3) or now.shape != rest.shape:
        raise FieldError(
            f"rest and now must be (R, C, 2) or (R, C, 3), not {rest.shape} and {now.shape}"
        )
    both = np.concatenate([rest, now], axis=2)
    valid = np.isfinite(both).all(axis=2)
    size, slopes = rest.shape[2], _slopes_of(both, valid, 2)
    down, along = (_window(n, 1)[0] for n in valid.shape)
    whole = down @ valid @ along.T > 8
    slopes[whole] = _slopes_of(both, valid, 1)[whole]
    if min(valid.shape) >= 5:
        there = np.where(valid[..., None], both, np.nan)
        near = sliding_window_view(there, (5, 5), axis=(0, 1))
        cubic = np.einsum("rckij,sij->rcsk", near, surface_slopes(2, 3)[2, 2])
        slopes[2:-2, 2:-2] = np.where(np.isnan(cubic), slopes[2:-2, 2:-2], cubic)
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


def _slopes_of(values: Array, valid: Bools, half: int) -> Array:
    """Return the slopes per step along a row and along a column, (R, C, 2, K), at each node,
    of the quadratic surface that fits the valid nodes of its window best; NaN where they determine
    none.

    values: (R, C, K). valid: (R, C). half: half width of the windows, nodes.
    """
    down, along = (_window(n, half) for n in valid.shape)
    data = np.where(valid[..., None], values, 0).transpose(2, 0, 1)
    sums = np.stack([down[p] @ data @ along[q].T for p, q in _TERMS]).transpose(2, 3, 0, 1)
    there = valid.astype(np.float64)
    powers = [[(p + r, q + s) for r, s in _TERMS] for p, q in _TERMS]
    moments = np.array([[down[p] @ there @ along[q].T for p, q in row] for row in powers])
    moments = moments.transpose(2, 3, 0, 1)  # of integers
    by = np.zeros((*valid.shape, 2, len(_TERMS)))  # the derivatives of the terms at the node
    y, x = np.meshgrid(*(_aside(n, half) for n in valid.shape), indexing="ij")
    by[..., 0, 1], by[..., 0, 3], by[..., 0, 4] = 1, 2 * x, y
    by[..., 1, 2], by[..., 1, 4], by[..., 1, 5] = 1, x, 2 * y
    fixed = np.linalg.det(moments) > 0.5
    weights = np.linalg.solve(moments[fixed], by[fixed].swapaxes(1, 2)).swapaxes(1, 2)
    slopes = np.full((*valid.shape, 2, values.shape[2]), np.nan)
    slopes[fixed] = weights @ sums[fixed]
    variance = np.full((*valid.shape, 2), np.inf)
    variance[fixed] = (weights * by[fixed]).sum(axis=2)
    slopes[(variance > _MOST_VARIANCE).any(axis=2)] = np.nan
    return slopes


def surface_normals(positions: Array) -> Array:
    """Return the unit normals of a surface (R, C, 3) in the frame of the left camera.

    positions: (R, C, 3), NaN where missing. A normal is that of the quadratic surface through
        the 5 x 5 nodes around a node, and points to the side on which the origin is. It is NaN if
        the node is missing, or if the valid ones of these nodes determine none.

    Raises FieldError if positions are of another shape.
    """
    positions = as_numbers("positions", positions, FieldError)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise FieldError(f"positions must be (R, C, 3), not {positions.shape}")
    valid: NDArray[np.bool_] = np.all(np.isfinite(positions), axis=2)
    along, down = np.moveaxis(_slopes_of(positions, valid, 2), 2, 0)
    normal = np.cross(along, down)
    length = np.linalg.norm(normal, axis=2)
    flat = length <= 1e-9 * np.linalg.norm(along, axis=2) * np.linalg.norm(down, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit: Array = normal / np.where(flat, np.nan, length)[..., None]
    away = (unit * positions).sum(axis=2) > 0
    return np.where(valid[..., None], np.where(away[..., None], -unit, unit), np.nan)


@functools.lru_cache(maxsize=64)
def _window(n: int, half: int) -> Array:
    """Return five matrices (5, n, n): the offset of each node from the middle of the window around
    one, to the power 0 to 4, within the window; 0 outside."""
    offset = np.arange(n) - (np.arange(n) - _aside(n, half))[:, None]
    inside = np.abs(offset) <= min(half, (n - 1) // 2)
    return np.stack([inside * offset**power for power in range(5)])


def _aside(n: int, half: int) -> Array:
    """Return how far each node lies from the middle of its window, (n,), which ends at the
    border."""
    nodes, half = np.arange(n), min(half, (n - 1) // 2)
    return (nodes - np.clip(nodes, half, n - 1 - half)).astype(np.float64)
