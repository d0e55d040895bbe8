"""kernels/binarize_bands.cl: bands of rows are binarized as whole images are."""

import dataclasses

import images
import numpy as np
import pytest
from comparison import assert_corners_equal, assert_maps_equal

from cmp_cl import AdaptiveMean, BinaryRings, Detector, DetectorConfig, DeviceKind

BINARY = ("binary", "candidate", "contrast", "response")


def banded(device, image, config):
    device = dataclasses.replace(device, kind=DeviceKind.CPU)
    return Detector(shape=image.shape, dtype=image.dtype, config=config, device=device)


@pytest.mark.parametrize("masks", [1, 3])
@pytest.mark.parametrize("window", [3, 21, 41, 255])
def test_every_window(device, masks, window):
    config = DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(window=window, masks=masks)), refinement=None
    )
    for image in (images.texture((131, 97)), images.sixteen_bits()["texture"]):
        with banded(device, image, config) as detector:
            assert_maps_equal(detector, image, fields=BINARY)


@pytest.mark.parametrize("rows", [1, 2, 3, 15, 16, 17, 33, 100])
def test_heights_around_a_band(device, rows):
    image = np.ascontiguousarray(images.texture((100, 70))[:rows])
    with banded(
        device, image, DetectorConfig(detection=BinaryRings(), refinement=None)
    ) as detector:
        assert_maps_equal(detector, image, fields=BINARY)


@pytest.mark.parametrize("offset", [1, 254, 255, 65535])
def test_offsets(device, offset):
    config = DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(offset=offset)), refinement=None
    )
    for image in (images.texture((70, 70)), images.sixteen_bits()["texture"]):
        with banded(device, image, config) as detector:
            assert_maps_equal(detector, image, fields=("binary",))
            assert_corners_equal(detector, image)
