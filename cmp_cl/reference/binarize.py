"""Binarization against a local mean (section 3.1), exact in integers."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import AdaptiveMean
from cmp_cl.image import GreyImage


def binarize(image: GreyImage, threshold: AdaptiveMean) -> NDArray[np.bool_]:
    """Return (M, H, W), True where black, for the M = 1 or 3 threshold layers of the configuration.

    With S the window sum and n the window's area, a pixel is black iff (I + C) n < S. In the second
    layer it is black iff I < mean + sigma/2, in the third iff I < mean - sigma/2. They use
    n^2 variance = n Q - S^2, with Q the window sum of squares.
    """
    n = threshold.window**2
    grey = image.astype(np.int64)
    total = window_sum(grey, threshold.window)
    mean_mask = (grey + threshold.offset) * n < total
    if threshold.masks == 1:
        return mean_mask[None]
    # n Q, S^2 and d^2 reach 1.82e19, which only unsigned numbers of 64 bits hold.
    squares = window_sum(grey * grey, threshold.window).astype(np.uint64)
    variance = np.uint64(n) * squares - total.astype(np.uint64) ** 2
    below = grey * n < total
    d = np.abs(grey * n - total).astype(np.uint64)
    lower = variance // np.uint64(4)
    upper = lower + (variance % np.uint64(4) > 0).astype(np.uint64)
    return np.stack([mean_mask, below | (d * d < upper), below & (d * d > lower)])


def window_sum(values: NDArray[np.int64], window: int) -> NDArray[np.int64]:
    """Return (H, W) sums over the window x window neighbourhood, border pixels repeated."""
    padded = np.pad(values, window // 2, mode="edge")
    integral = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    rows = integral[window:] - integral[:-window]
    total: NDArray[np.int64] = rows[:, window:] - rows[:, :-window]
    return total
