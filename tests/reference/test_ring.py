"""The offsets of the rings, and what holds for all 65 536 rings."""

import itertools
import math

import numpy as np
import pytest

from cmp_cl.reference.paper import criteria, ring, spectral

RINGS = {"inner": (ring.INNER, 3), "outer 5": (ring.OUTER_5, 5), "outer 4": (ring.OUTER_4, 4)}


def run_lengths(mask: int) -> list[int]:
    """Return the lengths of the circular runs of a ring, by walking around it."""
    samples = [mask >> i & 1 for i in range(16)]
    start = next((i for i in range(16) if samples[i] != samples[i - 1]), 0)
    rotated = samples[start:] + samples[:start]
    return [len(list(group)) for _, group in itertools.groupby(rotated)]


@pytest.fixture(scope="module")
def runs() -> list[list[int]]:
    return [run_lengths(mask) for mask in range(1 << 16)]


@pytest.mark.parametrize("name", RINGS)
def test_rings_go_clockwise_from_twelve_and_have_the_symmetries_of_a_square(name):
    offsets, radius = RINGS[name]
    assert offsets[0] == (0, -radius)
    angles = [math.atan2(dx, -dy) % math.tau for dx, dy in offsets]
    assert angles == sorted(angles)
    assert len(set(offsets)) == 16
    assert all(abs(math.hypot(*offset) - radius) < 0.7 for offset in offsets)
    for k, (dx, dy) in enumerate(offsets):
        assert offsets[(k + 4) % 16] == (-dy, dx)
        assert offsets[-k % 16] == (-dx, dy)


def test_eq_19_counts_the_runs(runs):
    expected = [len(run) if len(run) > 1 else 0 for run in runs]
    np.testing.assert_array_equal(criteria.inner_transitions(ring.all_rings()), expected)


def test_eq_20_counts_the_runs_of_two_samples_or_more(runs):
    expected = [sum(n >= 2 for n in run) if len(run) > 1 else 0 for run in runs]
    np.testing.assert_array_equal(criteria.outer_transitions(ring.all_rings()), expected)


def test_eq_21_compares_opposite_runs(runs):
    expected = [
        max(abs(run[0] - run[2]), abs(run[1] - run[3])) if len(run) == 4 else 255 for run in runs
    ]
    np.testing.assert_array_equal(criteria.sector_differences(), expected)


def test_1560_inner_rings_pass_the_sector_difference():
    assert (criteria.sector_differences() < 5).sum() == 1560


def test_272_rings_tie_exactly_in_the_spectrum_and_none_has_four_runs():
    minus_1, minus_3 = spectral.spectrum_differences()
    tie = (minus_1 == 0) | (minus_3 == 0)
    assert tie.sum() == 272
    assert not (tie & (criteria.inner_transitions(ring.all_rings()) == 4)).any()
    f1, f2, f3 = spectral.magnitudes().T
    others = np.concatenate([np.abs(f2 - f1)[minus_1 != 0], np.abs(f2 - f3)[minus_3 != 0]])
    assert others.min() > 1e-3
