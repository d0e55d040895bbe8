"""Pictures of a series: maps of a quantity at one frame, and curves over time."""

import dataclasses
import enum
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.extras import extra
from cmp_cl.field import green_lagrange
from cmp_cl.viz.figures import corners_of_cells, plane_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Series = Mapping[str, NDArray[Any]]

_SEQUENTIAL, _DIVERGING = "plasma", "RdBu_r"
_ROUNDING = 1e-12  # smaller values, such as the strain of the frame at rest, are errors of rounding


class Quantity(enum.Enum):
    """The quantity of a node that a map shows.

    DISPLACEMENT: its length. STRAIN: the larger principal Green-Lagrange strain in the plane or in
    the surface. HEIGHT: the displacement towards the cameras, out of the plane that fits the rest
    positions best; two views only. SIGMA: the standard deviation of the displacement (two views) or
    of the position now (one view).
    """

    DISPLACEMENT = "displacement"
    STRAIN = "strain"
    HEIGHT = "height"
    SIGMA = "sigma"


@dataclasses.dataclass(frozen=True, eq=False)
class Recorded:
    """A series, as `cmp_cl.series.read_series` reads it, after checks.

    rest: (R, C, 2) or (R, C, 3) in `unit`. shift: (F, R, C, 2 or 3). sigma: (F, R, C), NaN
    where the series has none. index, time_ms: (F,).
    """

    rest: Array
    shift: Array
    sigma: Array
    index: NDArray[np.int64]
    time_ms: Array
    unit: str

    @classmethod
    def of(cls, series: Series) -> "Recorded":
        """Take the arrays of a series; raises FieldError without frames, rest or positions."""
        if not len(series.get("index", [0])):
            raise FieldError("the series has no frame")
        missing = [name for name in ("index", "time_ms", "rest") if name not in series]
        if missing or not ("displacement" in series or "xy" in series):
            what = missing or ["displacement or xy"]
            raise FieldError(f"the series has no {' and no '.join(what)}")
        rest = np.asarray(series["rest"], np.float64)
        if "displacement" in series:
            shift = np.asarray(series["displacement"], np.float64)
        else:
            shift = np.asarray(series["xy"], np.float64) - rest
        if rest.ndim != 3 or shift.shape[1:] != rest.shape or rest.shape[2] not in (2, 3):
            raise FieldError(f"rest is {rest.shape} and the displacement {shift.shape}")
        sigma = np.asarray(series.get("sigma", np.full(shift.shape[:3], np.nan)), np.float64)
        return cls(
            rest=rest,
            shift=shift,
            sigma=sigma,
            index=np.asarray(series["index"], np.int64),
            time_ms=np.asarray(series["time_ms"], np.float64),
            unit=str(series.get("unit", "px")),
        )

    def frame_of(self, index: int | None) -> int:
        """Return the position in the series of the frame of that number.

        None means the frame of the largest displacement.

        Raises FieldError if there is no such frame.
        """
        if index is None:
            length = np.linalg.norm(self.shift, axis=3).reshape(len(self.index), -1)
            return int(np.argmax(np.nan_to_num(length).max(axis=1)))
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
            length = np.nan_to_num(np.linalg.norm(self.shift, axis=3)).max(axis=0)
            row, column = np.unravel_index(int(np.argmax(length)), shape)
            return int(row), int(column)
        if not (0 <= node[0] < shape[0] and 0 <= node[1] < shape[1]):
            raise FieldError(f"there is no node {node}: the pattern has {shape[0]} x {shape[1]}")
        return node

    def plane(self) -> tuple[Array, Array]:
        """Return the positions at rest (R, C, 2) to draw on, and (3, 3) axes of that plane.

        Raises FieldError if fewer than three nodes are valid, or all lie on a line.
        """
        if self.rest.shape[2] == 2:
            return self.rest, np.eye(3)
        axes, origin = plane_of(self.rest)
        return ((self.rest - origin) @ axes.T)[..., :2], axes

    def values(self, quantity: Quantity, frame: int) -> tuple[Array, str]:
        """Return a quantity of each node (R, C) of the frame at that index, and its unit."""
        shift = self.shift[frame]
        if quantity is Quantity.DISPLACEMENT:
            return np.linalg.norm(shift, axis=2), self.unit
        if quantity is Quantity.SIGMA:
            return self.sigma[frame], self.unit
        if quantity is Quantity.STRAIN:
            return self._strain(shift), "1"
        if self.rest.shape[2] == 2:
            raise FieldError("one view shows no height: record two views, with --stereo")
        return shift @ self.plane()[1][2], self.unit

    def _strain(self, shift: Array) -> Array:
        both = np.where(np.isnan(shift), np.nan, self.rest)
        first, second, shear = np.moveaxis(green_lagrange(both, both + shift), -1, 0)
        larger: Array = (first + second) / 2 + np.hypot((first - second) / 2, shear)
        return larger


def map_figure(recorded: Recorded, quantity: Quantity, *, index: int | None = None) -> "Figure":
    """Draw a quantity of every cell on the pattern at rest, with a colour bar in its unit.

    index: number of the frame; None means the one of the largest displacement. The value of a cell
    is the mean of its four nodes. It raises FieldError, and ConfigError without matplotlib.
    """
    figure = new_figure((7.5, 6.0))
    draw_map(figure, figure.add_subplot(), recorded, quantity, recorded.frame_of(index))
    return figure


