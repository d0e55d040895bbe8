"""Images with corners, or with the nodes of a grid, drawn on them."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method
from cmp_cl.errors import FieldError
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import AnyImage, check_image

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
_UNKNOWN = (128, 128, 128)  # a node without a value
_OFF_GRID = (150, 150, 190)  # corners off the grid
_LINE, _FIRST_ROW, _FIRST_COLUMN = (220, 160, 60), (60, 60, 255), (255, 80, 40)
_WHITE = (255, 255, 255)
_LEVELS = np.arange(256, dtype=np.uint8)[:, None]
_PLASMA = cv2.applyColorMap(_LEVELS, cv2.COLORMAP_PLASMA)[:, 0]  # (256, 3), BGR
_STRIP = 36  # px below the image for the legend
_LEAST = 1000  # px along the longer side of an overlay
_LEAST_OF_VIDEO, _MOST_OF_VIDEO = 480, 1920  # px, of `moved_overlay`: width, and longer side
_FRACTION_BITS = 4
_UNIT = 1 << _FRACTION_BITS


def corner_overlay(image: AnyImage, corners: Corners) -> NDArray[np.uint8]:
    """Draw a mark on each of the corners, coloured by its method, and a legend.

    image: (H, W) uint8 or uint16. Returns (H', W', 3) uint8 BGR. The image is enlarged by a whole
    factor, each pixel to a block, until its longer side has 1000 px. The legend is below the image.
    A circle surrounds each corner and a dot marks its position. Raises ImageError.
    """
    image = check_image(image)
    canvas = _Canvas(image, _LEAST)
    radius = min(max(3.0, 0.3 * _spacing(corners.xy) * canvas.factor), 24.0)
    colours = [METHOD_COLOURS[Method(method)] for method in corners.method]
    canvas.marks(corners.xy, colours, radius, thickness=1)
    canvas.marks(corners.xy, colours, max(1.0, radius / 8))
    legend = [(f"{len(corners)} corners", _WHITE), *_counted(corners.method, METHOD_COLOURS)]
    return canvas.above(_strip(legend))


def grid_overlay(
    image: AnyImage, grid: Grid, *, corners: Corners | None = None
) -> NDArray[np.uint8]:
    """Draw the lines of the grid, a dot on every node by status, and a legend.

    image: (H, W) uint8 or uint16. corners: those that the grid was built from. Corners off the grid
    are drawn as faint rings. Returns (H', W', 3) uint8 BGR, enlarged like `corner_overlay`. The
    first row is drawn in red and the first column in blue. Raises ImageError.
    """
    image = check_image(image)
    canvas = _Canvas(image, _LEAST)
    canvas.lattice(grid.xy)
    canvas.lines(grid.xy[:1], _FIRST_ROW)
    canvas.lines(grid.xy.swapaxes(0, 1)[:1], _FIRST_COLUMN)
    radius = min(max(2.0, 0.1 * _spacing(grid.xy[grid.valid]) * canvas.factor), 8.0)
    off = np.empty((0, 2)) if corners is None else corners.xy[grid.index[:, 0] < 0]
    canvas.marks(off, [_OFF_GRID] * len(off), 1.5 * radius, thickness=1)
    colours = [STATUS_COLOURS[NodeStatus(status)] for status in grid.status[grid.valid]]
    canvas.marks(grid.xy[grid.valid], colours, radius)
    legend = [(f"{grid.shape[0]} x {grid.shape[1]} nodes", _WHITE)]
    legend += _counted(grid.status, STATUS_COLOURS)
    legend += [(f"off the grid {len(off)}", _OFF_GRID)] if len(off) else []
    return canvas.above(_strip(legend))


def moved_overlay(
    image: AnyImage,
    grid: Grid,
    moved: NDArray[np.floating[Any]],
    *,
    top: float,
    unit: str,
    text: str = "",
) -> NDArray[np.uint8]:
    """Draw the lines of the grid, a dot on every node by its displacement, and a colour bar.

    image: (H, W) uint8 or uint16. moved: how far each node has moved, (R, C); one without a
    displacement is grey. top: the end of the scale, in the unit. text: beside the bar. Returns
    (H', W', 3) uint8 BGR, enlarged by a whole factor until it is 480 px wide, as far as its longer
    side then has at most 1920 px, or reduced to these. Raises FieldError if `moved` does not fit
    the grid.
    """
    if moved.shape != grid.shape:
        raise FieldError(f"moved is {moved.shape}, the grid has {grid.shape} nodes")
    longest, wanted = max(image.shape), -(-_LEAST_OF_VIDEO // image.shape[1])
    times = max(1, min(wanted, _MOST_OF_VIDEO // longest))  # as wide as the colour bar
    canvas = _Canvas(image, times * longest, _MOST_OF_VIDEO)
    canvas.lattice(grid.xy)
    values = moved[grid.valid]
    levels = np.rint(255 * np.nan_to_num(values) / (top or 1)).clip(0, 255).astype(int)
    colours = np.where(np.isnan(values)[:, None], _UNKNOWN, _PLASMA[levels])
    radius = min(max(2.5, 0.2 * _spacing(grid.xy[grid.valid]) * canvas.factor), 8.0)
    canvas.marks(grid.xy[grid.valid], colours.tolist(), radius)
    bar = [("", bgr) for bgr in _PLASMA[::2].tolist()]
    ends = ("0", _WHITE), (f" {top:.3g} {unit}", _WHITE)
    return canvas.above(_strip([(text or " ", _WHITE), ends[0], *bar, ends[1]]))


class _Canvas:
    """An image in BGR, to draw on at positions in the image.

    factor: by which it is enlarged or reduced, so that its longer side has `least` to `most` px.
    """

    def __init__(self, image: AnyImage, least: int, most: float = math.inf) -> None:
        longest = max(image.shape)
        self.factor: float = 1 / -(-longest // most) if longest > most else -(-least // longest)
        rows, columns = (round(side * self.factor) for side in image.shape)
        how = cv2.INTER_NEAREST if self.factor >= 1 else cv2.INTER_AREA
        white = 255 if image.dtype == np.uint8 else max(int(image.max()), 1)
        grey = cv2.convertScaleAbs(image, alpha=255 / white)  # stretched to the brightest pixel
        grey = cv2.resize(grey, (columns, rows), interpolation=how)
        self._picture = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)

    def _places(self, xy: NDArray[Any]) -> NDArray[np.int32]:
        """Return positions as OpenCV draws them, in fractions of a pixel."""
        places = (xy.astype(np.float64) + 0.5) * self.factor - 0.5
        return np.rint(_UNIT * places).astype(np.int32)

    def marks(
        self,
        xy: NDArray[Any],
        colours: Iterable[Any],
        radius: float,
        *,
        thickness: int = cv2.FILLED,
    ) -> None:
        """Draw a circle of that radius, px of the picture, around each of the positions (N, 2)."""
        size = round(radius * _UNIT)
        for place, bgr in zip(self._places(xy).tolist(), colours, strict=True):
            cv2.circle(self._picture, place, size, bgr, thickness, cv2.LINE_AA, _FRACTION_BITS)

    def lines(self, xy: NDArray[Any], bgr: Colour) -> None:
        """Draw the segments between successive points of each line, (L, N, 2); none at a NaN."""
        ends = np.stack([xy[:, :-1], xy[:, 1:]], axis=2).reshape(-1, 2, 2)
        drawn = self._places(ends[~np.isnan(ends).any(axis=(1, 2))])
        cv2.polylines(self._picture, list(drawn), False, bgr, 1, cv2.LINE_AA, _FRACTION_BITS)

    def lattice(self, xy: NDArray[Any]) -> None:
        """Draw the lines between neighbouring nodes (R, C, 2)."""
        self.lines(xy, _LINE)
        self.lines(xy.swapaxes(0, 1), _LINE)

    def above(self, strip: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the picture with a strip below it."""
        rows, columns = self._picture.shape[:2]
        whole = np.zeros((rows + len(strip), max(columns, strip.shape[1]), 3), np.uint8)
        whole[:rows, :columns] = self._picture
        whole[rows:, : strip.shape[1]] = strip
        return whole


