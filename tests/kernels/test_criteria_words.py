"""kernels/criteria_words.cl: the criteria on 32 pixels in a word decide as those on bytes do.

Which of the two a device gets depends on its kind; here each kind's form runs on the device
under test, with all else that goes by the kind.
"""

import dataclasses

import images
import numpy as np
import pytest
from comparison import assert_corners_equal, assert_maps_equal
from corner_images import noise

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Detector,
    DetectorConfig,
    DeviceKind,
    EdgeStep,
    RapidCriteria,
)

EIGHT = images.eight_bits()
KINDS = [DeviceKind.CPU, DeviceKind.GPU]
DENSE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
CONFIGS = {
    "default": DetectorConfig(detection=BinaryRings()),
    "dense": DetectorConfig(detection=BinaryRings(criteria=DENSE, contrast=None), refinement=None),
    "no corrosion criterion": DetectorConfig(
        detection=BinaryRings(criteria=RapidCriteria(corrosion_threshold=None)), refinement=None
    ),
    "radius 4": DetectorConfig(detection=BinaryRings(outer_radius=4), refinement=None),
    "three masks": DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(masks=3)), refinement=EdgeStep()
    ),
}


def detector_of_kind(device, kind, image, config, mask=None):
    device = dataclasses.replace(device, kind=kind)
    return Detector(shape=image.shape, dtype=image.dtype, config=config, device=device, mask=mask)


def other_kind(device):
    """The kind whose form the other tests do not see."""
    return DeviceKind.GPU if device.kind is DeviceKind.CPU else DeviceKind.CPU


@pytest.mark.parametrize("name", CONFIGS)
def test_the_other_form_equals_the_oracle(device, name):
    config = CONFIGS[name]
    with detector_of_kind(device, other_kind(device), EIGHT["noise"], config) as detector:
        found = 0
        for image in EIGHT.values():
            assert_maps_equal(detector, image)
            found += len(assert_corners_equal(detector, image))
        assert found > 30


def test_sixteen_bits(device):
    config = DetectorConfig(detection=BinaryRings(), full_scale=4095)
    deep = images.sixteen_bits()
    with detector_of_kind(device, other_kind(device), deep["noise"], config) as detector:
        for image in deep.values():
            assert_maps_equal(detector, image)
            assert_corners_equal(detector, image)


def test_which_form_is_taken(device):
    image, config = EIGHT["noise"], DetectorConfig(detection=BinaryRings())
    for kind, in_words in [(DeviceKind.CPU, True), (DeviceKind.GPU, False)]:
        with detector_of_kind(device, kind, image, config) as detector:
            stages = {launch.stage for launch in detector._plan(None).front}
            assert ("rapid_criteria_words" in stages) is in_words
            assert ("rapid_criteria" in stages) is not in_words


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
@pytest.mark.parametrize("columns", [1, 31, 32, 33, 63, 64, 65, 96, 97, 130])
def test_widths_around_a_word(device, kind, columns):
    """Candidates in the first and in the last column, whatever the last word holds."""
    wide = images.texture((40, 140))
    config = CONFIGS["dense"]
    for rows in (1, 4, 40):
        image = np.ascontiguousarray(wide[:rows, :columns])
        with detector_of_kind(device, kind, image, config) as detector:
            assert_maps_equal(detector, image)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
def test_a_mask_of_single_pixels(device, kind):
    image = EIGHT["texture"]
    mask = noise(images.SHAPE, seed=9) > 127
    with detector_of_kind(device, kind, image, CONFIGS["dense"], mask) as detector:
        maps = assert_maps_equal(detector, image, mask=mask)
        assert maps.candidate.sum() > 100


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
def test_a_batch(device, kind):
    frames = list(EIGHT.values())
    with detector_of_kind(device, kind, frames[0], CONFIGS["dense"]) as detector:
        for corners, frame in zip(detector.batch(frames), frames, strict=True):
            np.testing.assert_array_equal(corners.pixel, detector(frame).pixel)
