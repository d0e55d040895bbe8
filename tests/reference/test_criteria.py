"""The rapid criteria of the oracle on images drawn by hand."""

import math

import numpy as np
import pytest

from cmp_cl.config import RapidCriteria
from cmp_cl.reference.paper import criteria, ring

Y, X = np.mgrid[-10:11, -10:11]


def at_centre(binary: np.ndarray, rules: RapidCriteria, radius: int = 5) -> dict[str, int]:
    inner, outer = (ring.ring_bits(binary, ring.INNER), ring.ring_bits(binary, ring.OUTER[radius]))
    found = criteria.rapid(binary, inner, outer, rules)
    return {name: int(values[10, 10]) for name, values in vars(found).items() if values is not None}


def stripe(width: float, angle: float = 0, offset: float = 0) -> np.ndarray:
    return np.abs(X * math.cos(angle) + Y * math.sin(angle) - offset) < width / 2


@pytest.mark.parametrize("radius", [4, 5])
def test_a_diagonal_corner_has_the_values_worked_out_by_hand(radius):
    found = at_centre(np.abs(X) > np.abs(Y), RapidCriteria(), radius)
    # Inner ring: 3 black samples about three and nine o'clock, the diagonals white: 3 5 3 5.
    assert found["inner_transitions"] == 4
    assert found["outer_transitions"] == 4
    assert found["sector_difference"] == 0
    assert found["ring_difference"] == 0
    # 6 of 16 black on the ring, 8 of 21 in the region: max(6 - 8, 8 - 6 - 5).
    assert found["corrosion"] == -2
    assert found["response"] == 5


def test_an_upright_corner_has_the_values_worked_out_by_hand():
    found = at_centre((X > 0) ^ (Y > 0), RapidCriteria())
    # From one o'clock 4 black, 3 white, 4 black, 5 white: the axes belong to the upper left.
    assert found["sector_difference"] == 2
    assert found["response"] == 3


@pytest.mark.parametrize("width", range(1, 9))
@pytest.mark.parametrize("angle", [0, math.pi / 4, 0.3])
def test_no_centred_stripe_passes_the_paper_thresholds(width, angle):
    rules = RapidCriteria(corrosion_threshold=4)
    assert at_centre(stripe(width, angle), rules)["candidate"] == 0
    assert at_centre(~stripe(width, angle), rules)["candidate"] == 0


def test_corrosion_is_16_where_ring_and_region_have_opposite_colours():
    ring_only = np.zeros((21, 21), np.bool_)
    for dx, dy in ring.OUTER_5:
        ring_only[10 + dy, 10 + dx] = True
    region_only = np.zeros((21, 21), np.bool_)
    for dx, dy in ring.REGION:
        region_only[10 + dy, 10 + dx] = True
    assert at_centre(ring_only, RapidCriteria())["corrosion"] == 16
    assert at_centre(region_only, RapidCriteria())["corrosion"] == 16
