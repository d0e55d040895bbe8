"""Displacement and strain of the nodes, and their files."""

from cmp_cl.field.contact import Contact, contact_of, surface_normals
from cmp_cl.field.displacement import displacement
from cmp_cl.field.field import DisplacementField, mesh
from cmp_cl.field.scale import PlaneScale
from cmp_cl.field.strain import green_lagrange

__all__ = [
    "Contact",
    "DisplacementField",
    "PlaneScale",
    "contact_of",
    "displacement",
    "green_lagrange",
    "mesh",
    "surface_normals",
]