def _strip(words: list[tuple[str, Any]]) -> NDArray[np.uint8]:
    """Return coloured words side by side; an empty one is a column of a colour bar."""
    font, size, gap = cv2.FONT_HERSHEY_SIMPLEX, 0.5, 14
    widths = [cv2.getTextSize(text, font, size, 1)[0][0] + gap if text else 1 for text, _ in words]
    strip = np.zeros((_STRIP, sum(widths) + gap, 3), np.uint8)
    x = gap
    for (text, bgr), width in zip(words, widths, strict=True):
        if not text:
            strip[12:26, x] = bgr
        else:
            cv2.putText(strip, text, (x, 24), font, size, bgr, 1, cv2.LINE_AA)
        x += width
    return strip


def _counted(
    kinds: NDArray[np.uint8], colours: Mapping[Method, Colour] | Mapping[NodeStatus, Colour]
) -> list[tuple[str, Colour]]:
    """Return a word for each kind that occurs, with its count and its colour."""
    count = np.bincount(kinds.ravel(), minlength=len(colours))
    return [(f"{kind.name} {count[kind]}", bgr) for kind, bgr in colours.items() if count[kind]]


def _spacing(xy: NDArray[np.float32]) -> float:
    """Return the median distance to the nearest other corner, px; 16 with fewer than two."""
    if len(xy) < 2:
        return 16.0
    some = xy[:: max(1, len(xy) // 64)].astype(np.float64)
    distance = np.hypot(*(some[:, None] - xy[None]).transpose(2, 0, 1))
    distance[distance == 0] = np.inf
    return float(np.median(distance.min(axis=1)))
