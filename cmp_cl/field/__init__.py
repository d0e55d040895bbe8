"""The displacement and the strain of the nodes as arrays, and their files."""

from cmp_cl.field.field import DisplacementField
from cmp_cl.field.strain import green_lagrange, surface_normals

__all__ = ["DisplacementField", "green_lagrange", "surface_normals"]
