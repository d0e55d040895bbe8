"""Figures of a series: maps of a frame, one sheet of everything, and animations."""

import functools
import io
from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, check_kind, check_range, extra
from cmp_cl.files import suffix_of, whole_file, write_bytes
from cmp_cl.grid.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.viz.moments import (
    Array,
    Map,
    Moment,
    Quantity,
    Recorded,
    Summary,
    corners_of_cells,
    plane_of,
)
from cmp_cl.viz.video import Mp4

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ANIMATIONS = ".gif", ".mp4"  # suffixes
_SEQUENTIAL, _DIVERGING = "plasma", "RdBu_r"  # the colours of amounts, and of signed values
_ROUNDING = 1e-12  # smaller values, such as the strain of the frame at rest, are errors of rounding
_ARROWS, _ARROWS_ON_IMAGE, _ARROWS_IN_SPACE = 16, 26, 14  # along the longer side of a pattern
_SHORTEST_ARROW = 0.05  # of the longest one; shorter ones are dots on the surface
_PANEL, _CURVE = 3.9, 3.2  # in, side of a map and height of the curve of a sheet
_LEFT, _BESIDE, _BELOW, _ABOVE = 0.75, 1.75, 0.95, 0.4  # in, for labels and colour bars
_LEAST_OF_CURVE = 3  # frames; fewer make no curve
_MOST_ANIMATED = 300  # frames of an animation
_SLOWEST, _FASTEST = 2.0, 50.0  # frames per second of an animation


def new_figure(size: tuple[float, float]) -> "Figure":
    """Return an empty figure of that size, inches; raises ConfigError without matplotlib."""
    with extra("plot", "A figure"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, layout="constrained")


def save_figure(path: str | PathLike[str], figure: "Figure", *, dpi: int = 120) -> None:
    """Write a figure as PNG, whole or not at all.

    figure: of matplotlib. dpi: pixels per inch, 10 to 10 000. Raises FieldError if figure is of
    another type, ConfigError for another dpi, OSError.
    """
    from matplotlib.figure import Figure

    check_kind("figure", figure, Figure, FieldError)
    check_range("dpi", dpi, 10, 10_000)
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=dpi)


def map_figure(moment: Moment, quantity: Quantity, *, top: float | None = None) -> "Figure":
    """Draw a quantity of a moment, cell by cell on the pattern at rest, with a colour bar.

    The value of a cell is the mean of its four nodes. Signed values have a scale that is white
    at 0. top: the end of the scale; None means the largest value. Raises FieldError, and
    ConfigError without matplotlib.
    """
    maps = moment.maps(quantity)
    top = _top_of_maps(maps) if top is None else top
    figure, places, _ = _page(1, len(maps), f"frame {moment.index}")
    for place, shown in zip(places, maps, strict=True):
        _draw_map(figure.add_subplot(place), moment, shown, top)
    return figure


