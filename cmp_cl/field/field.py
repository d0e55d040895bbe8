"""Displacement of the nodes between two moments."""

import dataclasses
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field.strain import Slopes, green_lagrange, slope_weights, strain_deviation
from cmp_cl.field.writers import mesh_of, save
from cmp_cl.grid.filter import Filtered, filter_at_rest, filter_grid, noise_of_change
from cmp_cl.grid.grid import MEASURED, NodeStatus
from cmp_cl.space.points import Points3D, PointStatus, largest_deviation

Array = NDArray[np.float64]

_IN_FILES = ("position", "displacement", "sigma", "strain", "strain_sigma", "position_sigma")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisplacementField:
    """The position of each node at rest, and its displacement.

    position: (R, C, 3) float64, at rest, in `unit`, in the frame of the left camera; NaN
        unless the node is valid.
    displacement: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    covariance: (R, C, 3, 3) float64, of the displacement, in `unit` squared; NaN where unknown.
    position_covariance: (R, C, 3, 3) float64, the same of `position`.
    status: (R, C) uint8 of `PointStatus`: the status now, or that at rest if that is not VALID.
    source: (R, C) uint8 of `NodeStatus`: of those at rest and now, the less direct one.
    strain: (R, C, 3) float64, Green-Lagrange strain E11, E22, E12 in the tangent plane of
        the surface at rest, axis 1 along the rows; NaN where too few neighbours are valid;
        None if it was not asked for (`with_strain`).
    strain_sigma: (R, C, 3) float64, standard deviations of the strain; None without a strain.
    unit: name of the unit of length.
    raw: the field before the lattice filter; None if this one is not filtered.
    filtered: the filter's results for the position and the displacement; None if this field is
        not filtered.
    """

    position: Array
    displacement: Array
    covariance: Array
    position_covariance: Array
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    strain: Array | None = None
    strain_sigma: Array | None = None
    unit: str
    raw: "DisplacementField | None" = None
    filtered: tuple[Filtered, Filtered] | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a displacement."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def sigma(self) -> Array:
        """Return the standard deviation along the most uncertain axis, (R, C), in `unit`, or
        NaN."""
        return largest_deviation(self.covariance)

    @property
    def position_sigma(self) -> Array:
        """Return the same for the position at rest, (R, C) float64."""
        return largest_deviation(self.position_covariance)

    def with_strain(self, radius: int = 2) -> "DisplacementField":
        """Return the same field with its in-plane strain, fitted over (2 radius + 1)^2 nodes.

        The raw field gets its own strain. See `cmp_cl.field.green_lagrange` and
        `cmp_cl.field.strain_deviation`. Raises ConfigError if radius is not 1 to 50.
        """
        now = self.position + self.displacement
        strain = green_lagrange(self.position, now, radius=radius)
        weights = slope_weights(self.valid, radius)
        both = self.position_covariance, self.covariance
        if self.filtered is None:
            slopes = [_independent_slopes(weights, covariance) for covariance in both]
        else:
            slopes = [_slopes(weights, *each) for each in zip(self.filtered, both, strict=True)]
        return dataclasses.replace(
            self,
            strain=strain,
            strain_sigma=strain_deviation(
                self.position, now, rest_slopes=slopes[0], slopes=slopes[1], radius=radius
            ),
            raw=None if self.raw is None else self.raw.with_strain(radius),
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the field as .npz, .csv, .ply or .vtp, by suffix, whole or not at all.

        The raw field is written beside a filtered one; the names of its arrays begin with raw_.
        Raises ConfigError on another suffix, OSError if the file cannot be written.
        """
        save(path, _arrays(self), self.unit)


def mesh(field: DisplacementField) -> tuple[dict[str, NDArray[Any]], NDArray[np.int32]]:
    """Return columns of the valid nodes of a field, and the quadrilaterals between them, (Q, 4)
    indices; raises FieldError if field is of another type."""
    check_kind("field", field, DisplacementField, FieldError)
    return mesh_of(_arrays(field))


def _arrays(field: DisplacementField) -> dict[str, NDArray[Any]]:
    """Return the arrays of a field by name; those of the raw one begin with raw_."""
    arrays: dict[str, NDArray[Any]] = {}
    for begin, each in (("", field), ("raw_", field.raw)):
        for name in _IN_FILES:
            values = getattr(each, name, None)
            if values is not None:
                arrays[begin + name] = values
    return arrays | {"status": field.status, "source": field.source}


def _slopes(weights: tuple[Array, Array], filtered: Filtered, covariance: Array) -> Slopes:
    """Return the covariance of slopes of filtered displacements."""
    by_column, by_row = (np.square(filtered.deviation_of(each)) for each in weights)
    return Slopes(by_column=by_column, by_row=by_row, covariance=covariance)


def _independent_slopes(weights: tuple[Array, Array], covariance: Array) -> Slopes:
    """Return the covariance of slopes between nodes whose noise is independent."""
    variance = np.nan_to_num(np.trace(covariance, axis1=2, axis2=3) / 3, nan=0.0)
    reach = weights[0].shape[2] // 2
    padded = np.pad(variance, reach)
    around = np.lib.stride_tricks.sliding_window_view(padded, weights[0].shape[2:])
    by_column, by_row = ((np.square(each) * around).sum(axis=(2, 3)) for each in weights)
    return Slopes(by_column=by_column, by_row=by_row, covariance=covariance)


def displacement(rest: Points3D, now: Points3D, *, raw: bool = False) -> DisplacementField:
    """Return the displacement of each node between two moments, now - rest, by index.

    rest, now: the points at the two moments. The displacement and the position at rest are filtered
        over the lattice, see `cmp_cl.grid.filter_grid`, and the shift by bent edges is subtracted;
        raw=True does neither. The standard deviations are estimated from the lattice, and include
        wear. If the lattice is too small, they are those of the points, and the two moments are
        assumed independent.

    Raises FieldError if an argument is of another type, or if the shapes or the units differ.
    """
    check_kind("rest", rest, Points3D, FieldError)
    check_kind("now", now, Points3D, FieldError)
    if rest.status.shape != now.status.shape or rest.unit != now.unit:
        raise FieldError(
            f"rest has {rest.status.shape} nodes in {rest.unit}, "
            f"now has {now.status.shape} in {now.unit}"
        )
    status = np.where(now.valid, rest.status, now.status)
    valid = status == PointStatus.VALID
    source = np.maximum(rest.source, now.source)
    source[(rest.source == NodeStatus.MISSING) | (now.source == NodeStatus.MISSING)] = (
        NodeStatus.MISSING
    )
    position = np.where(valid[..., None], rest.xyz, np.nan)
    moved = np.where(valid[..., None], now.xyz - rest.xyz, np.nan)
    at_rest = filter_at_rest(rest.xyz, measured=np.isin(rest.source, MEASURED))
    change = filter_grid(
        moved,
        measured=np.isin(source, MEASURED),
        bends=True,
        most_noise=noise_of_change(at_rest, _per_axis(rest), _per_axis(now)),
    )
    unfiltered = DisplacementField(
        position=position,
        displacement=moved,
        covariance=_either(change.noise_covariance(), rest.covariance + now.covariance, valid),
        position_covariance=_either(at_rest.noise_covariance(), rest.covariance, valid),
        status=status,
        source=source,
        unit=rest.unit,
    )
    if raw:
        return unfiltered
    bent_rest, bent_now = (
        0.0 if points.bend_shift is None else points.bend_shift for points in (rest, now)
    )
    return DisplacementField(
        position=np.where(valid[..., None], at_rest.values - bent_rest, np.nan),
        displacement=change.values - (bent_now - bent_rest),
        covariance=_either(change.covariance(), rest.covariance + now.covariance, valid),
        position_covariance=_either(at_rest.covariance(), rest.covariance, valid),
        status=status,
        source=source,
        unit=rest.unit,
        raw=unfiltered,
        filtered=(at_rest, change),
    )


def _per_axis(points: Points3D) -> Array:
    """Return the standard deviation per axis of the points from their own images, (R, C)."""
    variance: Array = np.trace(points.covariance, axis1=2, axis2=3) / 3
    return np.sqrt(variance)


def _either(lattice: Array, points: Array, valid: NDArray[np.bool_]) -> Array:
    """Return the covariance from the lattice, or that of the points where the lattice has none."""
    known = np.isfinite(lattice).all(axis=(2, 3), keepdims=True)
    chosen: Array = np.where(known, lattice, points)
    return np.where(valid[..., None, None], chosen, np.nan)
