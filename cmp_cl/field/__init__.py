"""Displacement and strain of the nodes, and their files."""

from cmp_cl.field.contact import Contact, contact_of, surface_normals
from cmp_cl.field.field import DisplacementField, displacement, mesh
from cmp_cl.field.plane import (
    Motion,
    PlaneField,
    PlaneScale,
    PlaneStrain,
    PrincipalStrain,
    motion_of,
    plane_displacement,
    plane_strain,
    with_measured_noise,
    without_motion,
)
from cmp_cl.field.strain import green_lagrange

__all__ = [
    "Contact",
    "DisplacementField",
    "Motion",
    "PlaneField",
    "PlaneScale",
    "PlaneStrain",
    "PrincipalStrain",
    "contact_of",
    "displacement",
    "green_lagrange",
    "mesh",
    "motion_of",
    "plane_displacement",
    "plane_strain",
    "surface_normals",
    "with_measured_noise",
    "without_motion",
]