def curve_figure(recorded: Recorded, *, node: tuple[int, int] | None = None) -> "Figure":
    """Draw the displacement of a node over time, with a band of one standard deviation.

    node: (row, column); None means the one of the largest displacement. Raises FieldError,
    ConfigError without matplotlib.
    """
    figure = new_figure((8.0, 4.5))
    _draw_curve(figure.add_subplot(), recorded, recorded.node_of(node))
    return figure


def sheet_figure(
    recorded: Recorded, *, index: int | None = None, node: tuple[int, int] | None = None
) -> "Figure":
    """Draw the series on one sheet: the maps of a frame and the curve of a node.

    index, node: as in `map_figure` and `curve_figure`. Raises FieldError, and ConfigError without
    matplotlib.
    """
    frame = recorded.frame_of(index)
    wanted = [Quantity.DISPLACEMENT, Quantity.STRAIN]
    wanted += [Quantity.HEIGHT] if recorded.rest.shape[2] == 3 else []
    wanted += [Quantity.SIGMA] if np.isfinite(recorded.sigma[frame]).any() else []
    rows = -(-len(wanted) // 2) + 1
    figure = new_figure((12.0, 4.6 * rows))
    grid = figure.add_gridspec(rows, 2)
    for number, quantity in enumerate(wanted):
        axes = figure.add_subplot(grid[number // 2, number % 2])
        draw_map(figure, axes, recorded, quantity, frame)
    _draw_curve(figure.add_subplot(grid[rows - 1, :]), recorded, recorded.node_of(node))
    return figure


def new_figure(size: tuple[float, float]) -> "Figure":
    """Return an empty figure of that size, inches; raises ConfigError without matplotlib."""
    with extra("plot", "A figure"):
        from matplotlib.figure import Figure
    return Figure(figsize=size, layout="constrained")


def draw_map(
    figure: "Figure", axes: "Axes", recorded: Recorded, quantity: Quantity, frame: int
) -> None:
    """Draw the content of `map_figure` into axes; frame: its index in the series."""
    from matplotlib.collections import PolyCollection

    values, unit = recorded.values(quantity, frame)
    nodes, _ = recorded.plane()
    cells = np.stack(corners_of_cells(nodes), axis=2)
    mean = np.mean(corners_of_cells(values), axis=0)
    known = ~(np.isnan(cells).any(axis=(2, 3)) | np.isnan(mean))
    signed = quantity in (Quantity.STRAIN, Quantity.HEIGHT)
    drawn = PolyCollection(
        list(cells[known]),
        array=mean[known],
        cmap=_DIVERGING if signed else _SEQUENTIAL,
        edgecolors="face",
        linewidths=0.2,
    )
    top = float(np.abs(mean[known]).max(initial=0))
    top = top if top > _ROUNDING else 1.0
    drawn.set_clim(-top if signed else 0.0, top)
    axes.add_collection(drawn)
    points = nodes[~np.isnan(nodes[..., 0])]
    low, high = points.min(axis=0), points.max(axis=0)
    edge = 0.03 * float((high - low).max() or 1.0)
    names = ("x", "y") if recorded.rest.shape[2] == 2 else ("along rows", "along columns")
    axes.set(
        xlim=(low[0] - edge, high[0] + edge),
        ylim=(high[1] + edge, low[1] - edge),
        aspect="equal",
        facecolor="0.9",
        xlabel=f"{names[0]} / {recorded.unit}",
        ylabel=f"{names[1]} / {recorded.unit}",
        title=f"{_TITLES[quantity]}, frame {recorded.index[frame]}"
        + ("" if known.any() else ": no cell has a value"),
    )
    label = _TITLES[quantity] if unit == "1" else f"{_TITLES[quantity]} / {unit}"
    figure.colorbar(drawn, ax=axes, label=label, shrink=0.85)


_TITLES = {
    Quantity.DISPLACEMENT: "displacement",
    Quantity.STRAIN: "larger principal strain",
    Quantity.HEIGHT: "height",
    Quantity.SIGMA: "standard deviation",
}


def _draw_curve(axes: "Axes", recorded: Recorded, node: tuple[int, int]) -> None:
    known = np.isfinite(recorded.time_ms).all()
    time = recorded.time_ms / 1e3 if known else recorded.index.astype(np.float64)
    shift, sigma = recorded.shift[:, *node], recorded.sigma[:, *node]
    for part, name in enumerate("xyz"[: shift.shape[1]]):
        (line,) = axes.plot(time, shift[:, part], ".-", lw=1, ms=3, label=name)
        low, high = shift[:, part] - sigma, shift[:, part] + sigma
        axes.fill_between(time, low, high, color=line.get_color(), alpha=0.2, lw=0)
    axes.set(
        xlabel="time / s" if known else "frame",
        ylabel=f"displacement / {recorded.unit}",
        title=f"node in row {node[0]}, column {node[1]}",
    )
    axes.grid(alpha=0.3)
    axes.legend()
