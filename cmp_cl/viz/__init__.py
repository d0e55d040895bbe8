"""Overlays, figures, videos and recordings of the results."""

from cmp_cl.viz.figures import (
    arrow_figure,
    save_figure,
    surface_figure,
)
from cmp_cl.viz.overlays import METHOD_COLOURS, STATUS_COLOURS, corner_overlay, grid_overlay
from cmp_cl.viz.recording import RerunLog

__all__ = [
    "METHOD_COLOURS",
    "STATUS_COLOURS",
    "RerunLog",
    "arrow_figure",
    "corner_overlay",
    "grid_overlay",
    "save_figure",
    "surface_figure",
]
