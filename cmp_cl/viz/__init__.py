"""Overlays, figures, videos and recordings of the results."""

from cmp_cl.viz.figures import (
    METHOD_COLOURS,
    STATUS_COLOURS,
    Projection,
    RerunLog,
    arrow_figure,
    corner_overlay,
    grid_overlay,
    rest_plane,
    save_figure,
    surface_figure,
)

__all__ = [
    "METHOD_COLOURS",
    "STATUS_COLOURS",
    "Projection",
    "RerunLog",
    "arrow_figure",
    "corner_overlay",
    "grid_overlay",
    "rest_plane",
    "save_figure",
    "surface_figure",
]
