"""Binarization of the oracle against the definition, pixel by pixel in whole numbers."""

import math

import numpy as np
import pytest
from corner_images import noise

from cmp_cl.config import AdaptiveMean
from cmp_cl.reference.binarize import binarize


def window(image: np.ndarray, row: int, column: int, size: int) -> list[int]:
    half = size // 2
    height, width = image.shape
    return [
        int(image[min(max(r, 0), height - 1), min(max(c, 0), width - 1)])
        for r in range(row - half, row + half + 1)
        for c in range(column - half, column + half + 1)
    ]


def by_definition(image: np.ndarray, threshold: AdaptiveMean) -> np.ndarray:
    """Return the layers of the thresholds mean - k sigma, k = 0, -1/2, 1/2, in exact integers."""
    n = threshold.window**2
    result = np.zeros((threshold.masks, *image.shape), np.bool_)
    for row, column in np.ndindex(image.shape):
        greys = window(image, row, column, threshold.window)
        total = sum(greys)
        grey = int(image[row, column])
        result[0, row, column] = (grey + threshold.offset) * n < total
        if threshold.masks == 3:
            variance = n * sum(g * g for g in greys) - total * total
            d = grey * n - total
            result[1, row, column] = d < 0 or 4 * d * d < variance
            result[2, row, column] = d < 0 and 4 * d * d > variance
    return result


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (13, 17)])
@pytest.mark.parametrize("size", [3, 9, 21])
@pytest.mark.parametrize("masks", [1, 3])
def test_the_layers_follow_the_definition(shape, size, masks):
    for image in (noise(shape), noise(shape).astype(np.uint16) * 257, noise(shape) // 128):
        threshold = AdaptiveMean(window=size, masks=masks)
        np.testing.assert_array_equal(binarize(image, threshold), by_definition(image, threshold))


def test_the_largest_sums_fit():
    image = np.where(noise((5, 6)) < 128, 0, 65535).astype(np.uint16)
    image[0, 0], image[-1, -1] = 0, 65535
    threshold = AdaptiveMean(window=255, masks=3)
    np.testing.assert_array_equal(binarize(image, threshold), by_definition(image, threshold))


def test_a_grey_level_on_an_outer_threshold_is_white():
    image = np.array([[2, 0, 1], [0, 0, 0], [0, 0, 0]], np.uint8)
    # S = 3 and Q = 5, so that 4 d^2 = 36 = 9 Q - S^2: the centre lies at mean - sigma / 2.
    _, more, less = binarize(image, AdaptiveMean(window=3, masks=3))
    assert more[1, 1]
    assert not less[1, 1]
    # Inverted, it lies at mean + sigma / 2.
    _, more, less = binarize(2 - image, AdaptiveMean(window=3, masks=3))
    assert not more[1, 1]
    assert not less[1, 1]


def test_an_offset_is_added_before_the_comparison():
    image = noise((11, 12))
    threshold = AdaptiveMean(window=5, offset=20)
    found = binarize(image, threshold)
    np.testing.assert_array_equal(found, by_definition(image, threshold))
    assert found.sum() < binarize(image, AdaptiveMean(window=5)).sum()


def test_a_flat_image_is_white_whatever_its_level():
    for level in (0, 7, 255):
        image = np.full((9, 9), level, np.uint8)
        assert not binarize(image, AdaptiveMean(window=5, masks=3)).any()


def test_one_outer_layer_has_more_black_and_the_other_less():
    middle, more, less = binarize(noise((40, 40)), AdaptiveMean(window=9, masks=3))
    assert (more >= middle).all()
    assert (middle >= less).all()
    share = [mask.mean() for mask in (less, middle, more)]
    # Uniform grey levels have sigma = range / sqrt(12): thresholds at .5 -+ .5 / sqrt(12) of it.
    # 0.05 is four standard errors of a share of 1600 pixels.
    np.testing.assert_allclose(
        share, [0.5 - 0.5 / math.sqrt(12), 0.5, 0.5 + 0.5 / math.sqrt(12)], atol=0.05
    )
