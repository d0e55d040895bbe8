"""Figures of arrows and surfaces."""

import enum
from os import PathLike
from typing import TYPE_CHECKING

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

_NARROWEST = 1e-5  # width of a surface over its length; a narrower one is a line


def arrow_figure(
    image: GreyImage, rest: Grid, now: Grid, *, field: DisplacementField | None = None
) -> "Figure":
    """Draw arrows from the position of each node at rest to its position now, to scale, px.

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
    axes.imshow(image, cmap="gray", interpolation="nearest", alpha=0.6)
    arrows = axes.quiver(
        *rest.xy[seen].T,
        *shift[seen].T,
        length[seen],
        angles="xy",
        scale_units="xy",
        scale=1,
        width=2.5e-3,
        cmap="plasma",
        clim=(0, _top(length[seen])),
    )
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), xlabel="x / px", ylabel="y / px")
    axes.figure.colorbar(arrows, ax=axes, label=f"displacement / {unit}", shrink=0.8)


def _top(lengths: NDArray[np.float64]) -> float:
    """Return the upper end of a colour scale."""
    return float(lengths.max(initial=0)) or 1.0


class Projection(enum.Enum):
    """The projection in which a surface is drawn."""

    PERSPECTIVE = "persp"
    ORTHOGRAPHIC = "ortho"


def surface_figure(
    field: DisplacementField, *, projection: Projection = Projection.PERSPECTIVE
) -> "Figure":
    """Draw the surface of a field now, coloured by displacement, with arrows from the positions at
        rest.

    projection: a perspective or an orthographic one.

    The axes run along the rows, along the columns, and towards the cameras out of the plane that
    fits the positions at rest best. The height is stretched to a fifth of the width; the label
    gives the factor. It needs matplotlib.

    Raises FieldError if fewer than three nodes are valid.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 6), layout="constrained")
    axes: Axes3D = figure.add_subplot(  # a surface and its arrows are drawn in that order
        projection="3d", proj_type=projection.value, computed_zorder=False
    )
    draw_surface(axes, field)
    return figure


def draw_surface(axes: "Axes3D", field: DisplacementField) -> None:
    """Draw the content of `surface_figure` into 3-D axes."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes_of_plane, origin = rest_plane(field)
    rest = (field.position - origin) @ axes_of_plane.T
    shift = field.displacement @ axes_of_plane.T
    now = rest + shift
    length = np.linalg.norm(shift, axis=2)
    colours = ScalarMappable(Normalize(0, _top(length[field.valid])), "plasma")

    cells = np.stack(corners_of_cells(now), axis=2)
    whole = ~np.isnan(cells).any(axis=(2, 3))
    faces = colours.to_rgba(np.mean(corners_of_cells(length), axis=0)[whole])
    axes.add_collection3d(
        Poly3DCollection(
            cells[whole], facecolors=faces, edgecolors=(0, 0, 0, 0.3), linewidths=0.3, zorder=1
        )
    )
    step = max(1, round(max(field.status.shape) / 22))
    some = np.zeros_like(field.valid)
    some[::step, ::step] = field.valid[::step, ::step]
    axes.quiver(
        *rest[some].T,
        *shift[some].T,
        color="black",
        linewidths=0.8,
        arrow_length_ratio=0.3,
        zorder=2,
    )
    points = np.concatenate([rest[field.valid], now[field.valid]])
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-3 * (high - low).max())
    low, high = (low + high - span) / 2, (low + high + span) / 2
    stretch = max(1.0, 0.2 * float(span[:2].max() / span[2]))
    axes.set(
        xlim=(low[0], high[0]),
        ylim=(high[1], low[1]),
        zlim=(low[2], high[2]),
        xlabel=f"along rows / {field.unit}",
        ylabel=f"along columns / {field.unit}",
        zlabel=f"towards cameras / {field.unit} (stretched {stretch:.2g} x)",
    )
    axes.zaxis.set_major_locator(MaxNLocator(4))
    axes.set_box_aspect(span * [1, 1, stretch], zoom=0.95)
    axes.view_init(elev=32, azim=-60)
    label = f"displacement / {field.unit}"
    axes.figure.colorbar(colours, ax=axes, label=label, shrink=0.6, pad=0.12)


def rest_plane(field: DisplacementField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane to the positions of a field at rest: (3, 3) axes as rows, (3,) origin.

    The first axis runs along the rows, the second along the columns, the third towards the
    cameras (a left-handed frame, as on a picture with y down and height towards the viewer).

    Raises FieldError if fewer than three nodes are valid, or all lie on a line.
    """
    check_kind("field", field, DisplacementField, FieldError)
    return plane_of(field.position)


def plane_of(rest: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane to positions (R, C, 3), NaN where missing; see `rest_plane`."""
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
