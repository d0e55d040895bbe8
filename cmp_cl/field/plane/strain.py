"""Strain in the plane, from one view, and its covariance to first order."""

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind, check_range
from cmp_cl.field.plane.displacement import PlaneField
from cmp_cl.field.strain import fixes_plane, plane_moments, slope_weights

Array = NDArray[np.float64]

_UNIFORM = math.pi / math.sqrt(12)  # rad, standard deviation of a completely unknown direction
_DISTINCT = 3.0  # standard deviations: noise alone exceeds them in 1 % of cases (Rayleigh)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlaneStrain:
    """Green-Lagrange strain in the plane.

    tensor: (R, C, 3) float64, Exx, Eyy, Exy (half the engineering shear), along the axes of
        the field; NaN where too few neighbours are valid.
    covariance: (R, C, 3, 3) float64, of these three, from the errors of the positions alone; NaN
        where unknown. The smoothing of a strain that varies within the window is not included.
    """

    tensor: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Return (R, C, 3) float64: the standard deviations of the tensor's entries."""
        deviation: Array = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return deviation

    def principal(self) -> "PrincipalStrain":
        """Return the largest and the smallest strain, and the direction of the largest one."""
        xx, yy, xy = np.moveaxis(self.tensor, -1, 0)
        mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        direction = np.arctan2(xy, (xx - yy) / 2) / 2
        cosine, sine = np.cos(direction), np.sin(direction)
        # Derivatives of v1'Ev1, v2'Ev2 and v1'Ev2 by Exx, Eyy and Exy.
        along = np.stack([cosine**2, sine**2, 2 * sine * cosine], axis=-1)
        across = np.stack([sine**2, cosine**2, -2 * sine * cosine], axis=-1)
        turning = np.stack([-sine * cosine, sine * cosine, cosine**2 - sine**2], axis=-1)
        first, second, mixed = (
            np.sqrt(np.einsum("...i,...ij,...j", row, self.covariance, row))
            for row in (along, across, turning)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.where(half > _DISTINCT * mixed, mixed / (2 * half), _UNIFORM)
        return PrincipalStrain(
            strain=np.stack([mean + half, mean - half], axis=-1),
            sigma=np.stack([first, second], axis=-1),
            direction=direction,
            sigma_direction=np.where(np.isnan(mixed), np.nan, spread),
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PrincipalStrain:
    """Principal strains of a plane.

    strain: (R, C, 2) float64, the larger and the smaller one; sigma: (R, C, 2) of them. Where the
        two differ by less than their sigma, the difference may be noise alone.
    direction: (R, C) float64 in [-pi/2, pi/2], rad, of the larger one, from x towards y.
    sigma_direction: (R, C), rad. If half the difference of the strains is below 3 of its standard
        deviations, it is pi / sqrt(12), that of an unknown direction.
    """

    strain: Array
    sigma: Array
    direction: Array
    sigma_direction: Array


def plane_strain(field: PlaneField, *, radius: int = 2) -> PlaneStrain:
    """Return the Green-Lagrange strain E = (F'F - 1) / 2 at every node of a field, with its
        covariance.

    Around each node a plane in (column, row) is fitted to the positions at rest and now by least
    squares, over the (2 radius + 1)^2 nodes, which gives the gradient F of the positions now with
    respect to those at rest. Nodes without a sigma are used only if no node has one. Wear is
    assumed to keep its size; if it stretches with the material, large strains are more certain than
    their sigma says.

    The strain is NaN if the node is missing, if its window has fewer than 6 nodes, or if these lie
    on a line. Raises FieldError if field is of another type, ConfigError if radius is not a whole
    number from 1 to 50.
    """
    check_kind("field", field, PlaneField, FieldError)
    check_range("radius", radius, 1, 50, kind=int)
    valid = field.valid
    known = valid & np.isfinite(field.sigma)
    used = known if known.any() else valid
    raw = field if field.raw is None else field.raw
    slopes, errors = _local_planes(
        np.concatenate([field.position, field.now], axis=2),
        np.stack([raw.sigma_position, raw.sigma], axis=-1),
        used,
        radius,
    )
    added: Any = 0.0
    if raw.shared is not None:
        at_rest, now = raw.shared
        added = _of_neighbours(np.stack([at_rest, at_rest + now]), used, radius)
    if field.filtered is not None:  # it reduces shared errors as much as the others
        own, errors = errors, _shared_errors(field, used, radius)
        before, after = (np.einsum("...aa->...a", each) for each in (own, errors))
        less = np.sqrt(np.divide(after, before, out=np.zeros_like(after), where=before > 0))
        added = added * np.einsum("rcma,rcmb->rcmab", less, less)[:, :, :, None, None]
    errors = np.eye(2)[:, :, None, None] * errors[:, :, :, None, None] + added
    before, after = slopes[..., :2], slopes[..., 2:]
    size = np.square(before).sum(axis=(-2, -1))
    area = before[..., 0, 0] * before[..., 1, 1] - before[..., 0, 1] * before[..., 1, 0]
    good = valid & (np.abs(area) > 1e-9 * size)
    tensor, covariance = np.full((*valid.shape, 3), np.nan), np.full((*valid.shape, 3, 3), np.nan)
    back = np.linalg.inv(before[good])
    gradient = (back @ after[good]).transpose(0, 2, 1)
    green = (gradient.transpose(0, 2, 1) @ gradient - np.eye(2)) / 2
    tensor[good] = np.stack([green[:, 0, 0], green[:, 1, 1], green[:, 0, 1]], axis=-1)
    covariance[good] = _strain_covariance(gradient, back, errors[good])
    return PlaneStrain(tensor=tensor, covariance=covariance)


def _local_planes(
    values: Array, sigma: Array, used: NDArray[np.bool_], radius: int
) -> tuple[Array, Array]:
    """Fit the plane a + b column + c row to the values around each node.

    values: (R, C, K). sigma: (R, C, L), of values with independent errors. used: (R, C), the nodes
        to fit. Returns the slopes by column and by row, (R, C, 2, K), and their covariances, (R, C,
        L, 2, 2); NaN if the plane is not determined.
    """
    weights = np.concatenate([used[..., None], np.where(used[..., None], sigma**2, 0)], axis=2)
    sums, moments = plane_moments(np.where(used[..., None], values, 0), weights, radius)
    count = moments[:, :, 0]
    solvable = fixes_plane(count)
    inverse = np.full(count.shape, np.nan)
    inverse[solvable] = np.linalg.inv(count[solvable])
    errors = (inverse[:, :, None] @ moments[:, :, 1:] @ inverse[:, :, None])[..., 1:, 1:]
    return (inverse @ sums)[..., 1:, :], errors


def _shared_errors(field: PlaneField, used: NDArray[np.bool_], radius: int) -> Array:
    """Return the covariances (R, C, 2, 2, 2) of the slopes of filtered positions and displacements,
    whose errors neighbours share."""
    errors = np.zeros((*used.shape, 2, 2, 2))
    stencils = slope_weights(used, radius)
    pairs = zip(field.filtered or (), (field.sigma_position, field.sigma), strict=True)
    for number, (filtered, sigma) in enumerate(pairs):
        with np.errstate(invalid="ignore", divide="ignore"):
            zoomed = np.square(sigma / filtered.sigma)  # the zoom of a motion that was removed
        for axis, stencil in enumerate(stencils):
            variance = np.square(filtered.deviation_of(stencil)) * zoomed
            errors[:, :, number, axis, axis] = variance
    return errors


def _of_neighbours(shared: Array, used: NDArray[np.bool_], radius: int) -> Array:
    """Return the part of the slopes' covariances that comes from errors that neighbours share.

    shared: (M, 2, 2, 2), of M values. The result is (R, C, M, 2, 2, 2, 2): by value, two
    coordinates, and two axes.
    """
    stencils = np.stack(slope_weights(used, radius), axis=2)
    added = np.zeros((*used.shape, len(shared), 2, 2, 2, 2))
    for covariance, one, two in (
        (shared[:, 0], stencils[..., 1:], stencils[..., :-1]),
        (shared[:, 1], stencils[..., 1:, :], stencils[..., :-1, :]),
    ):
        along = np.einsum("rcjde,rclde->rcjl", one, two, optimize=True)
        along += along.swapaxes(2, 3)
        added += covariance[:, :, :, None, None] * along[:, :, None, None, None]
    return added


def _strain_covariance(gradient: Array, back: Array, errors: Array) -> Array:
    """Return the covariance (N, 3, 3) of Exx, Eyy, Exy.

    gradient: (N, 2, 2) F. back: (N, 2, 2), derivatives of column and row by the axes at rest.
    errors: (N, 2, 2, 2, 2, 2), covariances of the slopes of the position and of the displacement:
    by value, two coordinates, and two of column and row.
    """
    # An error e of the position at rest is also one of the position now: it acts on F as (1 - F) e.
    weights = np.einsum("nja,nmikab,nlb->nmijkl", back, errors, back, optimize=True)
    moved = gradient - np.eye(2)
    of_gradient = weights[:, 1] + np.einsum(
        "nia,najbl,nkb->nijkl", moved, weights[:, 0], moved, optimize=True
    )
    eye = np.eye(2)
    by_gradient = np.stack(
        [
            np.einsum("ni,j->nij", gradient[:, :, a], eye[b])
            + np.einsum("ni,j->nij", gradient[:, :, b], eye[a])
            for a, b in ((0, 0), (1, 1), (0, 1))
        ],
        axis=1,
    )
    covariance: Array = np.einsum(
        "naij,nijkl,nbkl->nab", by_gradient / 2, of_gradient, by_gradient / 2, optimize=True
    )
    return covariance
