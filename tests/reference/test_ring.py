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


def test_the_region_has_21_pixels():
    assert len(ring.REGION) == 21
    assert (2, 1) in ring.REGION
    assert (2, 2) not in ring.REGION


def test_bit_i_is_sample_i():
    binary = np.zeros((20, 20), np.bool_)
    for bit, (dx, dy) in enumerate(ring.INNER):
        binary[:] = False
        binary[10 + dy, 10 + dx] = True
        assert ring.ring_bits(binary, ring.INNER)[10, 10] == 1 << bit


def test_samples_outside_repeat_the_border_pixel():
    binary = np.zeros((12, 12), np.bool_)
    binary[0, 0] = True
    corner = ring.bits(ring.ring_bits(binary, ring.OUTER_5))[0, 0]
    expected = [dx <= 0 and dy <= 0 for dx, dy in ring.OUTER_5]
    np.testing.assert_array_equal(corner, expected)


def test_rotation_brings_sample_i_plus_k_to_bit_i():
    masks = ring.all_rings()
    for k in range(16):
        expected = np.roll(ring.bits(masks), -k, axis=1)
        np.testing.assert_array_equal(ring.bits(ring.rotate(masks, k)), expected)


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


def test_run_numbers_go_clockwise_from_the_first_change(runs):
    masks = np.arange(0, 1 << 16, 7).astype(np.uint16)
    number, black = ring.runs(masks)
    np.testing.assert_array_equal(black, ring.bits(masks))
    for mask, numbers in zip(masks, number, strict=True):
        assert np.bincount(numbers).tolist() == runs[mask]
