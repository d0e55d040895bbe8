"""The displacement of each node, from two grids of one camera, or from points in space."""

import dataclasses
import math
from typing import overload

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field.field import DisplacementField
from cmp_cl.filter import (
    Filtered,
    bend_shift,
    filter_at_rest,
    filter_grid,
    noise_of_change,
)
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.points import Points3D, PointStatus

Array = NDArray[np.float64]


@overload
def displacement(
    rest: Grid, now: Grid, *, scale: PlaneScale | None = None, raw: bool = False
) -> DisplacementField: ...
@overload
def displacement(rest: Points3D, now: Points3D, *, raw: bool = False) -> DisplacementField: ...
def displacement(
    rest: Grid | Points3D,
    now: Grid | Points3D,
    *,
    scale: PlaneScale | None = None,
    raw: bool = False,
) -> DisplacementField:
    """Return the displacement of each node between two moments, now - rest, by its number.

    rest, now: two grids of one camera give a field in the plane, (R, C, 2); points in space from
        two cameras give one in space, (R, C, 3). The field has the rows and columns of the grid at
        rest; nodes beyond them have no displacement.
    scale: from the image to the plane; None means px. For grids only.
    raw: leave out the filter.

    The displacement and the position at rest are filtered over the lattice, see
    `cmp_cl.filter.filter_grid`, and the shift by bent edges is subtracted. The standard deviations
    are estimated from the lattice, and include wear. If the lattice is too small, they are those
    of the corners or points, and the two moments are assumed independent. In the plane, both axes
    have the same.

    Raises FieldError if an argument is of another type, if the shapes or the units differ, or if
    now does not have all rows and columns of the grid at rest.
    """
    if isinstance(rest, Grid):
        check_kind("now", now, Grid, FieldError)
        before, after = _in_the_plane(rest, now, scale)  # type: ignore[arg-type]
    else:
        check_kind("rest", rest, Points3D, FieldError)
        check_kind("now", now, Points3D, FieldError)
        before, after = _in_space(rest, now, scale)  # type: ignore[arg-type]
    return _between(before, after, raw=raw)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Moment:
    """The nodes at one moment: positions (R, C, D), their covariance from the images alone, (R, C,
    D, D), their status and source, (R, C), and the shift by bent edges, (R, C, D)."""

    at: Array
    covariance: Array
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    bend: Array
    unit: str

    @property
    def valid(self) -> NDArray[np.bool_]:
        return np.equal(self.status, PointStatus.VALID)

    @property
    def own(self) -> Array:
        """Return the standard deviation per axis from the images, (R, C)."""
        variance: Array = np.trace(self.covariance, axis1=2, axis2=3) / self.at.shape[2]
        return np.sqrt(variance)


def _in_the_plane(rest: Grid, now: Grid, scale: PlaneScale | None) -> tuple[_Moment, _Moment]:
    if not now.covers(rest):
        raise FieldError(f"rest has {rest.extent}, now has {now.extent}")
    scale = PlaneScale.pixels() if scale is None else scale
    check_kind("scale", scale, PlaneScale, FieldError)
    return _seen(rest, scale), _seen(now.cut_to(rest), scale)


def _seen(grid: Grid, scale: PlaneScale) -> _Moment:
    at, slope = scale(grid.xy)
    per_axis = grid.image_sigma * np.sqrt(np.square(slope).sum(axis=(-2, -1)) / 2)
    variance = np.where(per_axis > 0, np.square(per_axis), np.nan)
    return _Moment(
        at=at,
        covariance=variance[..., None, None] * np.eye(2),
        status=np.where(grid.valid, PointStatus.VALID, PointStatus.MISSING).astype(np.uint8),
        source=grid.status,
        bend=(slope @ _bend_shift(grid)[..., None])[..., 0],
        unit=scale.unit,
    )


def _bend_shift(grid: Grid) -> Array:
    """Return the shift of the nodes by bent edges, (R, C, 2), px; 0 if the radius is unknown."""
    if not math.isfinite(grid.edge_radius):
        return np.zeros(grid.xy.shape)
    filtered = filter_at_rest(grid.xy, measured=np.isin(grid.status, MEASURED))
    return bend_shift(filtered.values, grid.edge_radius)


def _in_space(rest: Points3D, now: Points3D, scale: None) -> tuple[_Moment, _Moment]:
    if scale is not None:
        raise FieldError("points in space have a unit; a scale is for the grids of one camera")
    if rest.status.shape != now.status.shape or rest.unit != now.unit:
        raise FieldError(
            f"rest has {rest.status.shape} nodes in {rest.unit}, "
            f"now has {now.status.shape} in {now.unit}"
        )
    before, after = (
        _Moment(
            at=each.xyz,
            covariance=each.covariance,
            status=each.status,
            source=each.source,
            bend=np.zeros_like(each.xyz) if each.bend_shift is None else each.bend_shift,
            unit=each.unit,
        )
        for each in (rest, now)
    )
    return before, after


def _between(rest: _Moment, now: _Moment, *, raw: bool) -> DisplacementField:
    """Return the field between two moments of the same nodes."""
    status = np.where(now.valid, rest.status, now.status)
    valid = status == PointStatus.VALID
    source = np.maximum(rest.source, now.source)
    source[(rest.source == NodeStatus.MISSING) | (now.source == NodeStatus.MISSING)] = (
        NodeStatus.MISSING
    )
    moved = np.where(valid[..., None], now.at - rest.at, np.nan)
    at_rest = filter_at_rest(rest.at, measured=np.isin(rest.source, MEASURED))
    change = filter_grid(
        moved,
        measured=np.isin(source, MEASURED),
        bends=True,
        most_noise=noise_of_change(at_rest, rest.own, now.own),
    )
    change_by_images = rest.covariance + now.covariance

    def chosen(filtered: Filtered, sigma: Array, by_images: Array) -> Array:
        """Return the covariance from the lattice, or from the images where that is unknown."""
        lattice = filtered.covariance_of(sigma)
        if lattice.shape[2] == 2:  # in the plane, both axes have the same
            lattice = np.square(sigma)[..., None, None] * np.eye(2)
        known = np.isfinite(lattice).all(axis=(2, 3), keepdims=True)
        return np.where(valid[..., None, None], np.where(known, lattice, by_images), np.nan)

    unfiltered = DisplacementField(
        position=np.where(valid[..., None], rest.at, np.nan),
        displacement=moved,
        covariance=chosen(change, change.noise, change_by_images),
        position_covariance=chosen(at_rest, at_rest.noise, rest.covariance),
        status=status,
        source=source,
        unit=rest.unit,
        lattice=(at_rest, change),
    )
    if raw:
        return unfiltered
    return dataclasses.replace(
        unfiltered,
        position=np.where(valid[..., None], at_rest.values - rest.bend, np.nan),
        displacement=change.values - (now.bend - rest.bend),
        covariance=chosen(change, change.sigma, change_by_images),
        position_covariance=chosen(at_rest, at_rest.sigma, rest.covariance),
        raw=unfiltered,
    )
