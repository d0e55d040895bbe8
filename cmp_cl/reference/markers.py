"""Virtual markers on the edge profile (section 4.3)."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage

HALF = 8
QUARTER = 4


def refine_markers(
    image: GreyImage,
    pixel: NDArray[np.int32],
    line: NDArray[np.float32],
    reach: NDArray[np.float32],
    contrast: float,
) -> NDArray[np.float64]:
    """Return the edge's offset from each marker along its normal, (M,) px; NaN without an edge.

    image: (H, W) uint8 or uint16. pixel, line, reach: as in cmp_cl.grid.markers.Profiles.
    contrast: grey levels by which the white side must be brighter than the black side.

    The profile has 17 samples from -reach to reach, each the mean of three bilinear samples
    one pixel apart along the edge. The edge is the crossing, nearest to the marker, of the middle
    between the means of its first and its last four samples.
    """
    at, normal = line[:, :2].astype(np.float64), line[:, 2:].astype(np.float64)
    spacing = reach.astype(np.float64)[:, None] / HALF
    along = np.arange(-HALF, HALF + 1) * spacing
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    profile = np.zeros(along.shape)
    for side in (-1, 0, 1):
        points = at[:, None] + along[..., None] * normal[:, None] + side * tangent[:, None]
        profile += _bilinear(image, points + pixel[:, None]) / 3
    white = profile[:, :QUARTER].mean(1)
    black = profile[:, -QUARTER:].mean(1)
    above = profile - ((white + black) / 2)[:, None]
    a, b = above[:, :-1], above[:, 1:]
    crosses = (a >= 0) & (b < 0)
    t = (np.arange(-HALF, HALF) + a / np.where(crosses, a - b, 1)) * spacing
    t = np.where(crosses, t, np.inf)
    nearest = np.take_along_axis(t, np.abs(t).argmin(1)[:, None], 1)[:, 0]
    found = np.isfinite(nearest) & (white - black >= contrast)
    return np.where(found, nearest, np.nan)


def _bilinear(image: GreyImage, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sample the image at (..., 2) points (x, y); beyond the image its border is repeated."""
    low = np.floor(points)
    ax, ay = np.moveaxis(points - low, -1, 0)
    x, y = np.moveaxis(low.astype(np.int64), -1, 0)
    rows, columns = image.shape
    x0, x1 = np.clip(x, 0, columns - 1), np.clip(x + 1, 0, columns - 1)
    y0, y1 = np.clip(y, 0, rows - 1), np.clip(y + 1, 0, rows - 1)
    grey = image.astype(np.float64)
    top = (1 - ax) * grey[y0, x0] + ax * grey[y0, x1]
    bottom = (1 - ax) * grey[y1, x0] + ax * grey[y1, x1]
    level: NDArray[np.float64] = (1 - ay) * top + ay * bottom
    return level
