"""The displacement of each node, from two grids of one camera, or from points in space."""

import numpy as np

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field.field import DisplacementField
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.motion.filter import filtered
from cmp_cl.motion.moments import AtRest, Moment, measured_of
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.points import Points3D, PointStatus


def displacement(
    rest: Grid | Points3D,
    now: Grid | Points3D,
    *,
    scale: PlaneScale | None = None,
    device: Device | str | None = None,
) -> DisplacementField:
    """Return the displacement of each node between two moments, now - rest, by its number.

    rest, now: two grids of one camera give a field in the plane, (R, C, 2); points in space from
        two cameras give one in space, (R, C, 3). The field has the rows and columns of the grid at
        rest; nodes beyond them have no displacement.
    scale: from the image to the plane; None means px. For grids only.
    device: a Device, a text for `select_device`, or None for the default device.

    The displacement and the position at rest are filtered over the lattice, see
    `cmp_cl.motion.filter`, and the shift by bent edges is subtracted; `raw` has them before. The
    standard deviations are estimated from the lattice, and include wear. If the lattice is too
    small, they are those of the corners or points, and the two moments are assumed independent. In
    the plane, both axes have the same. To measure a recording, see `cmp_cl.measure`.

    Raises FieldError if an argument is of another type, if the shapes or the units differ, or if
    now does not have all rows and columns of the grid at rest; DeviceError.
    """
    if isinstance(rest, Grid):
        check_kind("now", now, Grid, FieldError)
        before, after = _in_the_plane(rest, now, scale)  # type: ignore[arg-type]
    else:
        check_kind("rest", rest, Points3D, FieldError)
        check_kind("now", now, Points3D, FieldError)
        before, after = _in_space(rest, now, scale)  # type: ignore[arg-type]
    return _between(before, after, select_device(device))


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


def _between(rest: Moment, now: Moment, device: Device) -> DisplacementField:
    """Return the field between two moments of the same nodes."""
    status = np.where(now.valid, rest.status, now.status)
    source = np.maximum(rest.source, now.source)
    source[(rest.source == NodeStatus.MISSING) | (now.source == NodeStatus.MISSING)] = (
        NodeStatus.MISSING
    )
    at_rest, valid = AtRest(rest, device), status == PointStatus.VALID
    moved = np.where(valid[..., None], now.at - rest.at, np.nan)
    change = filtered(
        moved,
        measured_of(source, valid),
        rest.covariance + now.covariance,
        device,
        own=now.own,
        most=at_rest.most,
    )
    return at_rest.field(
        status=status,
        source=source,
        moved=moved,
        displacement=change.values - (now.bend - rest.bend),
        covariance=change.covariance,
        raw_covariance=change.raw_covariance,
    )
