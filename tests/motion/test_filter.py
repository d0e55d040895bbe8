"""The adaptive lattice filter: less noise, sharp bends that are kept, and the stated errors."""

import numpy as np
import pytest
from stereo_data import grid_of, points

from cmp_cl.filter import filter_at_rest, filter_grid
from cmp_cl.motion import displacement, filter_positions
from cmp_cl.reference.field import filter as lattice_filter


def surface(rows, columns, bend=2.0):
    """Return a smooth deformation of a lattice, (R, C, 2), px."""
    r, c = np.mgrid[:rows, :columns] / max(rows, columns, 2)
    return np.stack([bend * np.sin(3 * c + r), bend * np.cos(2 * r - c)], axis=-1)


def noisy(truth, sigma, seed=0):
    return truth + np.random.default_rng(seed).normal(0, sigma, truth.shape)


def rms(error):
    return float(np.sqrt(np.nanmean(np.square(error))))


def test_noise_on_a_smooth_surface_is_more_than_halved_and_its_sigma_holds():
    truth = surface(40, 40)
    values = noisy(truth, 0.1)
    filtered = filter_grid(values)
    assert rms(filtered.values - truth) < 0.5 * rms(values - truth)
    assert 0.6 < rms((filtered.values - truth) / filtered.sigma[..., None]) < 1.1
    assert 0.9 < rms((values - truth) / filtered.noise[..., None]) < 1.1


def test_a_sharp_bend_is_kept():
    r, c = np.mgrid[:40, :40]
    truth = np.stack([np.where(c > 20, 0.5 * (c - 20), 0.0), 0.2 * r], axis=-1)
    values = noisy(truth, 0.02)
    filtered = filter_grid(values)
    bend = np.abs(c - 20) <= 1
    assert rms((filtered.values - truth)[bend]) < 1.5 * rms((values - truth)[bend])
    assert rms((filtered.values - truth)[~bend]) < 0.7 * rms((values - truth)[~bend])


def test_a_gross_error_does_not_spread():
    values = noisy(surface(30, 30), 0.05)
    clean = filter_grid(values)
    values[12, 17] += (3.0, -2.0)
    spoilt = filter_grid(values)
    assert spoilt.refused[12, 17]
    assert spoilt.refused.sum() == 1
    assert np.array_equal(spoilt.values[12, 17], values[12, 17])
    assert spoilt.sigma[12, 17] > 2
    others = ~spoilt.refused
    assert np.abs(spoilt.values - clean.values)[others].max() < 0.05
    assert np.abs(spoilt.sigma / clean.sigma - 1)[others].max() < 0.5


def test_nodes_that_are_not_measured_get_the_prediction_of_their_neighbours():
    truth = surface(30, 30)
    values = noisy(truth, 0.05)
    measured = np.ones((30, 30), bool)
    measured[10, 10] = measured[15, 3] = False
    values[10, 10] += 20
    filtered = filter_grid(values, measured=measured)
    values[10, 10] -= 40
    again = filter_grid(values, measured=measured)
    assert np.allclose(filtered.values, again.values, atol=1e-4)
    assert rms(filtered.values[10, 10] - truth[10, 10]) < 0.1
    assert filtered.sigma[10, 10] >= np.nanmedian(filtered.sigma)


def test_islands_and_components_do_not_influence_each_other():
    truth = surface(40, 40)
    values = noisy(truth, 0.1)
    apart = np.full_like(values, np.nan)
    apart[2:20, 3:18] = values[2:20, 3:18]
    apart[25:38, 25:39] = values[25:38, 25:39] + 7.0
    apart[1, 37] = values[1, 37]
    both = filter_grid(apart)
    apart[25:38, 25:39] -= 47.0
    moved = filter_grid(apart)
    assert np.abs(both.values[2:20, 3:18] - moved.values[2:20, 3:18]).max() < 1e-3
    assert rms(both.values[2:20, 3:18] - truth[2:20, 3:18]) < 0.06
    assert rms(both.values[25:38, 25:39] - 7 - truth[25:38, 25:39]) < 0.07
    assert np.array_equal(both.values[1, 37], apart[1, 37])


def grid_at(xy, sigma=0.03):
    return grid_of(xy, sigma)


def test_current_positions_are_those_at_rest_plus_filtered_displacements():
    """Wear of 0.2 px moves with the nodes; each image adds noise of 0.02 px."""
    rng = np.random.default_rng(2)
    r, c = np.mgrid[:30, :30]
    truth = 50 + 12.0 * np.stack([c, r], axis=-1)
    wear = rng.normal(0, 0.2, truth.shape)
    rest = grid_at(truth + wear + rng.normal(0, 0.02, truth.shape))
    moved = truth + surface(30, 30)
    now = grid_at(moved + wear + rng.normal(0, 0.02, truth.shape))
    filtered, raw = filter_positions(now, rest=rest)
    np.testing.assert_array_equal(raw.xy, now.xy)
    assert rms(filtered.xy - moved) < 0.5 * rms(raw.xy - moved)
    for grid in (filtered, raw):
        assert 0.5 < rms((grid.xy - moved) / grid.sigma[..., None]) < 1.15


