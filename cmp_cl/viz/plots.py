"""Figures of a series: maps of a frame, and one sheet of everything."""

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from cmp_cl.errors import extra
from cmp_cl.files import suffix_of, whole_file
from cmp_cl.points import corners_of_cells, of_cells
from cmp_cl.viz.moments import Map, Moment, Quantity, Summary, plane_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SEQUENTIAL, _DIVERGING = "plasma", "RdBu_r"  # the colours of amounts, and of signed values
_ROUNDING = 1e-12  # smaller values, such as the strain of the frame at rest, are errors of rounding
_ARROWS = 16  # along the longer side of a pattern
_DPI = 120  # pixels per inch of a picture
_PANEL, _CURVE = (5.6, 4.9), 3.2  # in, width and height of a map, and the height of the curve
_LEAST_OF_CURVE = 3  # frames; fewer make no curve


def new_figure(size: tuple[float, float]) -> "Figure":
    """Return an empty figure of that size, inches; raises ConfigError without matplotlib."""
    with extra("plot", "A figure"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, layout="constrained")


def save_figure(path: str | PathLike[str], figure: "Figure") -> None:
    """Write a figure of matplotlib in the format of the suffix, such as .png or .svg, whole or not
    at all; raises OSError, and ValueError for one that matplotlib does not have."""
    kind = suffix_of(path)[1:]
    from matplotlib.text import Text

    for text in figure.findobj(Text):  # no TeX: units and names of files may have any characters
        text.set_parse_math(False)
    with whole_file(path) as file:
        figure.savefig(file, format=kind, dpi=_DPI)


def map_figure(moment: Moment, quantity: Quantity) -> "Figure":
    """Draw a quantity of a moment, cell by cell on the pattern at rest, with a colour bar.

    The value of a cell is the mean of its four nodes. Signed values have a scale that is white
    at 0. Raises FieldError, and ConfigError without matplotlib.
    """
    return _page(moment, [quantity])


def sheet_figure(moment: Moment, summary: Summary | None = None, *, title: str = "") -> "Figure":
    """Draw a frame on one sheet: its maps, its surface, and the curves of the series.

    moment: the frame. summary: of the series; without it, or with fewer than three frames, there
    are no curves. title: of the sheet; "" is the number of the frame.

    Raises FieldError if there are too few nodes for a map, ConfigError without matplotlib.
    """
    known = np.isfinite(moment.rest + moment.shift).all(axis=2)
    return _page(
        moment,
        moment.quantities(),
        title=title,
        surface=moment.in_space and bool(known.sum() > 2),
        curves=summary if summary and len(summary.curves) >= _LEAST_OF_CURVE else None,
    )


