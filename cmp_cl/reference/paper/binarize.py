"""Binarization against a local mean (section 3.1), exact in integers."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import AdaptiveMean
from cmp_cl.image import GreyImage


def binarize(image: GreyImage, threshold: AdaptiveMean) -> NDArray[np.bool_]:
    """Return (H, W), True where black.

    With S the window sum and n the window's area, a pixel is black iff (I + C) n < S.
    """
    n = threshold.window**2
    grey = image.astype(np.int64)
    total = window_sum(grey, threshold.window)
    return (grey + threshold.offset) * n < total


def window_sum(values: NDArray[np.int64], window: int) -> NDArray[np.int64]:
    """Return (H, W) sums over the window x window neighbourhood, border pixels repeated."""
    padded = np.pad(values, window // 2, mode="edge")
    integral = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    rows = integral[window:] - integral[:-window]
    total: NDArray[np.int64] = rows[:, window:] - rows[:, :-window]
    return total