def assert_equals_the_oracle(values, measured=None, *, bends=False, most_noise=None):
    """Assert that the fast form in float32 equals the oracle in float64 to 0.005 of the noise."""
    found = filter_grid(values, measured=measured, bends=bends, most_noise=most_noise)
    expected = lattice_filter.filter_grid(values, measured, bends=bends, most_noise=most_noise)
    assert expected.margin.min() > 1e-4  # no decision is left to rounding
    np.testing.assert_array_equal(found.refused, expected.refused)
    np.testing.assert_array_equal(np.isnan(found.sigma), np.isnan(expected.sigma))
    np.testing.assert_array_equal(np.isnan(found.values), np.isnan(expected.values))
    if np.isfinite(expected.noise).any():
        apart = np.abs(found.values - expected.values).max(axis=2) / expected.noise
        assert np.nanmax(apart) < 5e-3
        np.testing.assert_allclose(found.sigma, expected.sigma, rtol=5e-3)
        np.testing.assert_allclose(found.noise, expected.noise, rtol=1e-3)


@pytest.mark.parametrize("bends", [False, True])
def test_the_fast_form_equals_the_oracle(bends):
    assert_equals_the_oracle(noisy(surface(17, 20), 0.1) + 300, bends=bends)


@pytest.mark.parametrize("bends", [False, True])
def test_the_fast_form_equals_the_oracle_with_a_bound_on_the_noise(bends):
    most = np.full((17, 20), 0.05)
    most[4:9, 3:12] = np.nan
    values = noisy(surface(17, 20), 0.1)
    values[12, 4] = np.nan
    assert_equals_the_oracle(values, bends=bends, most_noise=most)


def pyramid() -> np.ndarray:
    """Return the displacement (20, 20, 2), px, under a pyramid that is rotated against the lattice.

    Its edges, eight nodes apart, look like noise along rows, columns and diagonals.
    """
    x, y = np.moveaxis(np.stack(np.mgrid[:20, :20], axis=-1) - [9.3, 10.1], -1, 0)
    aside = np.maximum(np.abs(x + 0.3 * y), np.abs(y - 0.3 * x))
    return np.maximum(0, 1 - aside / 4)[..., None] * [8.0, -5.6]


@pytest.mark.parametrize("worn", [False, True])
def test_displacements_keep_sharp_edges_on_a_perfect_print_but_not_on_a_worn_one(worn):
    """In the image, in the plane and in space, the sigma of the corners bounds the noise."""
    flat = np.stack(np.mgrid[:20, :20], axis=-1) * 20.0
    print_ = flat + (noisy(np.zeros_like(flat), 0.3, seed=5) if worn else 0)
    before, after = (
        noisy(print_ + moved, 0.015, seed=seed) for seed, moved in ((6, 0), (7, pyramid()))
    )
    rest, now = (grid_of(xy, 0.015) for xy in (before, after))
    still, pressed = (
        points(np.concatenate([xy, np.zeros((20, 20, 1))], axis=2), 0.015) for xy in (before, after)
    )
    start = filter_positions(rest)[0].xy
    found = {
        "image": filter_positions(now, rest=rest)[0].xy - start,
        "plane": displacement(rest, now).displacement,
        "space": displacement(still, pressed).displacement[..., :2],
    }
    raw = rms(after - before - pyramid())
    for name, moved in found.items():
        assert (rms(moved - pyramid()) < 0.9 * raw) != worn, name


def test_the_fast_form_equals_the_oracle_for_holes_and_errors():
    values = noisy(surface(18, 19), 0.1)
    values[np.random.default_rng(7).random((18, 19)) < 0.08] = np.nan
    values[3:7, 12:16] = np.nan
    values[10, 5] += 4
    measured = np.random.default_rng(8).random((18, 19)) > 0.05
    for bends in (False, True):
        assert_equals_the_oracle(values, measured, bends=bends)


def test_the_fast_form_equals_the_oracle_for_components():
    values = np.full((20, 22, 3), np.nan)
    values[:9, :8] = noisy(surface(9, 8), 0.1)[..., [0, 1, 1]]
    values[12:, 12:] = 5 + noisy(surface(8, 10), 0.2, seed=1)[..., [0, 1, 1]]
    values[1, 20] = 3
    assert_equals_the_oracle(values)


@pytest.mark.parametrize("shape", [(1, 9), (4, 4), (5, 6), (7, 8), (15, 3)])
def test_the_fast_form_equals_the_oracle_for_small_lattices(shape):
    for bends in (False, True):
        assert_equals_the_oracle(noisy(surface(*shape), 0.1), bends=bends)


def test_positions_at_rest_are_filtered_once_for_all_frames():
    values = noisy(surface(8, 9), 0.1)
    measured = np.ones((8, 9), np.bool_)
    first = filter_at_rest(values, measured=measured)
    assert filter_at_rest(values.copy(), measured=measured) is first
    np.testing.assert_array_equal(first.values, filter_grid(values, measured=measured).values)
    values[3, 4] += 0.2
    assert filter_at_rest(values, measured=measured) is not first
    measured[2, 2] = False
    others = filter_at_rest(values, measured=measured)
    np.testing.assert_array_equal(others.values, filter_grid(values, measured=measured).values)
    with pytest.raises(ValueError, match="read-only"):
        first.values[0, 0] = 0
