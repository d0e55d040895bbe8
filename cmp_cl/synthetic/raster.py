"""Pixel centres, and images at another size."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[Any]  # float32 unless said otherwise


def pixel_centres(rows: int, columns: int) -> Array:
    """Return (x, y) of every pixel, (rows, columns, 2), px."""
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    return np.stack([x, y], axis=-1)


def resized(image: Image, rows: int, columns: int) -> Image:
    """Resample an image to (rows, columns) by bilinear interpolation."""
    result: Image = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return result
