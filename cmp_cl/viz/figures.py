"""Figures of arrows and surfaces."""

from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind, check_range
from cmp_cl.field import DisplacementField
from cmp_cl.files import whole_file
from cmp_cl.grid.grid import Grid
from cmp_cl.image import GreyImage, check_image

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

SEQUENTIAL, DIVERGING = "plasma", "RdBu_r"  # the colours of amounts, and of signed values
_ROUNDING = 1e-12  # smaller values, such as the strain of the frame at rest, are errors of rounding
_ARROWS = 26  # along the longer side of a pattern; more hide what is below
_ARROWS_IN_SPACE = 14
_SHORTEST_ARROW = 0.05  # of the longest one; shorter ones are dots on the surface
_NARROWEST = 1e-5  # width of a surface over its length; a narrower one is a line


def arrow_figure(
    image: GreyImage, rest: Grid, now: Grid, *, field: DisplacementField | None = None
) -> "Figure":
    """Draw arrows from the positions of nodes at rest to their positions now, to scale, px.

    image: (H, W), the frame now. The colour is the arrow's length in px, or, with `field`, the
    length of the displacement in space. It needs matplotlib. `save_figure` writes the figure.

    Raises FieldError if the grids or the field have different shapes, ImageError.
    """
    from matplotlib.figure import Figure

    rows, columns = check_image(image).shape
    figure = Figure(figsize=(9, max(7.2 * rows / max(columns, 1), 2) + 0.7), layout="constrained")
    draw_arrows(figure.add_subplot(), image, rest, now, field=field)
    return figure


def draw_arrows(
    axes: "Axes", image: GreyImage, rest: Grid, now: Grid, *, field: DisplacementField | None = None
) -> None:
    """Draw the content of `arrow_figure` into axes."""
    image = check_image(image)
    check_kind("rest", rest, Grid, FieldError)
    check_kind("now", now, Grid, FieldError)
    if field is not None:
        check_kind("field", field, DisplacementField, FieldError)
    if rest.shape != now.shape or (field is not None and field.status.shape != now.shape):
        shapes = [rest.shape, now.shape, *([] if field is None else [field.status.shape])]
        raise FieldError(f"rest, now and field must have one shape, not {shapes}")
    shift = (now.xy - rest.xy).astype(np.float64)
    length, unit = np.linalg.norm(shift, axis=2), "px"
    if field is not None:
        length, unit = np.linalg.norm(field.displacement, axis=2), field.unit
    seen = ~np.isnan(shift).any(axis=2) & ~np.isnan(length)

    rows, columns = image.shape
    axes.imshow(image, cmap="gray", interpolation="nearest", alpha=0.7)
    some = spread(seen, _ARROWS)
    arrows = axes.quiver(
        *rest.xy[some].T, *shift[some].T, length[some],
        angles="xy", scale_units="xy", scale=1, width=4e-3, cmap=SEQUENTIAL,
        clim=(0, top_of(length[seen])),
    )  # fmt: skip
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), xlabel="x / px", ylabel="y / px")
    colour_bar(axes, arrows, f"displacement / {unit}")


def surface_figure(field: DisplacementField) -> "Figure":
    """Draw the surface of a field now, coloured by displacement, with some arrows from rest.

    The axes run along the rows, along the columns, and towards the cameras out of the plane that
    fits the positions at rest best. The height is stretched to a fifth of the width; the label
    gives the factor. It needs matplotlib.

    Raises FieldError if fewer than three nodes are valid, or all lie on a line.
    """
    from matplotlib.figure import Figure

    check_kind("field", field, DisplacementField, FieldError)
    if field.position.shape[2] != 3:
        raise FieldError("the field of one view has no surface: measure two views")
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes: Axes3D = figure.add_subplot(projection="3d")
    draw_surface(axes, field.position, field.displacement, field.unit)
    return figure


