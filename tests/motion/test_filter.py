"""The adaptive lattice filter: less noise, sharp bends that are kept, the stated errors; and the
shift of corners by bent edges, which the lattice shows and of which filtered values are free."""

import dataclasses
import math

import numpy as np
import pytest
from corner_images import from_nearest
from stereo_data import gel, grid_of, points, project, rms, toed_in_rig, views_of

from cmp_cl import Detector, DetectorConfig
from cmp_cl.fits import bend_shift
from cmp_cl.grid import NodeStatus, build_grid
from cmp_cl.grid.grid import MEASURED
from cmp_cl.motion import displacement, filter_positions
from cmp_cl.motion.filter import filtered
from cmp_cl.reference import detect
from cmp_cl.reference.field import filter as lattice_filter
from cmp_cl.space import StereoRig
from cmp_cl.synthetic import Indenter, Mode, boards, random_scene, render


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


def test_a_corner_that_is_rough_at_one_moment_moves_as_its_neighbours_do():
    """A worn corner is averaged with its prediction when it is rough, and so jumps by itself."""
    rest, moved = lattice(18, 19), noisy(surface(18, 19), 0.05)
    now = grid_of(rest + moved)
    now.xy[12, 13] += (0.4, -0.3)
    now.status[12, 13] = NodeStatus.ATTACHED
    found = displacement(grid_of(rest), now)
    off = found.displacement[12, 13] - surface(18, 19)[12, 13]
    assert (np.abs(off) < 2 * found.sigma[12, 13]).all()
    assert found.sigma[12, 13] < 0.1


def test_half_hidden_corners_around_a_hand_follow_the_others_or_say_how_far_they_err():
    rest, truth = noisy(lattice(), 0.02), surface()
    row, column = np.mgrid[:40, :40]
    inside = np.maximum(abs(row - 20), abs(column - 20))
    edge, xy = inside == 6, noisy(lattice() + truth, 0.02, 1)
    xy[edge] = noisy(xy[edge], 1.0, 2)
    xy[inside < 6], xy[5, 5] = np.nan, xy[5, 5] + 0.1
    now = grid_of(xy, 0.02)
    now.status[edge], now.image_sigma[edge], now.image_sigma[5, 5] = (
        NodeStatus.ATTACHED,
        np.nan,
        0.3,
    )
    field = displacement(grid_of(rest, 0.02), now)
    off, raw_off = (each.displacement - truth for each in (field, field.raw))
    assert rms(off[edge]) < 0.2
    assert np.mean(np.abs(off) < 2 * field.sigma[..., None], where=edge[..., None]) > 0.9
    assert np.mean(np.abs(raw_off) < 2 * field.raw.sigma[..., None], where=edge[..., None]) > 0.8
    assert field.raw.sigma[5, 5] == pytest.approx(0.3, rel=0.1)


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
        measured = np.where(np.random.default_rng(9).random(shape) < 0.1, 2 * measured, measured)
    by_images = np.broadcast_to(np.eye(axes), (*shape, axes, axes))
    own = np.random.default_rng(10).choice([0.004, 1.0, np.nan], shape, p=(0.8, 0.1, 0.1))
    found = filtered(values, measured, by_images, device, own=own)
    expected = lattice_filter.filter_positions(values, measured, own)
    assert expected.margin > 1e-4  # no decision is left to rounding
    known = np.isfinite(expected.noise)
    np.testing.assert_array_equal(np.isnan(found.values), np.isnan(expected.values))
    np.testing.assert_array_equal(np.isfinite(found.noise), known)
    if known.any():
        apart = np.abs(found.values - expected.values).max(axis=2) / expected.noise
        assert np.nanmax(apart) < 5e-3
        sigma, wanted = (
            np.sqrt(np.trace(each.covariance, axis1=2, axis2=3) / axes)
            for each in (found, expected)
        )
        np.testing.assert_allclose(sigma[known], wanted[known], rtol=5e-3)
        np.testing.assert_allclose(found.noise, expected.noise, rtol=1e-3)


def test_sigma_holds_along_each_axis_of_a_node_that_two_near_cameras_see():
    """The depth is noisy, which asks for wide filters; across, the shape then errs by more."""
    matrix = np.array([[1100.0, 0, 400], [0, 1100, 600], [0, 0, 1]])
    rig = StereoRig(matrix, [], matrix, [], np.eye(3), [-4.0, 0, 0])
    rest = gel(40, 40, depth=0.0)
    bump = np.exp(-np.square(rest[..., :2]).sum(axis=2) / 30)[..., None]
    now, within = rest + bump * rest * (0.1, 0.1, 0) - bump * (0, 0, 1), []
    for seed in range(770_700, 770_704):
        rng = np.random.default_rng(seed)
        field = displacement(*(rig.triangulate(*views_of(rig, xyz, rng)) for xyz in (rest, now)))
        variance, axes = np.linalg.eigh(field.covariance)
        off = np.einsum("rcij,rci->rcj", axes, field.displacement - (now - rest))
        within.append((np.abs(off) < 2 * np.sqrt(variance)).mean(axis=(0, 1)))
    assert np.mean(within, axis=0).min() > 0.83


