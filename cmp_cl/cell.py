"""The size of the cells of a pattern, from the image alone."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage, check_image

_WINDOW = 63
_NONE_FOUND = 24.0


def estimate_cell(image: GreyImage) -> float:
    """The side of the pattern's cells, px; 24 where the image shows none.

    Binarizes against the mean of a 63 px window and takes, over all rows and columns, the
    runs of 3 px and more that lie between two colour changes: the cell is the smallest
    length at which half of the pixels of those runs are in runs of it or shorter. Within
    0.95 to 1.15 of the truth on dense patterns; unreliable above 45 px and in clutter.

    Raises ImageError where the image is not (H, W) uint8 or uint16.
    """
    import cv2  # here, since it takes longer than a plan's first frame

    image = check_image(image)
    if not image.size:
        return _NONE_FOUND
    total = cv2.boxFilter(
        image, cv2.CV_32S, (_WINDOW, _WINDOW), normalize=False, borderType=cv2.BORDER_REPLICATE
    )
    black = image.astype(np.int32) * _WINDOW**2 < total
    histogram = _run_lengths(black, max(image.shape)) + _run_lengths(black.T, max(image.shape))
    histogram[:3] = 0
    pixels = np.cumsum(histogram * np.arange(len(histogram)))
    if not pixels[-1]:
        return _NONE_FOUND
    return float(np.searchsorted(2 * pixels, pixels[-1]))


def _run_lengths(black: NDArray[np.bool_], longest: int) -> NDArray[np.int64]:
    """(longest + 1,): how many runs of each length lie between two transitions of a row."""
    change = black[:, 1:] != black[:, :-1]
    row, column = np.nonzero(change)
    length = np.diff(column)[np.diff(row) == 0]
    return np.bincount(length, minlength=longest + 1)
