"""Pictures of the results."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.results import Corners, GreyImage, Method

METHOD_COLOURS = {  # BGR
    Method.CENTROID: (0, 215, 255),
    Method.EDGE_LINES: (60, 230, 60),
    Method.EDGE_STEP: (255, 200, 0),
    Method.MIDLINE: (255, 80, 255),
    Method.CUSP: (0, 140, 255),
    Method.KEPT: (60, 60, 255),
}
_FRACTION_BITS = 4


def corner_overlay(image: GreyImage, corners: Corners) -> NDArray[np.uint8]:
    """The image with a mark on every corner, coloured by how it was refined, and a legend.

    image: (H, W) uint8 or uint16. Returns (H', W', 3) uint8 BGR: the image enlarged by a
    whole factor, pixels as blocks, until a cell is about 32 px and the longer side at least
    1000 px, but at most 2400 px unless it came larger; the legend stands below it. A circle
    surrounds each corner and a dot stands on its position.
    """
    cell = _spacing(corners.xy)
    longest = max(*image.shape, 1)
    factor = max(1, min(max(round(32 / cell), math.ceil(1000 / longest)), 2400 // longest))
    canvas = _enlarged(image, factor)
    radius = min(max(3.0, 0.3 * cell * factor), 24.0)
    for xy, method in zip(corners.xy, corners.method, strict=True):
        centre = (np.asarray(xy, np.float64) + 0.5) * factor - 0.5
        colour = METHOD_COLOURS[Method(method)]
        _circle(canvas, centre, radius, colour, thickness=1)
        _circle(canvas, centre, max(1.0, radius / 8), colour, thickness=cv2.FILLED)
    return _with_legend(canvas, corners)


def _spacing(xy: NDArray[np.float32]) -> float:
    """Median distance to the nearest other corner, px; 16 where there are fewer than two."""
    if len(xy) < 2:
        return 16.0
    some = xy[:: max(1, len(xy) // 256)].astype(np.float64)
    distance = np.hypot(*(some[:, None] - xy[None]).transpose(2, 0, 1))
    distance[distance == 0] = np.inf
    nearest = distance.min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    return float(np.median(nearest)) if len(nearest) else 16.0


def _enlarged(image: GreyImage, factor: int) -> NDArray[np.uint8]:
    grey = image
    if image.dtype != np.uint8:
        white = max(int(image.max()), 1) if image.size else 1
        grey = (image.astype(np.float32) * (255 / white)).round().astype(np.uint8)
    blocks = grey.repeat(factor, axis=0).repeat(factor, axis=1)
    return np.repeat(blocks[:, :, None], 3, axis=2)


def _circle(
    canvas: NDArray[np.uint8],
    centre: NDArray[np.float64],
    radius: float,
    colour: tuple[int, int, int],
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


def _with_legend(canvas: NDArray[np.uint8], corners: Corners) -> NDArray[np.uint8]:
    """The picture with a strip below: the number of corners, and of each method."""
    count = np.bincount(corners.method, minlength=len(Method))
    entries = [(f"{len(corners)} corners", (255, 255, 255))]
    entries += [
        (f"{method.name} {count[method]}", METHOD_COLOURS[method])
        for method in Method
        if count[method]
    ]
    font, size, gap = cv2.FONT_HERSHEY_SIMPLEX, 0.6, 24
    widths = [cv2.getTextSize(text, font, size, 1)[0][0] for text, _ in entries]
    width = max(canvas.shape[1], sum(widths) + gap * (len(entries) + 1))
    picture = np.zeros((canvas.shape[0] + 36, width, 3), np.uint8)
    picture[: canvas.shape[0], : canvas.shape[1]] = canvas
    x = gap
    for (text, colour), advance in zip(entries, widths, strict=True):
        origin = (x, canvas.shape[0] + 24)
        cv2.putText(picture, text, origin, font, size, colour, 1, cv2.LINE_AA)
        x += advance + gap
    return picture
