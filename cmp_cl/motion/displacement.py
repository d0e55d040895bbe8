"""The displacement of each node, from two grids of one camera, or from points in space."""

import dataclasses
from typing import overload

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field.field import DisplacementField
from cmp_cl.filter import Filtered, filter_grid, noise_of_change
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus
from cmp_cl.motion.moments import Moment, covariance_from
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


def _in_the_plane(rest: Grid, now: Grid, scale: PlaneScale | None) -> tuple[Moment, Moment]:
    if not now.covers(rest):
        raise FieldError(f"rest has {rest.extent}, now has {now.extent}")
    scale = PlaneScale.pixels() if scale is None else scale
    check_kind("scale", scale, PlaneScale, FieldError)
    return Moment.in_plane(rest, scale), Moment.in_plane(now.cut_to(rest), scale)


def _in_space(rest: Points3D, now: Points3D, scale: None) -> tuple[Moment, Moment]:
    if scale is not None:
        raise FieldError("points in space have a unit; a scale is for the grids of one camera")
    if rest.status.shape != now.status.shape or rest.unit != now.unit:
        raise FieldError(
            f"rest has {rest.status.shape} nodes in {rest.unit}, "
            f"now has {now.status.shape} in {now.unit}"
        )
    return Moment.in_space(rest), Moment.in_space(now)


def _between(rest: Moment, now: Moment, *, raw: bool) -> DisplacementField:
    """Return the field between two moments of the same nodes."""
    status = np.where(now.valid, rest.status, now.status)
    valid = status == PointStatus.VALID
    source = np.maximum(rest.source, now.source)
    source[(rest.source == NodeStatus.MISSING) | (now.source == NodeStatus.MISSING)] = (
        NodeStatus.MISSING
    )
    moved = np.where(valid[..., None], now.at - rest.at, np.nan)
    at_rest = rest.filtered
    change = filter_grid(
        moved,
        measured=np.isin(source, MEASURED),
        bends=True,
        most_noise=noise_of_change(at_rest, rest.own, now.own),
    )
    change_by_images = rest.covariance + now.covariance

    def chosen(filtered: Filtered, sigma: Array, by_images: Array) -> Array:
        found = covariance_from(filtered, sigma, by_images)
        return np.where(valid[..., None, None], found, np.nan)

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
