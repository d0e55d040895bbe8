"""One sheet that shows all measurements of a press in two views."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.viz.figures import draw_arrows, draw_surface
from cmp_cl.viz.overlays import grid_overlay
from cmp_cl.viz.plots import Quantity, Recorded, draw_map, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def press_sheet(
    image: GreyImage,
    rest: Grid,
    now: Grid,
    field: DisplacementField,
    *,
    title: str,
    rows: Sequence[tuple[str, str]],
) -> "Figure":
    """Draw the left view with its nodes, arrows, the surface, height, strain, and a table.

    image: (H, W), the left view now. rest, now: the grids of the left view. field: the displacement
    in space. rows: names and values for the table.

    Raises FieldError if fewer than three nodes are valid, ConfigError without matplotlib.
    """
    figure = new_figure((15.0, 18.0))
    figure.suptitle(title, fontsize=18)
    at = figure.add_gridspec(3, 2)
    picture = figure.add_subplot(at[0, 0])
    picture.imshow(grid_overlay(image, now)[..., ::-1])  # from OpenCV's BGR
    picture.set(title="found and numbered: left view")
    picture.set_axis_off()
    arrows = figure.add_subplot(at[0, 1])
    draw_arrows(arrows, image, rest, now, field=field)
    arrows.set(title="moved since rest")
    surface = figure.add_subplot(at[1, 0], projection="3d", computed_zorder=False)
    draw_surface(surface, field)
    surface.set(title="in space")
    recorded = Recorded.of(
        {
            "rest": field.position,
            "displacement": field.displacement[None],
            "index": np.zeros(1, np.int64),
            "time_ms": np.full(1, np.nan),
            "unit": np.array(field.unit),
        }
    )
    for cell, quantity in ((at[1, 1], Quantity.HEIGHT), (at[2, 0], Quantity.STRAIN)):
        axes = figure.add_subplot(cell)
        draw_map(figure, axes, recorded, quantity, 0)
        axes.set_title(quantity.value)
    table = figure.add_subplot(at[2, 1])
    table.set_axis_off()
    drawn = table.table([list(row) for row in rows], loc="center", edges="horizontal")
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(11)
    drawn.auto_set_column_width([0, 1])
    drawn.scale(1, 1.4)
    return figure
