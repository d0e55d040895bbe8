"""kernels/gate_words.cl: contrasts of candidates by sixteen are those of one by one."""

import dataclasses

import images
import pytest
from comparison import assert_corners_equal, assert_maps_equal

from cmp_cl import AdaptiveMean, BinaryRings, Detector, DetectorConfig, DeviceKind, RapidCriteria

DENSE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)


def in_words(device, image, config):
    device = dataclasses.replace(device, kind=DeviceKind.CPU)
    return Detector(shape=image.shape, dtype=image.dtype, config=config, device=device)


@pytest.mark.parametrize("masks", [1, 3])
@pytest.mark.parametrize("radius", [4, 5])
def test_contrasts_of_both_rings(device, masks, radius):
    config = DetectorConfig(
        detection=BinaryRings(
            threshold=AdaptiveMean(masks=masks), outer_radius=radius, criteria=DENSE
        ),
        refinement=None,
    )
    for image in (images.texture((90, 110)), images.sixteen_bits()["texture"]):
        with in_words(device, image, config) as detector:
            maps = assert_maps_equal(detector, image)
            assert maps.candidate.sum() > 300
            assert (maps.contrast > 0).sum() > 100


def test_more_candidates_than_room(device):
    image = images.texture((300, 300))
    with in_words(
        device, image, DetectorConfig(detection=BinaryRings(criteria=DENSE), refinement=None)
    ) as detector:
        assert_corners_equal(detector, image)
        assert detector.regrown > 0
        assert_maps_equal(detector, image, fields=("contrast", "response", "maximum"))
