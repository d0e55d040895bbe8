"""Displacement and strain of the nodes, and their files."""

from cmp_cl.field.field import (
    DisplacementField,
    SeriesWriter,
    displacement,
    green_lagrange,
    mesh,
)

__all__ = ["DisplacementField", "SeriesWriter", "displacement", "green_lagrange", "mesh"]
