"""Pictures of a series: maps of a quantity at one frame, curves over time, animations."""

import dataclasses
import enum
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.extras import extra
from cmp_cl.field import green_lagrange
from cmp_cl.files import suffix_of, write_bytes
from cmp_cl.grid.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.viz.figures import (
    DIVERGING,
    SEQUENTIAL,
    colour_bar,
    corners_of_cells,
    draw_arrows,
    draw_surface,
    plane_of,
    spread,
    top_of,
)
from cmp_cl.viz.video import Mp4

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Series = Mapping[str, NDArray[Any]]

NEEDED = "index", "time_ms", "rest", "displacement", "xy", "sigma", "unit"  # arrays of a series
ANIMATIONS = ".gif", ".mp4"  # suffixes
_ARROWS = 16  # along the longer side of a map
_PANEL, _CURVE = 3.9, 3.2  # in, side of a map and height of the curve of a sheet
_LEFT, _BESIDE, _BELOW, _ABOVE = 0.75, 1.75, 0.95, 0.4  # in, for labels and colour bars
_LEAST_OF_CURVE = 3  # frames; fewer make no curve
_MOST_ANIMATED = 300  # frames of an animation
_SLOWEST, _FASTEST = 2.0, 50.0  # frames per second of an animation


class Quantity(enum.Enum):
    """The quantity of a node that a map shows.

    DISPLACEMENT: its length, with some arrows. STRAIN: both principal Green-Lagrange strains in the
    plane or in the surface, %. HEIGHT: the displacement towards the cameras, out of the plane that
    fits the rest positions best; two views only. SIGMA: the standard deviation of the displacement
    (two views) or of the position now (one view).
    """

    DISPLACEMENT = "displacement"
    STRAIN = "strain"
    HEIGHT = "height"
    SIGMA = "sigma"


@dataclasses.dataclass(frozen=True)
class _Map:
    """The values (R, C) of a map, its title, its unit, and whether they have a sign."""

    title: str
    values: Array
    unit: str
    signed: bool = False

    @property
    def cells(self) -> Array:
        """Return the value of each cell, the mean of its four nodes, (R - 1, C - 1)."""
        return np.asarray(np.mean(corners_of_cells(self.values), axis=0))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Moment:
    """What is drawn of one frame.

    rest: (R, C, 2) or (R, C, 3) in `unit`. shift: the displacement, of the same shape. sigma:
    (R, C), NaN where unknown. index: the number of the frame.
    """

    rest: Array
    shift: Array
    sigma: Array
    unit: str
    index: int

    @property
    def in_space(self) -> bool:
        return bool(self.rest.shape[2] == 3)

    def plane(self) -> tuple[Array, Array]:
        """Return the positions at rest (R, C, 2) to draw on, and (3, 3) axes of that plane.

        Raises FieldError if fewer than three nodes are valid, or all lie on a line.
        """
        if not self.in_space:
            return self.rest, np.eye(3)
        axes, origin = plane_of(self.rest)
        return ((self.rest - origin) @ axes.T)[..., :2], axes

    def quantities(self) -> list[Quantity]:
        """Return the quantities that the frame has."""
        found = [Quantity.DISPLACEMENT]
        found += [Quantity.HEIGHT] if self.in_space else []
        found += [Quantity.SIGMA] if np.isfinite(self.sigma).any() else []
        return [*found, Quantity.STRAIN]

    def maps(self, quantity: Quantity) -> list[_Map]:
        """Return the maps of a quantity; raises FieldError for the height of one view."""
        if quantity is Quantity.DISPLACEMENT:
            return [_Map("displacement", np.linalg.norm(self.shift, axis=2), self.unit)]
        if quantity is Quantity.SIGMA:
            return [_Map("standard deviation", self.sigma, self.unit)]
        if quantity is Quantity.STRAIN:
            larger, smaller = self._principal_strains()
            return [
                _Map("larger principal strain", 100 * larger, "%", signed=True),
                _Map("smaller principal strain", 100 * smaller, "%", signed=True),
            ]
        if not self.in_space:
            raise FieldError("one view shows no height: record two views, with --stereo")
        return [_Map("height", self.shift @ self.plane()[1][2], self.unit, signed=True)]

    def _principal_strains(self) -> tuple[Array, Array]:
        rest = np.where(np.isnan(self.shift), np.nan, self.rest)
        first, second, shear = np.moveaxis(green_lagrange(rest, rest + self.shift), -1, 0)
        middle, half = (first + second) / 2, np.hypot((first - second) / 2, shear)
        return middle + half, middle - half