def _page(
    moment: Moment,
    quantities: Sequence[Quantity],
    *,
    title: str = "",
    surface: bool = False,
    curves: Summary | None = None,
) -> "Figure":
    """Return a figure with the maps of the quantities, those of one on one scale, the surface and
    below them the curves."""
    maps = [(each, _top_of(group)) for group in map(moment.maps, quantities) for each in group]
    count = len(maps) + surface
    across = 3 if count > 4 else min(count, 2)
    down = -(-count // across)
    heights = [_PANEL[1]] * down + [_CURVE] * (curves is not None)
    figure = new_figure((_PANEL[0] * across, sum(heights) + 0.4))
    doubt = ": all of it may be wrong" if moment.doubtful else ""
    if curves is not None and any(curves.doubtful):
        doubt += f"; {sum(curves.doubtful)} of {len(curves.doubtful)} frames may be wrong"
    figure.suptitle(title or f"frame {moment.index}{doubt}")
    grid = figure.add_gridspec(len(heights), across, height_ratios=heights)
    for number, (shown, largest) in enumerate(maps):
        axes = figure.add_subplot(grid[divmod(number, across)])
        _draw_map(axes, moment, shown, largest)
    if surface:
        place = grid[divmod(len(maps), across)]
        _draw_surface(figure.add_subplot(place, projection="3d"), moment)
    if curves is not None:
        _draw_curves(figure.add_subplot(grid[down, :]), curves, moment.unit)
    return figure


def _draw_map(axes: "Axes", moment: Moment, shown: Map, top: float) -> None:
    """Draw a map on the pattern at rest; top: the end of its scale."""
    nodes, directions = moment.plane()
    cells = np.where(np.isnan(of_cells(nodes)).any(axis=2), np.nan, shown.cells)
    drawn = axes.pcolormesh(
        *np.moveaxis(np.nan_to_num(nodes), 2, 0),  # a cell without a value is not drawn
        np.ma.masked_invalid(cells),
        cmap=_DIVERGING if shown.signed else _SEQUENTIAL,
        vmin=-top if shown.signed else 0.0,
        vmax=top,
    )
    points = nodes[~np.isnan(nodes[..., 0])]
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max()) or 1.0
    names = ("along rows", "along columns") if moment.in_space else ("x", "y")
    title = shown.title if np.isfinite(cells).any() else f"{shown.title}: no cell has a value"
    if shown.title == "displacement":
        scale = top * _ARROWS / (2 * extent)  # the longest arrow has two distances
        step = -(-max(shown.values.shape) // _ARROWS)
        some = np.zeros(shown.values.shape, np.bool_)
        some[step // 2 :: step, step // 2 :: step] = True
        some &= ~np.isnan(shown.values) & ~np.isnan(nodes[..., 0])
        shift = (moment.shift @ directions[: nodes.shape[2], : moment.shift.shape[2]].T)[some]
        axes.quiver(
            *nodes[some].T, *shift.T,
            angles="xy", scale_units="xy", scale=scale,
            color="white", edgecolor="black", linewidth=0.3, width=4e-3,
        )  # fmt: skip
        title += f", arrows {1 / scale:.2g} x"
    edge = 0.03 * extent
    axes.set(
        xlim=(low[0] - edge, high[0] + edge),
        ylim=(high[1] + edge, low[1] - edge),
        aspect="equal",
        facecolor="0.9",
        xlabel=f"{names[0]} / {moment.unit}",
        ylabel=f"{names[1]} / {moment.unit}",
        title=title,
    )
    axes.figure.colorbar(drawn, ax=axes, label=f"{shown.title} / {shown.unit}", shrink=0.85)


def _draw_surface(axes: Any, moment: Moment) -> None:
    """Draw the surface now, coloured by displacement.

    The axes run along the rows, along the columns, and towards the cameras out of the plane that
    fits the positions at rest best. The height is stretched to a fifth of the width.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    directions, origin = plane_of(np.where(np.isnan(moment.shift), np.nan, moment.rest))
    now = (moment.rest + moment.shift - origin) @ directions.T
    cells = np.stack(corners_of_cells(now), axis=2)
    whole = ~np.isnan(cells).any(axis=(2, 3))
    (shown,) = moment.maps(Quantity.DISPLACEMENT)
    drawn = Poly3DCollection(
        cells[whole],
        array=shown.cells[whole],
        cmap=_SEQUENTIAL,
        clim=(0, _top_of([shown])),
        linewidths=0.2,
    )
    axes.add_collection3d(drawn)
    points = now[~np.isnan(now[..., 0])]
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-3 * (high - low).max())
    low, high = (low + high - span) / 2, (low + high + span) / 2
    stretch = max(1.0, 0.2 * float(span[:2].max() / span[2]))
    axes.set(
        xlim=(low[0], high[0]),
        ylim=(high[1], low[1]),
        zlim=(low[2], high[2]),
        xlabel=f"along rows / {moment.unit}",
        ylabel=f"along columns / {moment.unit}",
        zlabel=f"height / {moment.unit} (x {stretch:.2g})",
        title="surface",
    )
    axes.set_box_aspect(span * [1, 1, stretch])
    axes.locator_params(axis="z", nbins=3)
    label = f"displacement / {moment.unit}"
    axes.figure.colorbar(drawn, ax=axes, label=label, shrink=0.6, pad=0.15)


def _draw_curves(axes: "Axes", summary: Summary, unit: str) -> None:
    """Draw the largest and the median displacement over time, or over frames without times."""
    index, time_ms, largest, median = np.transpose(summary.curves)
    time, label = time_ms / 1e3, "time / s"
    if not np.isfinite(time).all():
        time, label = index, "frame"
    doubtful = np.array(summary.doubtful)
    for values, label_of_curve in ((largest, "largest"), (median, "median")):
        (curve,) = axes.plot(
            time, np.where(doubtful, np.nan, values), ".-", lw=1, ms=3,
            label=f"{label_of_curve} of all nodes",
        )  # fmt: skip
        if doubtful.any():
            what = f"{label_of_curve}, where all may be wrong"
            axes.plot(
                time[doubtful], values[doubtful], "o", ms=5, mfc="none",
                color=curve.get_color(), label=what,
            )  # fmt: skip
    axes.set_ylim(bottom=0)
    axes.set(xlabel=label, ylabel=f"displacement / {unit}", title="displacement over time")
    axes.grid(alpha=0.3)
    axes.legend()


def _top_of(maps: Sequence[Map]) -> float:
    """Return the upper end of the colour scale of some maps: the largest size of a known value."""
    top = float(np.nan_to_num(np.abs([each.cells for each in maps])).max(initial=0))
    return top if top > _ROUNDING else 1.0
