"""The grid of nodes: corners by row and column of the pattern."""

from cmp_cl.grid.align import align
from cmp_cl.grid.build import build_grid, build_grids
from cmp_cl.grid.grid import Grid, NodeStatus, Others, Rival, Sides
from cmp_cl.grid.number import number

__all__ = [
    "Grid",
    "NodeStatus",
    "Others",
    "Rival",
    "Sides",
    "align",
    "build_grid",
    "build_grids",
    "number",
]