def draw_surface(
    axes: "Axes3D", rest: NDArray[np.float64], shift: NDArray[np.float64], unit: str
) -> None:
    """Draw the content of `surface_figure` into 3-D axes; rest, shift: (R, C, 3) in `unit`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    directions, origin = plane_of(np.where(np.isnan(shift), np.nan, rest))
    rest = (rest - origin) @ directions.T
    shift = shift @ directions.T
    now = rest + shift
    valid = ~np.isnan(now[..., 0])
    length = np.linalg.norm(shift, axis=2)
    colours = ScalarMappable(Normalize(0, top_of(length)), SEQUENTIAL)

    cells = np.stack(corners_of_cells(now), axis=2)
    whole = ~np.isnan(cells).any(axis=(2, 3))
    faces = colours.to_rgba(np.mean(corners_of_cells(length), axis=0)[whole])
    axes.computed_zorder = False  # the arrows are drawn after the surface
    axes.add_collection3d(
        Poly3DCollection(cells[whole], facecolors=faces, edgecolors=faces, linewidths=0.2, zorder=1)
    )
    some = spread(valid, _ARROWS_IN_SPACE) & (length > _SHORTEST_ARROW * top_of(length))
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
        xlabel=f"along rows / {unit}",
        ylabel=f"along columns / {unit}",
        zlabel=f"height / {unit} (x {stretch:.2g})",
    )
    axes.zaxis.set_major_locator(MaxNLocator(3))
    axes.set_box_aspect(span * [1, 1, stretch], zoom=1.0)
    axes.view_init(elev=32, azim=-60)
    beside = axes.inset_axes((0.2, 0.0, 0.6, 0.035))
    label = f"displacement / {unit}"
    axes.figure.colorbar(colours, cax=beside, label=label, orientation="horizontal")


def colour_bar(axes: "Axes", drawn: Any, label: str) -> None:
    """Draw a colour bar beside axes."""
    beside = axes.inset_axes((1.03, 0.05, 0.04, 0.9))
    axes.figure.colorbar(drawn, cax=beside, label=label)


def spread(valid: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Return (R, C), True at valid nodes of which at most about `most` lie along a side."""
    step = -(-max(valid.shape) // most)
    some = np.zeros_like(valid)
    some[step // 2 :: step, step // 2 :: step] = True
    return some & valid


def top_of(values: NDArray[np.floating[Any]]) -> float:
    """Return the upper end of a colour scale: the largest size of a known value."""
    top = float(np.nan_to_num(np.abs(values)).max(initial=0))
    return top if top > _ROUNDING else 1.0


def plane_of(rest: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane to positions (R, C, 3), NaN where missing: (3, 3) axes as rows, (3,) origin.

    The first axis runs along the rows, the second along the columns, the third towards the
    cameras (a left-handed frame, as on a picture with y down and height towards the viewer).

    Raises FieldError if fewer than three nodes are valid, or all lie on a line.
    """
    valid = ~np.isnan(rest[..., 0])
    points = rest[valid]
    if len(points) < 3:
        raise FieldError(f"{len(points)} nodes are valid, at least 3 are needed to draw a surface")
    origin = points.mean(axis=0)
    _, spread, directions = np.linalg.svd(points - origin, full_matrices=False)
    if spread[1] < _NARROWEST * spread[0] or not spread[0]:
        raise FieldError("all valid nodes lie on a line: they make no surface")
    normal = directions[2] if directions[2] @ origin < 0 else -directions[2]
    row, column = np.nonzero(valid)
    slopes = np.linalg.lstsq(
        np.column_stack([column, row, np.ones(len(row))]), points - origin, rcond=None
    )[0]
    along = slopes[0] if slopes[0].any() else directions[0]
    along = along - (along @ normal) * normal
    along = along / np.linalg.norm(along)
    across = np.cross(normal, along)
    if across @ slopes[1] < 0:
        across = -across
    return np.stack([along, across, normal]), origin


def corners_of_cells(values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the values (R, C, ...) at the four nodes of each cell, (R - 1, C - 1, ...) each."""
    return [values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]]


def save_figure(path: str | PathLike[str], figure: "Figure", *, dpi: int = 120) -> None:
    """Write a figure as PNG, whole or not at all.

    figure: of matplotlib. dpi: pixels per inch, 10 to 10 000. Raises FieldError if figure is of
    another type, ConfigError for another dpi, OSError.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    check_kind("figure", figure, Figure, FieldError)
    check_range("dpi", dpi, 10, 10_000)
    FigureCanvasAgg(figure)
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=dpi)
