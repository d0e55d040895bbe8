"""Images with corners, or the nodes of a grid, drawn on them."""

import math
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method
from cmp_cl.errors import FieldError, check_kind
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage, check_image

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
PLASMA: NDArray[np.uint8] = np.asarray(  # (256, 3), RGB, from dark blue to yellow
    cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_PLASMA)[:, 0, ::-1],
    np.uint8,
)
_UNKNOWN = 128  # grey of a node without a value
_OFF_GRID = (150, 150, 190)  # of corners off the grid
_FRACTION_BITS = 4


def corner_overlay(image: GreyImage, corners: Corners) -> NDArray[np.uint8]:
    """Draw a mark on each of the corners, coloured by its method, and a legend.

    image: (H, W) uint8 or uint16. Returns (H', W', 3) uint8 BGR. The image is enlarged by a whole
    factor, each pixel to a block, until a cell is about 32 px wide and the longer side at least
    1000 px; the result is at most 2400 px long unless the image is longer. The legend is below the
    image. A circle surrounds each corner and a dot marks its position. Raises ImageError, and
    FieldError if `corners` is of another type.
    """
    image = check_image(image)
    check_kind("corners", corners, Corners, FieldError)
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
    blocks = eight_bits(image).repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(blocks[:, :, None], 3, axis=2), factor


def coloured(values: NDArray[np.floating[Any]], top: float) -> NDArray[np.uint8]:
    """Return the colours (N, 3), RGB, of values (N,) from 0 to the top; grey where one is NaN."""
    levels = np.rint(255 * np.nan_to_num(values) / (top or 1)).astype(np.uint8)
    return np.where(np.isnan(values)[:, None], np.uint8(_UNKNOWN), PLASMA[levels])


def eight_bits(image: GreyImage) -> NDArray[np.uint8]:
    """Return an image as uint8; 16 bits are stretched to the brightest pixel."""
    if image.dtype == np.uint8:
        return image.astype(np.uint8, copy=False)
    white = max(int(image.max(initial=0)), 1)
    return np.asarray(np.rint(image * np.float32(255 / white)), np.uint8)


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
    image = check_image(image)
    check_kind("grid", grid, Grid, FieldError)
    if corners is not None:
        check_kind("corners", corners, Corners, FieldError)
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
