"""kernels/criteria.cl: ring bits and the four rapid criteria, equal to the oracle."""

import images
import numpy as np
import pytest
from cases import some
from comparison import RAPID, assert_maps_equal
from configs import rings

from cmp_cl import RapidCriteria
from cmp_cl.reference import ring

EIGHT = images.eight_bits()
FIELDS = ("inner", "outer", *RAPID, "corrosion", "candidate")


def check(detector_for, image, mask=None, **changes):
    config = rings(refinement=None, **changes)
    detector = detector_for(image, config, mask)
    return assert_maps_equal(detector, image, fields=FIELDS, mask=mask)


@pytest.mark.parametrize("outer_radius", [4, 5])
@pytest.mark.parametrize("name", some(EIGHT, ("texture", "worn scene", "two levels")))
def test_every_map_is_the_oracles(detector_for, name, outer_radius):
    check(detector_for, EIGHT[name], outer_radius=outer_radius)


@pytest.mark.parametrize("name", ["texture", "fine board"])
def test_the_criteria_without_corrosion_equal_the_oracle(detector_for, name):
    criteria = RapidCriteria(corrosion_threshold=None)
    more = check(detector_for, EIGHT[name], criteria=criteria)
    fewer = check(detector_for, EIGHT[name])
    assert more.corrosion is None
    assert more.candidate.sum() > fewer.candidate.sum()


@pytest.mark.parametrize(
    "criteria",
    some(
        [
            {"sector_threshold": 1},
            {"sector_threshold": 4},
            {"sector_threshold": 16},
            {"ring_threshold": 1},
            {"ring_threshold": 4},
            {"ring_threshold": 17},
            {"corrosion_threshold": -4},
            {"corrosion_threshold": 2},
            {"corrosion_threshold": 17},
            {"sector_threshold": 16, "ring_threshold": 17, "corrosion_threshold": 17},
        ],
        [{"sector_threshold": 4}, {"ring_threshold": 4}, {"corrosion_threshold": 2}],
    ),
    ids=str,
)
def test_each_threshold_decides_as_in_the_oracle(detector_for, criteria):
    image = EIGHT["texture"]
    usual = check(detector_for, image)
    other = check(detector_for, image, criteria=RapidCriteria(**criteria))
    assert other.candidate.sum() != usual.candidate.sum()


def test_noise_has_rings_of_every_kind(detector_for):
    maps = check(detector_for, EIGHT["two levels"])
    assert len(np.unique(maps.inner)) > 3000
    assert set(np.unique(maps.inner_transitions)) >= set(range(2, 15, 2))
    assert {0, 1, 2, 3, 4, 5, 6, 7, 255} <= set(np.unique(maps.sector_difference))


@pytest.mark.parametrize("sample", range(16))
@pytest.mark.parametrize(("name", "ring_of"), [("inner", ring.INNER), ("outer", ring.OUTER_5)])
def test_each_sample_is_its_own_bit(detector_for, sample, name, ring_of):
    image = np.full(images.SHAPE, 200, np.uint8)
    dx, dy = ring_of[sample]
    image[30 + dy, 40 + dx] = 10
    assert getattr(check(detector_for, image), name)[30, 40] == 1 << sample


def test_candidates_lie_inside_the_mask(detector_for):
    image = EIGHT["texture"]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[10:40, 5:83] = True
    everywhere, inside = check(detector_for, image), check(detector_for, image, mask)
    np.testing.assert_array_equal(inside.candidate, everywhere.candidate & mask)
    np.testing.assert_array_equal(inside.inner, everywhere.inner)
    assert 0 < inside.candidate.sum() < everywhere.candidate.sum()
