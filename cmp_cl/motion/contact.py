"""The contact on a surface: its depth and area."""

import dataclasses
import math
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field import DisplacementField, surface_normals
from cmp_cl.points import of_cells

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Contact:
    """The contact on a surface, found from its displacement.

    depth: (R, C) float64, the displacement along the normal at rest, towards the cameras, in
        `unit`; NaN where the normal or the displacement is missing.
    sigma: (R, C) float64, its standard deviation, NaN where unknown.
    normal: (R, C, 3) float64, unit normals of the surface now, towards the cameras, or NaN.
    inside: (R, C) bool, nodes deeper than the given depth.
    area: area of these nodes on the surface at rest, in `unit` squared.
    deepest: the largest depth in `unit`, NaN where no depth is known.
    """

    depth: Array
    sigma: Array
    normal: Array
    inside: NDArray[np.bool_]
    area: float
    deepest: float
    unit: str


def contact_of(field: DisplacementField, *, deeper_than: float) -> Contact:
    """Return the part of the surface that is pressed in by more than a given depth.

    field: the displacement. deeper_than: the depth, in the field's unit. A gel is indented beside
        the contact too, and bulges further out. So the area is that of the indentation at that
        depth; it is the area of the contact only if the depth was chosen for the gel. A node adds a
        quarter of each complete cell around it.

    Raises FieldError if the depth is not a finite number, or field is of another type.
    """
    check_kind("field", field, DisplacementField, FieldError)
    check_kind("deeper_than", deeper_than, Real, FieldError)
    if not math.isfinite(deeper_than):
        raise FieldError(f"a depth must be a finite number, not {deeper_than!r}")
    before = surface_normals(field.position)
    depth = (field.displacement * before).sum(axis=2)
    variance = np.einsum("...i,...ij,...j", before, field.covariance, before)
    inside = np.nan_to_num(depth, nan=-math.inf) > deeper_than
    areas = of_cells(inside) * _cell_areas(field.position)
    known = depth[~np.isnan(depth)]
    return Contact(
        depth=depth,
        sigma=np.sqrt(variance),
        normal=surface_normals(field.position + field.displacement),
        inside=inside,
        area=float(np.nansum(areas)),
        deepest=float(known.max()) if len(known) else math.nan,
        unit=field.unit,
    )


def _cell_areas(positions: Array) -> Array:
    """Return the areas of the cells, (R - 1, C - 1), from their diagonals; NaN if a node is
    missing."""
    one = positions[1:, 1:] - positions[:-1, :-1]
    other = positions[1:, :-1] - positions[:-1, 1:]
    return np.asarray(np.linalg.norm(np.cross(one, other), axis=2) / 2, np.float64)