class Summary:
    """What the sheet of a series shows: its frame of the largest displacement, and two curves.

    rest: (R, C, 2 or 3) in `unit`. moment: that frame, None before the first one. index, time_ms,
    largest, median: of each frame, its number, its time, and the displacement of its nodes.
    """

    def __init__(self, rest: Array, unit: str) -> None:
        self._rest, self._unit = rest, unit
        self.moment: Moment | None = None
        self._most = 0.0
        self.index: list[int] = []
        self.time_ms: list[float] = []
        self.largest: list[float] = []
        self.median: list[float] = []

    def add(self, index: int, time_ms: float, shift: NDArray[Any], sigma: NDArray[Any]) -> None:
        """Add a frame: its number, its time, the displacement (R, C, 2 or 3), sigma (R, C)."""
        length = np.linalg.norm(shift.astype(np.float64), axis=2)
        known = length[~np.isnan(length)]
        largest = float(known.max()) if len(known) else np.nan
        if self.moment is None or largest > self._most:
            self._most = max(self._most, np.nan_to_num(largest))
            self.moment = Moment(
                rest=self._rest,
                shift=shift.astype(np.float64),
                sigma=sigma.astype(np.float64),
                unit=self._unit,
                index=index,
            )
        self.index.append(index)
        self.time_ms.append(time_ms)
        self.largest.append(largest)
        self.median.append(float(np.median(known)) if len(known) else np.nan)


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """A series of nodes, from the arrays that `cmp_cl.series.read_series` reads.

    rest: (R, C, 2) or (R, C, 3) in `unit`. shift: (F, R, C, 2 or 3). sigma: (F, R, C), NaN
    where the series has none. index, time_ms: (F,).
    """

    rest: Array
    shift: NDArray[Any]
    sigma: NDArray[Any]
    index: NDArray[np.int64]
    time_ms: Array
    unit: str

    @classmethod
    def of(cls, series: Series) -> "Recorded":
        """Take the arrays of a series; raises FieldError without frames, rest or positions."""
        missing = [name for name in ("index", "time_ms", "rest") if name not in series]
        if missing or not ("displacement" in series or "xy" in series):
            what = missing or ["displacement or xy"]
            raise FieldError(f"the series has no {' and no '.join(what)}")
        if not len(series["index"]):
            raise FieldError("the series has no frame")
        rest = np.asarray(series["rest"], np.float64)
        shift = series["displacement"] if "displacement" in series else series["xy"] - rest
        if shift.shape[1:] != rest.shape:
            raise FieldError(f"rest is {rest.shape} and the displacement {shift.shape}")
        return cls(
            rest=rest,
            shift=shift,
            sigma=series.get("sigma", np.broadcast_to(np.nan, shift.shape[:3])),
            index=np.asarray(series["index"], np.int64),
            time_ms=np.asarray(series["time_ms"], np.float64),
            unit=str(series.get("unit", "px")),
        )

    def summary(self) -> Summary:
        """Return the summary of all frames."""
        found = Summary(self.rest, self.unit)
        for each in zip(self.index, self.time_ms, self.shift, self.sigma, strict=True):
            found.add(*each)
        return found

    def moment(self, frame: int) -> Moment:
        """Return the frame at that place in the series."""
        return Moment(
            rest=self.rest,
            shift=self.shift[frame].astype(np.float64),
            sigma=self.sigma[frame].astype(np.float64),
            unit=self.unit,
            index=int(self.index[frame]),
        )

    def frame_of(self, index: int) -> int:
        """Return the place in the series of the frame of that number; raises FieldError."""
        found = np.flatnonzero(self.index == index)
        if not len(found):
            raise FieldError(
                f"there is no frame {index}: those from {self.index.min()} to {self.index.max()} "
                "are recorded"
            )
        return int(found[0])

    def node_of(self, node: tuple[int, int] | None) -> tuple[int, int]:
        """Return the node; None means that of the largest displacement. Raises FieldError."""
        shape = self.rest.shape[:2]
        if node is None:
            length = np.zeros(shape)
            for shift in self.shift:
                length = np.fmax(length, np.linalg.norm(shift, axis=2))
            row, column = np.unravel_index(int(np.argmax(length)), shape)
            return int(row), int(column)
        if not (0 <= node[0] < shape[0] and 0 <= node[1] < shape[1]):
            raise FieldError(f"there is no node {node}: the pattern has {shape[0]} x {shape[1]}")
        return node


def new_figure(size: tuple[float, float]) -> "Figure":
    """Return an empty figure of that size, inches; raises ConfigError without matplotlib."""
    with extra("plot", "A figure"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, layout="constrained")


# figures


