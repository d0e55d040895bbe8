"""Chooses the settings for an image by the corners that they find."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cell import cell_and_blur
from cmp_cl.config import DetectorConfig, EdgeStep
from cmp_cl.corners import Corners
from cmp_cl.image import GreyImage

_NEAR = 0.25  # share of the refinement's radius: positions so near are the same corner
_SHARE = 0.9  # least share of the corners of the settings for any cell
_CLOSE = (0.1, 0.6)  # quantile of the distances to the nearest corner, and its least value, cells
_SAMPLE = 256  # the most corners that are compared


def choose_by_corners(
    image: GreyImage, full_scale: int | None, find: Callable[[DetectorConfig], Corners]
) -> DetectorConfig:
    """Choose between the settings for any cell and `DetectorConfig.for_image`.

    The surround of a small board can look like wide cells. So the estimated settings are used only
    if they find the corners that the settings for any cell find. The estimated cell is used only if
    the corners are about that far apart.

    image: (H, W). full_scale: as in `DetectorConfig`. find: returns the corners of the image for a
        configuration.
    """
    cell, blur = cell_and_blur(image)
    for_any = DetectorConfig(full_scale=full_scale)
    estimated = DetectorConfig.for_cell(cell, blur=blur).replace(full_scale=full_scale)
    expected, found = find(for_any), find(estimated)
    lost = _nearest(_some(expected.xy), found.xy) > _NEAR * found.edge_radius
    if np.count_nonzero(lost) > (1 - _SHARE) * len(lost):
        return for_any
    if len(found) < 2:
        return estimated
    apart = np.quantile(_nearest(_some(found.xy), found.xy, itself=True), _CLOSE[0])
    if apart >= _CLOSE[1] * cell:
        return estimated
    narrow = EdgeStep(cell=min(cell, max(float(apart), EdgeStep().cell)))
    return estimated.replace(refinement=narrow)


def _some(xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return at most _SAMPLE positions, spread over the list."""
    chosen = np.linspace(0, len(xy) - 1, min(len(xy), _SAMPLE)).astype(int)
    return np.take(xy, chosen, axis=0)


def _nearest(
    xy: NDArray[np.float32], others: NDArray[np.float32], *, itself: bool = False
) -> NDArray[np.float64]:
    """Return the distance of each position to the nearest of the others, px; inf without one.

    itself: whether each position is also one of the others.
    """
    distances = np.full(len(xy), np.inf)
    for n, position in enumerate(xy):
        squared = np.square(others - position).sum(axis=1)
        if itself:
            squared[squared == 0] = np.inf
        distances[n] = np.sqrt(squared.min(initial=np.inf))
    return distances
