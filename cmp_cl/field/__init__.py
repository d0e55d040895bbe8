"""Displacement and strain of the nodes, and their files."""

from cmp_cl.field.field import DisplacementField, displacement
from cmp_cl.field.series import SeriesWriter
from cmp_cl.field.strain import green_lagrange
from cmp_cl.field.writers import mesh

__all__ = ["DisplacementField", "SeriesWriter", "displacement", "green_lagrange", "mesh"]
