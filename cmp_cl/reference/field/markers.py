"""Virtual markers on the edge profile (section 4.3)."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage
from cmp_cl.reference.edges import bilinear

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
        x, y = np.moveaxis(points + pixel[:, None], -1, 0)
        profile += bilinear(image, x, y) / 3
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
