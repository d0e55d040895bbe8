"""Overlays on images, figures, and a log for Rerun."""

import enum
import math
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.corners import Corners, Method
from cmp_cl.errors import FieldError
from cmp_cl.field import DisplacementField, mesh
from cmp_cl.files import whole_file
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage, check_image
from cmp_cl.viz.piped import PipedFile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

Colour = tuple[int, int, int]  # BGR

METHOD_COLOURS = {
    Method.CENTROID: (0, 215, 255),
    Method.EDGE_LINES: (60, 230, 60),
    Method.EDGE_STEP: (255, 200, 0),
    Method.MIDLINE: (255, 80, 255),
    Method.CUSP: (0, 140, 255),
    Method.KEPT: (60, 60, 255),
}
STATUS_COLOURS = {
    NodeStatus.MISSING: (128, 128, 128),
    NodeStatus.DETECTED: (60, 230, 60),
    NodeStatus.ATTACHED: (255, 200, 0),
    NodeStatus.SECOND_LOOK: (0, 215, 255),
    NodeStatus.INTERPOLATED: (255, 80, 255),
    NodeStatus.VIRTUAL: (255, 255, 255),
}
JPEG_QUALITY = 80  # JPEG quality of the images in a recording
_OFF_GRID = (150, 150, 190)  # of corners off the grid
_NARROWEST = 1e-5  # width of a surface over its length; a narrower one is a line
_FRACTION_BITS = 4


def corner_overlay(image: GreyImage, corners: Corners) -> NDArray[np.uint8]:
    """Draw a mark on each of the corners, coloured by its method, and a legend.

    image: (H, W) uint8 or uint16. Returns (H', W', 3) uint8 BGR. The image is enlarged by a whole
    factor, each pixel to a block, until a cell is about 32 px wide and the longer side at least
    1000 px; the result is at most 2400 px long unless the image is longer. The legend is below the
    image. A circle surrounds each corner and a dot marks its position. Raises ImageError.
    """
    check_image(image)
    cell = _spacing(corners.xy)
    canvas, factor = _enlarged(image, cell)
    radius = min(max(3.0, 0.3 * cell * factor), 24.0)
    for xy, method in zip(corners.xy, corners.method, strict=True):
        centre = (np.asarray(xy, np.float64) + 0.5) * factor - 0.5
        colour = METHOD_COLOURS[Method(method)]
        _circle(canvas, centre, radius, colour, thickness=1)
        _circle(canvas, centre, max(1.0, radius / 8), colour, thickness=cv2.FILLED)
    head = (f"{len(corners)} corners", (255, 255, 255))
    return _with_strip(canvas, [head, *_counted(corners.method, METHOD_COLOURS)])


