"""Binarization of the oracle against the definition, pixel by pixel in whole numbers."""

import numpy as np
import pytest
from corner_images import noise

from cmp_cl.config import AdaptiveMean
from cmp_cl.reference.paper.binarize import binarize


def window(image: np.ndarray, row: int, column: int, size: int) -> list[int]:
    half = size // 2
    height, width = image.shape
    return [
        int(image[min(max(r, 0), height - 1), min(max(c, 0), width - 1)])
        for r in range(row - half, row + half + 1)
        for c in range(column - half, column + half + 1)
    ]


def by_definition(image: np.ndarray, threshold: AdaptiveMean) -> np.ndarray:
    """Return where a pixel is black, in exact integers."""
    n = threshold.window**2
    result = np.zeros(image.shape, np.bool_)
    for row, column in np.ndindex(image.shape):
        greys = window(image, row, column, threshold.window)
        total = sum(greys)
        grey = int(image[row, column])
        result[row, column] = (grey + threshold.offset) * n < total
    return result


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (13, 17)])
@pytest.mark.parametrize("size", [3, 9, 21])
def test_black_follows_the_definition(shape, size):
    for image in (noise(shape), noise(shape).astype(np.uint16) * 257, noise(shape) // 128):
        threshold = AdaptiveMean(window=size)
        np.testing.assert_array_equal(binarize(image, threshold), by_definition(image, threshold))


def test_the_largest_sums_fit():
    image = np.where(noise((5, 6)) < 128, 0, 65535).astype(np.uint16)
    image[0, 0], image[-1, -1] = 0, 65535
    threshold = AdaptiveMean(window=255)
    np.testing.assert_array_equal(binarize(image, threshold), by_definition(image, threshold))
