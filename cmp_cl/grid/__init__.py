"""The grid of nodes: corners by row and column of the pattern."""

from cmp_cl.grid.build import build_grid
from cmp_cl.grid.filter import Filtered, filter_grid
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.grid.markers import refine_markers

__all__ = ["Filtered", "Grid", "NodeStatus", "build_grid", "filter_grid", "refine_markers"]
