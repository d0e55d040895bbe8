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


def lines(angle: float, opening: float, x: float = 0, y: float = 0) -> np.ndarray:
    """Return an image, black where a pixel lies on the same side of two lines through (x, y)."""
    sides = [(X - x) * math.cos(a) + (Y - y) * math.sin(a) for a in (angle, angle + opening)]
    return sides[0] * sides[1] > 0


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


def test_fig_8_corrosion_alone_rejects_a_stripe_and_passes_a_corner():
    found = at_centre(stripe(3.25, math.radians(10), 0.25), RapidCriteria(corrosion_threshold=4))
    assert found["corrosion"] == 7
    assert found["candidate"] == 0
    without = RapidCriteria(corrosion_threshold=None)
    assert at_centre(stripe(3.25, math.radians(10), 0.25), without)["candidate"] == 1

    found = at_centre(SLANTED, RapidCriteria(corrosion_threshold=4))
    assert found["corrosion"] == 1
    assert found["candidate"] == 1


@pytest.mark.parametrize("width", range(1, 9))
@pytest.mark.parametrize("angle", [0, math.pi / 4, 0.3])
def test_no_centred_stripe_passes_the_paper_thresholds(width, angle):
    rules = RapidCriteria(corrosion_threshold=4)
    assert at_centre(stripe(width, angle), rules)["candidate"] == 0
    assert at_centre(~stripe(width, angle), rules)["candidate"] == 0


def test_corrosion_treats_black_and_white_alike():
    rng = np.random.default_rng(3)
    binary = rng.random((40, 50)) < 0.5
    black, white = (
        criteria.corrosion(mask, ring.ring_bits(mask, ring.OUTER_5)) for mask in (binary, ~binary)
    )
    np.testing.assert_array_equal(black, white)
    assert len(np.unique(black)) > 5


def test_corrosion_is_16_where_ring_and_region_have_opposite_colours():
    ring_only = np.zeros((21, 21), np.bool_)
    for dx, dy in ring.OUTER_5:
        ring_only[10 + dy, 10 + dx] = True
    region_only = np.zeros((21, 21), np.bool_)
    for dx, dy in ring.REGION:
        region_only[10 + dy, 10 + dx] = True
    assert at_centre(ring_only, RapidCriteria())["corrosion"] == 16
    assert at_centre(region_only, RapidCriteria())["corrosion"] == 16


SLANTED = lines(math.radians(40), math.radians(110), -0.5, -0.5)
WIDE = lines(0, math.radians(110))


@pytest.mark.parametrize(
    ("field", "binary", "value"),
    [
        ("sector_threshold", SLANTED, 1),
        ("ring_threshold", WIDE, 2),
        ("corrosion_threshold", SLANTED, 1),
    ],
)
def test_a_value_at_its_threshold_fails(field, binary, value):
    assert at_centre(binary, RapidCriteria(**{field: value + 1}))["candidate"] == 1
    assert at_centre(binary, RapidCriteria(**{field: value}))["candidate"] == 0


def test_the_response_is_what_is_left_of_the_sector_threshold():
    binary = (X > 0) ^ (Y > 0)
    assert at_centre(binary, RapidCriteria(sector_threshold=16))["response"] == 14
    assert at_centre(binary, RapidCriteria(sector_threshold=3))["response"] == 1
    assert at_centre(binary, RapidCriteria(sector_threshold=2))["response"] == 0
