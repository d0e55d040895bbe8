"""kernels/nms_bands.cl: suppression in bands of rows keeps what it keeps in whole images."""

import dataclasses

import images
import pytest
from comparison import assert_maps_equal

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Detector,
    DetectorConfig,
    DeviceKind,
    RapidCriteria,
    SectorContrast,
)

DENSE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
FIELDS = ("response", "score", "maximum")


@pytest.mark.parametrize("radius", [1, 2, 3, 7, 15])
@pytest.mark.parametrize("masks", [1, 3])
def test_maxima_across_bands(device, radius, masks):
    """Bands of 16 rows: a window reaches over one or two of them."""
    config = DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(masks=masks), criteria=DENSE, contrast=None),
        nms_radius=radius,
        refinement=None,
    )
    image = images.texture((101, 83))
    device = dataclasses.replace(device, kind=DeviceKind.CPU)
    with Detector(shape=image.shape, config=config, device=device) as detector:
        maps = assert_maps_equal(detector, image, fields=FIELDS)
        assert maps.maximum.sum() > 5


@pytest.mark.parametrize("noise", [0, 70, 90])
def test_bounds_above_any_contrast(device, noise):
    """So noisy an image that the bound does not fit into the type of the contrasts."""
    gate = SectorContrast(minimum=0, relative=0, noise=noise)
    config = DetectorConfig(detection=BinaryRings(criteria=DENSE, contrast=gate), refinement=None)
    image = images.salt_and_pepper((90, 70), 0.5)
    device = dataclasses.replace(device, kind=DeviceKind.CPU)
    with Detector(shape=image.shape, config=config, device=device) as detector:
        maps = assert_maps_equal(detector, image, fields=FIELDS)
    assert maps.maximum.any() == (noise == 0)