def sheet_figure(
    moment: Moment,
    summary: Summary | None = None,
    *,
    title: str = "",
    view: tuple[GreyImage, Grid, Grid] | None = None,
    rows: Sequence[tuple[str, str]] = (),
) -> "Figure":
    """Draw a frame on one sheet: its maps, its surface, and the curves of the series.

    moment: the frame. summary: of the series; without it, or with fewer than three frames, there
    are no curves. title: of the sheet; "" is the number of the frame. view: the image now, with its
    grid at rest and now, for arrows on it. rows: names and values of a table. With a table or a
    view there is no map of sigma.

    Raises FieldError if there are too few nodes for a map, ConfigError without matplotlib.
    """
    panels: list[Callable[[Figure, Any], object]] = []
    if view is not None:
        panels.append(lambda figure, at: _draw_view(figure.add_subplot(at), *view))
    known = np.isfinite(moment.rest + moment.shift).all(axis=2)
    if moment.in_space and np.count_nonzero(known) > 2:
        panels.append(
            lambda figure, at: _draw_surface(figure.add_subplot(at, projection="3d"), moment)
        )
    left_out = {Quantity.SIGMA} if rows or view else set()
    left_out |= {Quantity.DISPLACEMENT} if view and moment.in_space else set()
    for quantity in moment.quantities():
        if quantity not in left_out:
            maps = moment.maps(quantity)
            top = _top_of_maps(maps)
            panels += [functools.partial(_draw_panel, moment, shown, top) for shown in maps]
    if rows:
        panels.append(lambda figure, at: _draw_table(figure.add_subplot(at), rows))
    curves = summary if summary and len(summary.index) >= _LEAST_OF_CURVE else None
    across = 3 if len(panels) % 2 or len(panels) > 4 else 2
    down = -(-len(panels) // across)
    title = title or f"frame {moment.index}"
    figure, places, below = _page(down, across, title, with_curve=curves is not None)
    for draw, place in zip(panels, places, strict=False):
        draw(figure, place)
    if curves is not None:
        _draw_curves(figure.add_subplot(below), curves, moment.unit)
    return figure


def _page(
    down: int, across: int, title: str, *, with_curve: bool = False
) -> tuple["Figure", list[Any], Any]:
    """Return a figure with places for square panels and their colour bars, and one for a curve."""
    wide = _PANEL * across + _BESIDE * across
    high = (_PANEL + _BELOW) * down + _ABOVE + _CURVE * with_curve
    figure = new_figure((wide, high))
    figure.set_layout_engine("none")
    figure.text(0.5, 1 - 0.1 / high, title, ha="center", va="top", fontsize=15)
    bottom = _CURVE * with_curve + _BELOW - 0.4
    grid = figure.add_gridspec(
        down, across,
        left=_LEFT / wide, right=1 - (_BESIDE - _LEFT) / wide,
        bottom=bottom / high, top=1 - (_ABOVE + 0.4) / high,
        wspace=_BESIDE / _PANEL, hspace=_BELOW / _PANEL,
    )  # fmt: skip
    below = figure.add_gridspec(
        1, 1,
        left=_LEFT / wide, right=1 - 0.3 / wide,
        bottom=0.55 / high, top=(_CURVE - 0.5) / high,
    )[0] if with_curve else None  # fmt: skip
    return figure, [grid[row, column] for row in range(down) for column in range(across)], below


def _draw_panel(moment: Moment, shown: Map, top: float, figure: "Figure", at: Any) -> None:
    _draw_map(figure.add_subplot(at), moment, shown, top)


def _draw_map(axes: "Axes", moment: Moment, shown: Map, top: float) -> None:
    """Draw a map on the pattern at rest; top: the end of its scale."""
    from matplotlib.collections import PolyCollection

    nodes, directions = moment.plane()
    cells = np.stack(corners_of_cells(nodes), axis=2)
    whole = ~np.isnan(cells).any(axis=(2, 3))
    values = shown.cells[whole]
    drawn = PolyCollection(
        list(cells[whole]),
        array=np.ma.masked_invalid(values),
        cmap=_DIVERGING if shown.signed else _SEQUENTIAL,
        clim=(-top if shown.signed else 0.0, top),
        edgecolors="face",
        linewidths=0.2,
    )
    axes.add_collection(drawn)
    points = nodes[~np.isnan(nodes[..., 0])]
    low, high = points.min(axis=0), points.max(axis=0)
    edge = 0.03 * float((high - low).max() or 1.0)
    names = ("along rows", "along columns") if moment.in_space else ("x", "y")
    title = shown.title if np.isfinite(values).any() else f"{shown.title}: no cell has a value"
    if shown.title == "displacement":
        factor = 2 * float((high - low).max()) / _ARROWS / top  # the longest has two distances
        some = _spread(~np.isnan(shown.values) & ~np.isnan(nodes[..., 0]), _ARROWS)
        shift = (moment.shift @ directions[: nodes.shape[2], : moment.shift.shape[2]].T)[some]
        axes.quiver(
            *nodes[some].T, *shift.T,
            angles="xy", scale_units="xy", scale=1 / factor,
            color="white", edgecolor="black", linewidth=0.3, width=4e-3,
        )  # fmt: skip
        title += f", arrows {factor:.2g} x"
    axes.set(
        xlim=(low[0] - edge, high[0] + edge),
        ylim=(high[1] + edge, low[1] - edge),
        aspect="equal",
        facecolor="0.9",
        xlabel=f"{names[0]} / {moment.unit}",
        ylabel=f"{names[1]} / {moment.unit}",
        title=title,
    )
    _colour_bar(axes, drawn, f"{shown.title} / {shown.unit}")


def _draw_view(axes: "Axes", image: GreyImage, rest: Grid, now: Grid) -> None:
    """Draw arrows on the image from the nodes at rest to the nodes now, to scale."""
    shift = (now.xy - rest.xy).astype(np.float64)
    length = np.linalg.norm(shift, axis=2)
    some = _spread(~np.isnan(length), _ARROWS_ON_IMAGE)
    axes.imshow(image, cmap="gray", interpolation="nearest", alpha=0.7)
    arrows = axes.quiver(
        *rest.xy[some].T, *shift[some].T, length[some],
        angles="xy", scale_units="xy", scale=1, width=4e-3, cmap=_SEQUENTIAL,
        clim=(0, _top_of(length)),
    )  # fmt: skip
    rows, columns = image.shape
    axes.set(
        xlim=(-0.5, columns - 0.5),
        ylim=(rows - 0.5, -0.5),
        xlabel="x / px",
        ylabel="y / px",
        title="moved since rest, in the image",
    )
    _colour_bar(axes, arrows, "displacement / px")


def _draw_surface(axes: Any, moment: Moment) -> None:
    """Draw the surface now, coloured by displacement, with some arrows from rest.

    The axes run along the rows, along the columns, and towards the cameras out of the plane that
    fits the positions at rest best. The height is stretched to a fifth of the width.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    directions, origin = plane_of(np.where(np.isnan(moment.shift), np.nan, moment.rest))
    rest, shift = (moment.rest - origin) @ directions.T, moment.shift @ directions.T
    now = rest + shift
    valid = ~np.isnan(now[..., 0])
    length = np.linalg.norm(shift, axis=2)
    colours = ScalarMappable(Normalize(0, _top_of(length)), _SEQUENTIAL)

    cells = np.stack(corners_of_cells(now), axis=2)
    whole = ~np.isnan(cells).any(axis=(2, 3))
    faces = colours.to_rgba(np.mean(corners_of_cells(length), axis=0)[whole])
    axes.computed_zorder = False  # the arrows are drawn after the surface
    axes.add_collection3d(
        Poly3DCollection(cells[whole], facecolors=faces, edgecolors=faces, linewidths=0.2, zorder=1)
    )
    some = _spread(valid, _ARROWS_IN_SPACE) & (length > _SHORTEST_ARROW * _top_of(length))
    axes.quiver(
        *rest[some].T, *shift[some].T,
        color="black", linewidths=0.7, alpha=0.8, arrow_length_ratio=0.25, zorder=2,
    )  # fmt: skip
    points = np.concatenate([rest[valid], now[valid]])
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
    axes.zaxis.set_major_locator(MaxNLocator(3))
    axes.set_box_aspect(span * [1, 1, stretch], zoom=1.0)
    axes.view_init(elev=32, azim=-60)
    beside = axes.inset_axes((0.2, 0.0, 0.6, 0.035))
    label = f"displacement / {moment.unit}"
    axes.figure.colorbar(colours, cax=beside, label=label, orientation="horizontal")


def _draw_table(axes: "Axes", rows: Sequence[tuple[str, str]]) -> None:
    from matplotlib.transforms import Bbox

    axes.set_axis_off()
    table = axes.table(
        [list(row) for row in rows],
        bbox=Bbox.from_bounds(0, 0.15, 1.27, 0.7),
        colWidths=[0.56, 0.44],
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(11)


def _draw_curves(axes: "Axes", summary: Summary, unit: str) -> None:
    """Draw the largest and the median displacement over time, or over frames without times."""
    time, label = np.array(summary.time_ms) / 1e3, "time / s"
    if not np.isfinite(time).all():
        time, label = np.array(summary.index, np.float64), "frame"
    axes.plot(time, summary.largest, ".-", lw=1, ms=3, label="largest of all nodes")
    axes.plot(time, summary.median, ".-", lw=1, ms=3, label="median of all nodes")
    axes.set_ylim(bottom=0)
    axes.set(xlabel=label, ylabel=f"displacement / {unit}", title="displacement over time")
    axes.grid(alpha=0.3)
    axes.legend()


def _colour_bar(axes: "Axes", drawn: Any, label: str) -> None:
    beside = axes.inset_axes((1.03, 0.05, 0.04, 0.9))
    axes.figure.colorbar(drawn, cax=beside, label=label)


def _spread(valid: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Return (R, C), True at valid nodes of which at most about `most` lie along a side."""
    step = -(-max(valid.shape) // most)
    some = np.zeros_like(valid)
    some[step // 2 :: step, step // 2 :: step] = True
    return some & valid


def _top_of(values: Array) -> float:
    """Return the upper end of a colour scale: the largest size of a known value."""
    top = float(np.nan_to_num(np.abs(values)).max(initial=0))
    return top if top > _ROUNDING else 1.0


def _top_of_maps(maps: Sequence[Map]) -> float:
    return _top_of(np.stack([each.cells for each in maps]))


def animate(
    path: str | PathLike[str],
    recorded: Recorded,
    quantity: Quantity,
    *,
    step: Callable[[], object] = lambda: None,
) -> int:
    """Write the map of a quantity over all frames, on one scale, as .gif or .mp4.

    It runs as fast as the recording, from 2 to 50 frames per second; of more than 300 frames it
    shows every second one, and so on. step: called after each. Returns the number of frames shown.

    Raises ConfigError on another suffix or without matplotlib, FieldError, OSError.
    """
    suffix = suffix_of(path, ConfigError)
    if suffix not in ANIMATIONS:
        raise ConfigError(f"{str(path)!r}: an animation must end in {' or '.join(ANIMATIONS)}")
    every = -(-len(recorded.index) // _MOST_ANIMATED)
    places = range(0, len(recorded.index), every)
    period = np.diff(recorded.time_ms)
    period = period[np.isfinite(period) & (period > 0)]
    fps = 1e3 / float(np.median(period)) / every if len(period) else 10.0
    fps = min(max(fps, _SLOWEST), _FASTEST)
    pictures = _pictures(recorded, quantity, places, step)
    if suffix == ".mp4":
        with Mp4(path, fps=fps) as video:
            for picture in pictures:
                video.write(np.ascontiguousarray(picture[..., ::-1]))
    else:
        _write_gif(path, pictures, fps)
    return len(places)


def _pictures(
    recorded: Recorded, quantity: Quantity, places: Sequence[int], step: Callable[[], object]
) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture (H, W, 3), RGB, of each of the frames at these places."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    cells = (each.cells for n in places for each in recorded.moment(n).maps(quantity))
    top = _top_of(np.array([np.nan_to_num(np.abs(each)).max(initial=0) for each in cells]))
    for place in places:
        canvas: Any = FigureCanvasAgg(map_figure(recorded.moment(place), quantity, top=top))
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
        step()


def _write_gif(
    path: str | PathLike[str], pictures: Iterator[NDArray[np.uint8]], fps: float
) -> None:
    from PIL import Image

    first = next(pictures)
    palette = Image.fromarray(first).quantize(256)  # the colour bar has all colours
    others = (Image.fromarray(each).quantize(palette=palette) for each in pictures)
    data = io.BytesIO()
    palette.save(
        data,
        format="GIF",
        save_all=True,
        append_images=others,
        duration=round(1000 / fps),
        loop=0,
    )
    write_bytes(path, data.getvalue())
