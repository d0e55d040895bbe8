"""kernels/nms_bands.cl: suppression in bands of rows keeps what it keeps in whole images."""

import dataclasses

import images
import pytest
from comparison import assert_maps_equal

from cmp_cl import AdaptiveMean, Detector, DetectorConfig, DeviceKind, RapidCriteria

DENSE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
FIELDS = ("response", "score", "maximum")


@pytest.mark.parametrize("radius", [1, 2, 3, 7, 15])
@pytest.mark.parametrize("masks", [1, 3])
def test_maxima_across_bands(device, radius, masks):
    """Bands of 16 rows: a window reaches over one or two of them."""
    config = DetectorConfig(
        threshold=AdaptiveMean(masks=masks),
        criteria=DENSE,
        contrast=None,
        nms_radius=radius,
        refinement=None,
    )
    image = images.texture((101, 83))
    device = dataclasses.replace(device, kind=DeviceKind.CPU)
    with Detector(shape=image.shape, config=config, device=device) as detector:
        maps = assert_maps_equal(detector, image, fields=FIELDS)
        assert maps.maximum.sum() > 5