def _spacing(xy: NDArray[np.float32]) -> float:
    """Return the median distance to the nearest other corner, px; 16 with fewer than two."""
    if len(xy) < 2:
        return 16.0
    some = xy[:: max(1, len(xy) // 256)].astype(np.float64)
    distance = np.hypot(*(some[:, None] - xy[None]).transpose(2, 0, 1))
    distance[distance == 0] = np.inf
    nearest = distance.min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    return float(np.median(nearest)) if len(nearest) else 16.0


def _enlarged(image: GreyImage, cell: float) -> tuple[NDArray[np.uint8], int]:
    """Return the image in BGR, enlarged as `corner_overlay` says, and the factor."""
    longest = max(*image.shape, 1)
    factor = max(1, min(max(round(32 / cell), math.ceil(1000 / longest)), 2400 // longest))
    grey = image
    if image.dtype != np.uint8:
        white = max(int(image.max()), 1) if image.size else 1
        grey = (image.astype(np.float32) * (255 / white)).round().astype(np.uint8)
    blocks = grey.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(blocks[:, :, None], 3, axis=2), factor


def _circle(
    canvas: NDArray[np.uint8],
    centre: NDArray[np.float64],
    radius: float,
    colour: Colour,
    *,
    thickness: int,
) -> None:
    unit = 1 << _FRACTION_BITS
    cv2.circle(
        canvas,
        (round(centre[0] * unit), round(centre[1] * unit)),
        round(radius * unit),
        colour,
        thickness,
        cv2.LINE_AA,
        _FRACTION_BITS,
    )


def _counted(
    kinds: NDArray[np.uint8], colours: Mapping[Method, Colour] | Mapping[NodeStatus, Colour]
) -> list[tuple[str, Colour]]:
    """Return a word for each kind that occurs, with its count and its colour."""
    count = np.bincount(kinds.ravel(), minlength=len(colours))
    return [(f"{kind.name} {count[kind]}", bgr) for kind, bgr in colours.items() if count[kind]]


def _with_strip(canvas: NDArray[np.uint8], entries: list[tuple[str, Colour]]) -> NDArray[np.uint8]:
    """Add a strip with coloured words below the picture."""
    font, size, gap = cv2.FONT_HERSHEY_SIMPLEX, 0.6, 24
    widths = [cv2.getTextSize(text, font, size, 1)[0][0] for text, _ in entries]
    width = max(canvas.shape[1], sum(widths) + gap * (len(entries) + 1))
    picture = np.zeros((canvas.shape[0] + 36, width, 3), np.uint8)
    picture[: canvas.shape[0], : canvas.shape[1]] = canvas
    x = gap
    for (text, colour), advance in zip(entries, widths, strict=True):
        origin = (x, canvas.shape[0] + 24)
        cv2.putText(picture, text, origin, font, size, colour, 1, cv2.LINE_8)
        x += advance + gap
    return picture


def grid_overlay(
    image: GreyImage, grid: Grid, *, corners: Corners | None = None
) -> NDArray[np.uint8]:
    """Draw the lines of the grid, a dot on every node by status, and a legend.

    image: (H, W) uint8 or uint16. corners: those that the grid was built from. Corners off the grid
    are drawn as faint rings. Returns (H', W', 3) uint8 BGR, enlarged like `corner_overlay`. The
    first row is drawn in red and the first column in blue. Raises ImageError, and FieldError if
    there are not as many corners as the grid was built from.
    """
    check_image(image)
    if corners is not None and len(corners) != len(grid.index):
        raise FieldError(f"the grid was built from {len(grid.index)} corners, not {len(corners)}")
    xy = grid.xy[grid.valid]
    cell = _spacing(xy)
    canvas, factor = _enlarged(image, cell)
    nodes = (grid.xy.astype(np.float64) + 0.5) * factor - 0.5
    for along_row, lines in ((True, nodes), (False, nodes.transpose(1, 0, 2))):
        for number, line in enumerate(lines):
            colour = (220, 160, 60)
            if number == 0:
                colour = (60, 60, 255) if along_row else (255, 80, 40)
            _polyline(canvas, line, colour)
    radius = min(max(2.0, 0.1 * cell * factor), 8.0)
    off = np.empty((0, 2)) if corners is None else corners.xy[grid.index[:, 0] < 0]
    for centre in (off.astype(np.float64) + 0.5) * factor - 0.5:
        _circle(canvas, centre, 1.5 * radius, _OFF_GRID, thickness=1)
    for centre, status in zip(nodes[grid.valid], grid.status[grid.valid], strict=True):
        _circle(canvas, centre, radius, STATUS_COLOURS[NodeStatus(status)], thickness=cv2.FILLED)
    entries = [(f"{grid.shape[0]} x {grid.shape[1]} nodes", (255, 255, 255))]
    entries += _counted(grid.status, STATUS_COLOURS)
    if len(off):
        entries.append((f"off the grid {len(off)}", _OFF_GRID))
    return _with_strip(canvas, entries)


def _polyline(canvas: NDArray[np.uint8], line: NDArray[np.float64], colour: Colour) -> None:
    """Draw the segments between successive points, (N, 2) px; none at a NaN."""
    unit = 1 << _FRACTION_BITS
    segments = np.stack([line[:-1], line[1:]], axis=1)
    segments = segments[~np.isnan(segments).any(axis=(1, 2))]
    fixed = np.rint(segments * unit).astype(np.int32)
    cv2.polylines(canvas, list(fixed), False, colour, 1, cv2.LINE_AA, _FRACTION_BITS)


def arrow_figure(
    image: GreyImage, rest: Grid, now: Grid, *, field: DisplacementField | None = None
) -> "Figure":
    """Draw arrows from the position of each node at rest to its position now, to scale, px.

    image: (H, W), the frame now. The colour is the arrow's length in px, or, with `field`, the
    length of the displacement in space. It needs matplotlib. `save_figure` writes the figure.

    Raises FieldError if the grids or the field have different shapes, ImageError.
    """
    from matplotlib.figure import Figure

    rows, columns = image.shape
    figure = Figure(figsize=(9, max(7.2 * rows / columns, 2) + 0.7), layout="constrained")
    draw_arrows(figure.add_subplot(), image, rest, now, field=field)
    return figure


def draw_arrows(
    axes: "Axes", image: GreyImage, rest: Grid, now: Grid, *, field: DisplacementField | None = None
) -> None:
    """Draw the content of `arrow_figure` into axes."""
    check_image(image)
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
    """Write a figure as PNG, whole or not at all; dpi: pixels per inch; raises OSError."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    with whole_file(path) as file:
        figure.savefig(file, format="png", dpi=dpi)


class RerunLog(Closing):
    """Shows frames in Rerun's viewer, or records them to a .rrd file for it.

    path: the file; None opens the viewer. It needs rerun-sdk 0.23 or newer. The file appears when
    the `with` block ends, even by an exception or Ctrl-C.

    Raises ImportError without rerun-sdk, RuntimeError if its viewer is not found on the
    PATH, OSError if the file cannot be written.
    """

    def __init__(self, path: str | PathLike[str] | None = None) -> None:
        import rerun

        self._rerun = rerun
        self._stream = rerun.RecordingStream("cmp_cl")
        self._file: PipedFile | None = None
        self._top = 0.0
        if path is None:
            self._stream.spawn()
        else:
            self._file = PipedFile(path, self._stream.save)

    def frame(
        self,
        *,
        index: int,
        time_ms: float,
        image: GreyImage | None = None,
        grid: Grid | None = None,
        field: DisplacementField | None = None,
    ) -> None:
        """Show a frame: its image, its grid on it, its surface with the displacements.

        index: its number. image: (H, W), stored as JPEG if it has 8 bits, as PNG if it has 16.
        field: the displacement of the nodes, or None.
        time_ms: NaN leaves it out of the clock's timeline.

        Raises OSError if an earlier frame could not be written.
        """
        if self._file is not None:
            self._file.check()
        rerun, stream = self._rerun, self._stream
        stream.set_time("frame", sequence=index)
        if not math.isnan(time_ms):
            stream.set_time("time", duration=time_ms / 1000)
        if image is not None:
            stream.log("view", rerun.EncodedImage(**_encoded(image)))
        if grid is not None:
            colours = [
                STATUS_COLOURS[NodeStatus(status)][::-1] for status in grid.status[grid.valid]
            ]
            stream.log("view/nodes", rerun.Points2D(grid.xy[grid.valid], colors=colours, radii=1.5))
            stream.log("view/lines", rerun.LineStrips2D(strips(grid.xy, grid.valid), radii=0.4))
        if field is not None:
            self._surface(field)

    def _surface(self, field: DisplacementField) -> None:
        """Log the surface now and arrows from rest, coloured up to the largest so far."""
        columns, quads = mesh(field)
        rest, shift = columns["position"], columns["displacement"]
        length = np.linalg.norm(shift, axis=1)
        self._top = max(self._top, float(length.max(initial=0)), 1e-12)
        levels = np.rint(255 * length / self._top).astype(np.uint8).reshape(-1, 1)
        colours = np.empty((0, 3), np.uint8)
        if len(levels):
            colours = cv2.applyColorMap(levels, cv2.COLORMAP_PLASMA)[:, 0, ::-1]
        extent = float(np.ptp(rest, axis=0).max()) if len(rest) else 1.0
        surface = self._rerun.Mesh3D(
            vertex_positions=rest + shift,
            triangle_indices=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
            vertex_colors=colours,
        )
        arrows = self._rerun.Arrows3D(
            origins=rest, vectors=shift, colors=colours, radii=extent / 800
        )
        self._stream.log("gel/surface", surface)
        self._stream.log("gel/displacement", arrows)

    def close(self) -> None:
        """Finish the recording; closing again does nothing.

        Raises OSError if it could not be written whole; an older file is then kept.
        """
        self._stream.disconnect()
        file, self._file = self._file, None
        if file is not None:
            file.close()


def _encoded(image: GreyImage) -> dict[str, Any]:
    """Encode the image for rerun.EncodedImage: as JPEG, or, with 16 bits, as PNG."""
    if image.dtype == np.uint8:
        contents = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        return {"contents": contents.tobytes(), "media_type": "image/jpeg"}
    return {"contents": cv2.imencode(".png", image)[1].tobytes(), "media_type": "image/png"}


def strips(xy: NDArray[Any], valid: NDArray[np.bool_]) -> list[NDArray[Any]]:
    """Return the lines through neighbouring valid nodes along rows and columns, (n, 2) each.

    xy: (R, C, 2). valid: (R, C).
    """
    found = []
    for lines, known in ((xy, valid), (xy.swapaxes(0, 1), valid.T)):
        for line, seen in zip(lines, known, strict=True):
            ends = np.flatnonzero(np.diff(seen)) + 1
            parts = zip(np.split(line, ends), np.split(seen, ends), strict=True)
            found += [part for part, there in parts if len(part) > 1 and there[0]]
    return found
