"""The samples of an image, and the types of arrays that scenes are made of."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[Any]  # float32 unless said otherwise


def samples(size: tuple[int, int], count: int = 1) -> tuple[Array, Array]:
    """Return x and y of `count` samples a pixel along each axis of an image (H, W), px."""
    across, down = ((np.arange(n * count) + 0.5) / count - 0.5 for n in size[::-1])
    x, y = np.meshgrid(across, down)
    return x, y
