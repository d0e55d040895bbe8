"""Overlays, figures, videos and a live view of the results."""

from cmp_cl.viz.moments import Moment, Quantity
from cmp_cl.viz.overlays import METHOD_COLOURS, STATUS_COLOURS, corner_overlay, grid_overlay
from cmp_cl.viz.plots import map_figure, save_figure, sheet_figure

__all__ = [
    "METHOD_COLOURS",
    "STATUS_COLOURS",
    "Moment",
    "Quantity",
    "corner_overlay",
    "grid_overlay",
    "map_figure",
    "save_figure",
    "sheet_figure",
]
