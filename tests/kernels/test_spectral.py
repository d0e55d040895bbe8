"""kernels/spectral.cl: the four spectral criteria, equal to the oracle."""

import math

import images
import numpy as np
import pytest
from cases import some
from comparison import FLOATS, assert_maps_equal

from cmp_cl import BinaryRings, DetectorConfig, SpectralCriteria

EIGHT = images.eight_bits()
FIELDS = ("inner", "outer", *FLOATS, "corrosion", "candidate", "response")


def check(detector_for, image, config=None, fields=FIELDS, **criteria):
    config = config or DetectorConfig(
        detection=BinaryRings(criteria=SpectralCriteria(**criteria), contrast=None)
    )
    config = config.replace(refinement=None)
    return assert_maps_equal(detector_for(image, config), image, fields=fields)


@pytest.mark.parametrize("name", some(EIGHT, ("texture", "worn scene")))
def test_every_map_is_the_oracles(detector_for, name):
    check(detector_for, EIGHT[name])


@pytest.mark.parametrize(
    "name", some(["noise", "texture", "worn scene", "fine board"], ("texture",))
)
def test_the_gate_with_the_smaller_ring_equals_the_oracle(detector_for, name):
    config = DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria(), outer_radius=4))
    check(detector_for, EIGHT[name], config, fields=(*FIELDS, "contrast", "maximum"))


@pytest.mark.parametrize(
    "criteria",
    [
        {"correlation": 0.0},
        {"correlation": 0.5},
        {"correlation": 0.9},
        {"correlation": 1.0},
        {"phase": 0.0},
        {"phase": math.radians(11)},
        {"phase": math.pi},
        {"corrosion_threshold": 0},
        {"corrosion_threshold": None},
    ],
    ids=str,
)
def test_each_bound_decides_as_in_the_oracle(detector_for, criteria):
    image = EIGHT["texture"]
    found = check(detector_for, image, **criteria).candidate
    usual = DetectorConfig(
        detection=BinaryRings(criteria=SpectralCriteria(), contrast=None), refinement=None
    )
    assert found.sum() != detector_for(image, usual).maps(image).candidate.sum()


def test_a_correlation_at_the_bound_is_no_candidate(detector_for):
    image = EIGHT["texture"]
    maps = check(detector_for, image, correlation=0.75, phase=math.pi)
    square = np.rint(np.float64(maps.correlation) ** 2 * 65536) / 65536
    assert (square == 0.5625).any()
    assert not maps.candidate[square == 0.5625].any()


def test_maps_that_are_left_out_are_none(detector_for):
    maps = check(detector_for, EIGHT["noise"], corrosion_threshold=None)
    assert maps.corrosion is None
    assert maps.inner_transitions is None
    assert maps.contrast is None
