"""Displacement and strain of the nodes, and their files."""

from cmp_cl.field.contact import Contact, contact_of, surface_normals
from cmp_cl.field.field import DisplacementField, displacement, mesh
from cmp_cl.field.plane import (
    Motion,
    PlaneField,
    PlaneScale,
    PlaneStrain,
    PrincipalStrain,
    Raster,
    motion_of,
    plane_displacement,
    plane_strain,
    rasterize,
    with_measured_noise,
    without_motion,
)
from cmp_cl.field.poisson import (
    Boundary,
    Potential,
    integrate,
    projected_density,
    surface_height,
)
from cmp_cl.field.strain import green_lagrange

__all__ = [
    "Boundary",
    "Contact",
    "DisplacementField",
    "Motion",
    "PlaneField",
    "PlaneScale",
    "PlaneStrain",
    "Potential",
    "PrincipalStrain",
    "Raster",
    "contact_of",
    "displacement",
    "green_lagrange",
    "integrate",
    "mesh",
    "motion_of",
    "plane_displacement",
    "plane_strain",
    "projected_density",
    "rasterize",
    "surface_height",
    "surface_normals",
    "with_measured_noise",
    "without_motion",
]