# the shift by bent edges

RADIUS = 8.0  # px


def arcs(rows=12, columns=14, cell=10.0, bend=200.0):
    """Return a lattice whose rows are arcs around (0, 0), (R, C, 2) px, and their radii, (R, 1)."""
    angle = (np.arange(columns) - columns / 2) * cell / bend
    radii = bend + cell * np.arange(rows)[:, None]
    return np.stack([radii * np.sin(angle), radii * np.cos(angle)], axis=-1), radii


def test_a_straight_line_through_an_arc_lies_a_sixth_of_curvature_times_radius_squared_inside():
    xy, radii = arcs()
    shift = bend_shift(xy, RADIUS)
    inwards = -(shift * xy).sum(axis=2) / radii
    expected = RADIUS**2 / 6 / np.broadcast_to(radii, inwards.shape)
    np.testing.assert_allclose(inwards, expected, rtol=0.02)  # parabolas are not quite arcs
    assert np.abs(np.linalg.norm(shift, axis=2) - inwards).max() < 1e-3


def test_sigma_holds_for_raw_positions_of_bent_cells():
    cell, middle = 12.0, (200.3, 89.8)
    radius = 149.8 - middle[1]

    def polar(x, y):
        x, y = x - middle[0], y - middle[1]
        return np.hypot(x, y) / cell, np.arctan2(x, y) * radius / cell + 0.4

    view = boards.drawn(polar, (300, 400), blur=0.8, count=3)
    grid = build_grid(detect(view.image), view.image)
    inside = np.abs(grid.xy - (199.5, 149.5)) < np.array([199.5, 149.5]) - grid.edge_radius
    inside = inside.all(axis=2) & np.isin(grid.status, MEASURED)
    error = np.abs(from_nearest(grid.xy[inside], view.corners[:, :2]))
    assert len(error) > 50
    assert np.mean(error < 2 * grid.sigma[inside, None]) > 0.9
    by_image = grid.image_sigma[inside]
    assert np.median(by_image) < np.median(grid.sigma[inside]) / 1.5  # without the shift
    assert np.mean(error < 2 * by_image[:, None]) < 0.6


@pytest.fixture(scope="module")
def pressed():
    """Return the grids of a perfect print at rest and pressed, and the true pressed positions."""
    scene = random_scene(
        970_001,
        markers=40,
        severity=1.0,
        corrosion=0.0,
        indenter=Indenter.TORUS,
        mode=Mode.TWIST,
    )
    still, shown = render(scene.at_rest()), render(scene)
    with Detector(shape=scene.shape, config=DetectorConfig.for_cell(still.cell)) as detector:
        rest = detector.grid(still.image, shape=(40, 40))[1]
        now = detector.grid(shown.image, like=rest)[1]
    rotated = [np.rot90(shown.truth.reshape(40, 40, 2), k) for k in range(4)]
    return rest, now, min(rotated, key=lambda truth: np.nanmedian(np.abs(now.xy - truth)))


def test_the_error_of_filtered_positions_on_a_bent_perfect_print_is_a_third_lower(pressed):
    _, now, truth = pressed
    shifted = filter_positions(dataclasses.replace(now, edge_radius=math.nan))
    better = filter_positions(now)
    assert rms(better.xy - truth) < 0.67 * rms(shifted.xy - truth)


def test_sigma_holds_for_positions_on_a_perfect_print(pressed):
    _, now, truth = pressed
    found = filter_positions(now)
    within = np.abs(found.xy - truth) <= 2 * found.sigma[..., None]
    assert 0.9 <= within.mean() <= 0.98  # 0.95 of normal errors


def test_points_in_space_contain_the_shift_and_displacements_are_free_of_it():
    rig = toed_in_rig()
    flat, bulged = (gel(18, 19, depth) for depth in (0.0, 3.0))
    rest, now = (
        [dataclasses.replace(grid_of(each), edge_radius=RADIUS) for each in project(rig, xyz)]
        for xyz in (flat, bulged)
    )
    shifted = [(grid.xy - bend_shift(grid.xy, RADIUS)).astype(np.float32) for grid in now]
    straight = [
        dataclasses.replace(grid, xy=xy, edge_radius=math.nan)
        for grid, xy in zip(now, shifted, strict=True)
    ]
    at_rest, points, moved = (rig.triangulate(*pair) for pair in (rest, now, straight))
    assert np.abs(points.bend_shift).max() > 1e-3
    np.testing.assert_allclose(points.xyz - moved.xyz, points.bend_shift, atol=2e-4)
    field = displacement(at_rest, points)
    blind = displacement(
        *(dataclasses.replace(each, bend_shift=None) for each in (at_rest, points))
    )
    np.testing.assert_allclose(
        blind.displacement - field.displacement, points.bend_shift - at_rest.bend_shift, atol=1e-6
    )
    np.testing.assert_array_equal(field.raw.displacement, blind.raw.displacement)