def map_figure(moment: Moment, quantity: Quantity) -> "Figure":
    """Draw a quantity of every cell on the pattern at rest, with a colour bar in its unit.

    The value of a cell is the mean of its four nodes. Signed values have a scale that is white
    at 0. Raises FieldError, and ConfigError without matplotlib.
    """
    return _maps_figure(moment, quantity)[0]


def _maps_figure(
    moment: Moment, quantity: Quantity, top: float | None = None
) -> tuple["Figure", list["_Drawn"]]:
    maps = moment.maps(quantity)
    figure, places, _ = _page(1, len(maps), f"frame {moment.index}")
    axes = [figure.add_subplot(place) for place in places]
    return figure, _draw_maps(axes, moment, maps, top)


def curve_figure(recorded: Recorded, *, node: tuple[int, int] | None = None) -> "Figure":
    """Draw the displacement of a node over time, with a band of one standard deviation.

    node: (row, column); None means the one of the largest displacement. Raises FieldError, also
    with fewer than three frames; ConfigError without matplotlib.
    """
    if len(recorded.index) < _LEAST_OF_CURVE:
        raise FieldError(f"{len(recorded.index)} frames make no curve, {_LEAST_OF_CURVE} do")
    figure = new_figure((8.0, 4.5))
    axes = figure.add_subplot()
    row, column = recorded.node_of(node)
    time, label = _time_axis(recorded.index, recorded.time_ms)
    shift, sigma = recorded.shift[:, row, column], recorded.sigma[:, row, column]
    for part, name in enumerate("xyz"[: shift.shape[1]]):
        (line,) = axes.plot(time, shift[:, part], ".-", lw=1, ms=3, label=name)
        low, high = shift[:, part] - sigma, shift[:, part] + sigma
        axes.fill_between(time, low, high, color=line.get_color(), alpha=0.2, lw=0)
    _finish_curve(axes, label, recorded.unit, f"node in row {row}, column {column}")
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

    summary: of the series; without it, or with fewer than three frames, there are no curves.
    view: the image now, with its grid at rest and now, for arrows on it. rows: names and values of
    a table. With a table or a view there is no map of sigma.

    Raises FieldError if there are too few nodes for a map, ConfigError without matplotlib.
    """
    panels: list[Callable[[Any, Any], object]] = []
    if view is not None:
        panels.append(lambda figure, at: _draw_view(figure.add_subplot(at), *view))
    known = np.isfinite(moment.rest + moment.shift).all(axis=2)
    if moment.in_space and np.count_nonzero(known) > 2:
        panels.append(lambda figure, at: _draw_surface(figure, at, moment))
    left_out = {Quantity.SIGMA} if rows or view else set()
    left_out |= {Quantity.DISPLACEMENT} if view and moment.in_space else set()
    for quantity in moment.quantities():
        if quantity not in left_out:
            panels += [_panel(moment, quantity, n) for n in range(len(moment.maps(quantity)))]
    if rows:
        panels.append(lambda figure, at: _draw_table(figure.add_subplot(at), rows))
    with_curve = summary is not None and len(summary.index) >= _LEAST_OF_CURVE
    across = 3 if len(panels) % 2 or len(panels) > 4 else 2
    down = -(-len(panels) // across)
    figure, places, below = _page(down, across, title or f"frame {moment.index}", with_curve)
    for draw, place in zip(panels, places, strict=False):
        draw(figure, place)
    if with_curve:
        _draw_curves(figure.add_subplot(below), cast(Summary, summary), moment.unit)
    return figure


def _page(
    down: int, across: int, title: str, with_curve: bool = False
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


def _panel(moment: Moment, quantity: Quantity, number: int) -> Callable[[Any, Any], object]:
    """Return a function that draws one of the maps of a quantity, on the scale of all of them."""

    def draw(figure: Any, at: Any) -> None:
        maps = moment.maps(quantity)
        top = top_of(np.stack([each.cells for each in maps]))
        _Drawn(figure.add_subplot(at), moment, maps[number], top)

    return draw


def _draw_view(axes: "Axes", image: GreyImage, rest: Grid, now: Grid) -> None:
    draw_arrows(axes, image, rest, now)
    axes.set_title("moved since rest, in the image")


def _draw_surface(figure: "Figure", at: Any, moment: Moment) -> None:
    axes: Any = figure.add_subplot(at, projection="3d")
    draw_surface(axes, moment.rest, moment.shift, moment.unit)
    axes.set_title("surface")


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
    time, label = _time_axis(np.array(summary.index), np.array(summary.time_ms))
    axes.plot(time, summary.largest, ".-", lw=1, ms=3, label="largest of all nodes")
    axes.plot(time, summary.median, ".-", lw=1, ms=3, label="median of all nodes")
    axes.set_ylim(bottom=0)
    _finish_curve(axes, label, unit, "displacement over time")


def _time_axis(index: NDArray[Any], time_ms: Array) -> tuple[Array, str]:
    """Return the times in s if all are known, else the numbers of the frames; and the label."""
    if np.isfinite(time_ms).all():
        return time_ms / 1e3, "time / s"
    return index.astype(np.float64), "frame"


def _finish_curve(axes: "Axes", label: str, unit: str, title: str) -> None:
    axes.set(xlabel=label, ylabel=f"displacement / {unit}", title=title)
    axes.grid(alpha=0.3)
    axes.legend()


def _draw_maps(
    axes: Sequence["Axes"], moment: Moment, maps: list[_Map], top: float | None = None
) -> list["_Drawn"]:
    """Draw maps on one scale; top: its end, None for the largest value."""
    top = top_of(np.stack([each.cells for each in maps])) if top is None else top
    return [_Drawn(each, moment, shown, top) for each, shown in zip(axes, maps, strict=True)]


class _Drawn:
    """A map drawn into axes, whose values can change. top: the end of its scale."""

    def __init__(self, axes: "Axes", moment: Moment, shown: _Map, top: float) -> None:
        from matplotlib.collections import PolyCollection

        self._axes = axes
        nodes, self._directions = moment.plane()
        cells = np.stack(corners_of_cells(nodes), axis=2)
        self._whole = ~np.isnan(cells).any(axis=(2, 3))
        self._cells: PolyCollection = PolyCollection(
            list(cells[self._whole]),
            cmap=DIVERGING if shown.signed else SEQUENTIAL,
            edgecolors="face",
            linewidths=0.2,
        )
        self._cells.set_clim(-top if shown.signed else 0.0, top)
        axes.add_collection(self._cells)
        self._nodes = nodes
        self._arrows: Any = None
        self._length = top
        points = nodes[~np.isnan(nodes[..., 0])]
        low, high = points.min(axis=0), points.max(axis=0)
        edge = 0.03 * float((high - low).max() or 1.0)
        names = ("along rows", "along columns") if moment.in_space else ("x", "y")
        axes.set(
            xlim=(low[0] - edge, high[0] + edge),
            ylim=(high[1] + edge, low[1] - edge),
            aspect="equal",
            facecolor="0.9",
            xlabel=f"{names[0]} / {moment.unit}",
            ylabel=f"{names[1]} / {moment.unit}",
        )
        label = f"{shown.title} / {shown.unit}"
        colour_bar(axes, self._cells, label)
        self.show(moment, shown)

    def show(self, moment: Moment, shown: _Map) -> None:
        """Show the values of a frame."""
        mean = shown.cells[self._whole]
        self._cells.set_array(np.ma.masked_invalid(mean))
        unknown = "" if np.isfinite(mean).any() else ": no cell has a value"
        enlarged = ""
        if shown.title == "displacement":
            enlarged = f", arrows {self._draw_arrows(moment):.2g} x"
        self._axes.set_title(f"{shown.title}{enlarged}{unknown}")

    def _draw_arrows(self, moment: Moment) -> float:
        """Draw some arrows, enlarged so that the longest is two of their distances long; return
        the factor."""
        shift = moment.shift @ self._directions[: moment.shift.shape[2], : moment.shift.shape[2]].T
        some = spread(~np.isnan(shift[..., 0]) & ~np.isnan(self._nodes[..., 0]), _ARROWS)
        if self._arrows is not None:
            self._arrows.remove()
        step = np.nanmax(np.ptp(self._nodes[~np.isnan(self._nodes[..., 0])], axis=0)) / _ARROWS
        self._arrows = self._axes.quiver(
            *self._nodes[some].T, *shift[some][:, :2].T,
            angles="xy", scale_units="xy", scale=self._length / (2 * step),
            color="white", edgecolor="black", linewidth=0.3, width=4e-3,
        )  # fmt: skip
        return float(2 * step / self._length)


# animations


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

    tops = []
    for place in places:
        values = np.stack([each.cells for each in recorded.moment(place).maps(quantity)])
        tops.append(float(np.nan_to_num(np.abs(values)).max(initial=0)))
    figure, drawn = _maps_figure(recorded.moment(places[0]), quantity, top_of(np.array(tops)))
    canvas: Any = FigureCanvasAgg(figure)
    for place in places:
        moment = recorded.moment(place)
        for each, shown in zip(drawn, moment.maps(quantity), strict=True):
            each.show(moment, shown)
        figure.texts[0].set_text(f"frame {moment.index}")
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
