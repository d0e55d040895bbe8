"""The adaptive lattice filter: less noise, sharp bends that are kept, and the stated errors."""

import numpy as np
import pytest
from stereo_data import grid_of, points, rms

from cmp_cl.grid import NodeStatus
from cmp_cl.motion import displacement, filter_positions
from cmp_cl.motion.filter import filter_at_rest
from cmp_cl.reference.field import filter as lattice_filter


def lattice(rows=40, columns=40):
    r, c = np.mgrid[:rows, :columns]
    return 50 + 12.0 * np.stack([c, r], axis=-1)


def surface(rows=40, columns=40, bend=2.0):
    """Return a smooth deformation of a lattice, (R, C, 2), px."""
    r, c = np.mgrid[:rows, :columns] / max(rows, columns, 2)
    return np.stack([bend * np.sin(3 * c + r), bend * np.cos(2 * r - c)], axis=-1)


def noisy(truth, sigma, seed=0):
    return truth + np.random.default_rng(seed).normal(0, sigma, truth.shape)


def moved_by(moved, sigma=np.nan):
    """Return the field between an exact lattice and the same nodes moved, (R, C, 2)."""
    rest = lattice(*moved.shape[:2])
    return displacement(grid_of(rest, sigma), grid_of(rest + moved, sigma))


def test_noise_on_a_smooth_surface_is_more_than_halved_and_its_sigma_holds():
    truth = lattice() + surface()
    values = noisy(truth, 0.1)
    filtered = filter_positions(grid_of(values))
    assert rms(filtered.xy - truth) < 0.5 * rms(values - truth)
    assert 0.6 < rms((filtered.xy - truth) / filtered.sigma[..., None]) < 1.1


@pytest.mark.parametrize("direction", ["along a row", "along one diagonal", "along the other"])
def test_a_sharp_ridge_of_a_deformation_is_kept_in_every_direction(direction):
    r, c = np.mgrid[:18, :19]
    off = {"along a row": r - 8.5, "along one diagonal": r - c, "along the other": r + c - 17}
    ridge = np.exp(-np.square(off[direction]) / 2)
    truth = np.stack([ridge, -ridge], axis=-1)
    values = noisy(truth, 0.02)
    found = moved_by(values).displacement
    near = np.abs(off[direction]) <= 3
    assert rms((found - truth)[near]) < 1.1 * rms((values - truth)[near])
    assert rms((found - truth)[~near]) < 0.9 * rms((values - truth)[~near])


def test_a_gross_error_does_not_spread():
    values = noisy(surface(18, 19), 0.05)
    clean = moved_by(values)
    values[12, 13] += (3.0, -2.0)
    spoilt = moved_by(values)
    np.testing.assert_allclose(spoilt.displacement[12, 13], values[12, 13], atol=1e-4)
    assert spoilt.sigma[12, 13] > 2
    others = np.ones((18, 19), bool)
    others[12, 13] = False
    assert np.abs(spoilt.displacement - clean.displacement)[others].max() < 0.05
    assert np.abs(spoilt.sigma / clean.sigma - 1)[others].max() < 0.5


def test_interpolated_nodes_follow_their_neighbours():
    xy = noisy(lattice(12, 12), 0.1)
    off = xy.copy()
    off[6, 6] += 3
    grids = [grid_of(each) for each in (xy, off)]
    for grid in grids:
        grid.status[6, 6] = NodeStatus.INTERPOLATED
    one, other = map(filter_positions, grids)
    np.testing.assert_allclose(one.xy, other.xy, atol=1e-3)
    assert one.sigma[6, 6] >= np.median(one.sigma)


def test_the_covariance_shows_which_coordinate_is_less_certain():
    noise = np.random.default_rng(0).normal(0, (0.02, 0.02, 0.1), (18, 19, 3))
    flat = np.dstack([lattice(18, 19), np.zeros((18, 19))])
    found = displacement(points(flat), points(flat + noise))
    deviation = np.sqrt(np.diagonal(found.covariance, axis1=2, axis2=3))
    assert np.median(deviation[..., 2] / deviation[..., 0]) == pytest.approx(5, rel=0.2)


def pyramid() -> np.ndarray:
    """Return the displacement (18, 19, 2), px, under a pyramid that is rotated against the lattice.

    Its edges, eight nodes apart, look like noise along rows, columns and diagonals.
    """
    x, y = np.moveaxis(np.stack(np.mgrid[:18, :19], axis=-1) - [9.3, 10.1], -1, 0)
    aside = np.maximum(np.abs(x + 0.3 * y), np.abs(y - 0.3 * x))
    return np.maximum(0, 1 - aside / 4)[..., None] * [8.0, -5.6]


@pytest.mark.parametrize("worn", [False, True])
def test_displacements_keep_sharp_edges_on_a_perfect_print_but_not_on_a_worn_one(worn):
    """In the plane and in space, the sigma of the corners bounds the noise."""
    flat = np.stack(np.mgrid[:18, :19], axis=-1) * 20.0
    print_ = noisy(flat, 0.3, seed=5) if worn else flat
    before, after = (
        noisy(print_ + moved, 0.015, seed=seed) for seed, moved in ((6, 0), (7, pyramid()))
    )
    in_space = [np.dstack([xy, np.zeros((18, 19))]) for xy in (before, after)]
    raw = rms(after - before - pyramid())
    for field in (
        displacement(*(grid_of(xy, 0.015) for xy in (before, after))),
        displacement(*(points(xyz, 0.015) for xyz in in_space)),
    ):
        assert (rms(field.displacement[..., :2] - pyramid()) < 0.9 * raw) != worn


@pytest.mark.parametrize(
    ("shape", "axes"), [((18, 19), 2), ((18, 19), 3), ((4, 4), 2), ((1, 9), 2), ((15, 3), 3)]
)
def test_the_kernels_filter_positions_as_the_oracle(device, shape, axes):
    """To 0.005 of the noise."""
    values = noisy(300 + surface(*shape)[..., [0, 1, 1][:axes]], 0.1)
    measured = np.ones(shape, bool)
    if axes == 3:
        values[np.random.default_rng(7).random(shape) < 0.06] = np.nan
        values[shape[0] // 2, 1] += 4
        measured = np.random.default_rng(8).random(shape) > 0.05
    by_images = np.broadcast_to(np.eye(axes), (*shape, axes, axes))
    found = filter_at_rest(values, measured, by_images, device)
    expected = lattice_filter.filter_positions(values, measured)
    assert expected.margin > 1e-4  # no decision is left to rounding
    known = np.isfinite(expected.noise)
    np.testing.assert_array_equal(np.isnan(found.values), np.isnan(expected.values))
    np.testing.assert_array_equal(np.isfinite(found.noise), known)
    if known.any():
        apart = np.abs(found.values - expected.values).max(axis=2) / expected.noise
        assert np.nanmax(apart) < 5e-3
        sigma = np.sqrt(np.trace(found.covariance, axis1=2, axis2=3) / axes)
        np.testing.assert_allclose(sigma[known], expected.sigma[known], rtol=5e-3)
        np.testing.assert_allclose(found.noise, expected.noise, rtol=1e-3)
