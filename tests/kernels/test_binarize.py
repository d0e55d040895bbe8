"""kernels/binarize.cl: black and white, equal to the oracle at every pixel."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_maps_equal

from cmp_cl import AdaptiveMean, BinaryRings, DetectorConfig

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
FEW = ("scene", "near levels", "texture")
SHAPES = [(1, 1), (1, 7), (7, 1), (2, 2), (5, 3), (13, 17), (31, 29)]


def check(detector_for, image, **threshold):
    config = DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(**threshold), contrast=None), refinement=None
    )
    return assert_maps_equal(detector_for(image, config), image, fields=("binary",)).binary


@pytest.mark.parametrize("window", some([3, 21, 41, 255], (21, 255)))
@pytest.mark.parametrize("name", some(EIGHT, FEW))
def test_the_binary_image_is_the_oracles_for_every_window(detector_for, name, window):
    check(detector_for, EIGHT[name], window=window)


@pytest.mark.parametrize("window", some([21, 255], (21,)))
@pytest.mark.parametrize("name", some(DEEP, ("noise", "bright")))
def test_the_binary_image_of_sixteen_bits_is_the_oracles(detector_for, name, window):
    check(detector_for, DEEP[name], window=window)


@pytest.mark.parametrize("offset", some([1, 7, 300, 65535], (7, 65535)))
def test_an_offset_moves_the_threshold_as_in_the_oracle(detector_for, offset):
    image = EIGHT["scene"]
    assert check(detector_for, image, offset=offset).sum() < check(detector_for, image).sum()


@pytest.mark.parametrize("offset", some([1, 700, 65535], (700,)))
@pytest.mark.parametrize("name", some(DEEP, ("12-bit scene",)))
def test_an_offset_of_sixteen_bits_equals_the_oracle(detector_for, name, offset):
    check(detector_for, DEEP[name], offset=offset)


def test_a_threshold_beyond_32_bits_does_not_overflow(detector_for):
    """The sums of 255 x 255 pixels at full scale, and of as many offsets, are near 2^32 each."""
    image = DEEP["white"]
    assert not check(detector_for, image, offset=65535, window=255).any()


def test_the_mean_itself_is_white(detector_for):
    image = np.full(images.SHAPE, 100, np.uint8)
    image[20, 20] = 99
    black = check(detector_for, image)
    assert black[20, 20]
    assert black.sum() == 1


@pytest.mark.parametrize("shape", some(SHAPES, ((1, 1), (13, 17))))
def test_shapes_smaller_than_the_window_equal_the_oracle(detector_for, shape):
    image = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    check(detector_for, image)
    check(detector_for, image, window=41)
