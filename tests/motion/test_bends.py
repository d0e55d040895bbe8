"""The shift of corners by bent edges: the lattice shows it, and filtered values are free of it."""

import dataclasses
import math

import numpy as np
import pytest
from stereo_data import gel, grid_of, project, rms, toed_in_rig

from cmp_cl import Detector, DetectorConfig, EdgeStep, RingHarmonic
from cmp_cl.filter import bend_shift
from cmp_cl.grid import build_grid
from cmp_cl.grid.grid import MEASURED
from cmp_cl.motion import displacement, filter_positions
from cmp_cl.reference import detect
from cmp_cl.reference.field import filter as lattice_filter
from cmp_cl.synthetic import Indenter, Mode, boards, random_scene, render

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


@pytest.mark.parametrize("shape", [(7, 9), (4, 9), (3, 3)])
def test_the_fast_form_of_the_shift_equals_the_oracle(shape):
    xy = arcs(*shape)[0] + np.random.default_rng(0).normal(0, 0.3, (*shape, 2))
    expected = lattice_filter.bend_shift(xy, RADIUS)
    np.testing.assert_allclose(bend_shift(xy, RADIUS), expected, atol=1e-9)


WIDE = DetectorConfig(
    detection=RingHarmonic(fine=False, octaves=0), refinement=EdgeStep(cell=40), scale=0.6
)


@pytest.mark.parametrize(
    ("cell", "middle", "blur", "config"),
    [(12.0, (200.3, 89.8), 0.8, None), (40.0, (200.3, -150.2), 2.5, WIDE)],
)
def test_sigma_holds_for_raw_positions_of_bent_cells(cell, middle, blur, config):
    radius = 149.8 - middle[1]

    def polar(x, y):
        x, y = x - middle[0], y - middle[1]
        return np.hypot(x, y) / cell, np.arctan2(x, y) * radius / cell + 0.4

    view = boards.drawn(polar, (300, 400), blur=blur, count=3)
    grid = build_grid(detect(view.image, config), view.image)
    inside = np.abs(grid.xy - (199.5, 149.5)) < np.array([199.5, 149.5]) - grid.edge_radius
    inside = inside.all(axis=2) & np.isin(grid.status, MEASURED)
    away = grid.xy[inside][:, None] - view.corners[:, :2]
    error = np.abs(away[np.arange(len(away)), np.linalg.norm(away, axis=2).argmin(axis=1)])
    assert len(error) > 50
    assert np.mean(error < 2 * grid.sigma[inside, None]) > 0.9
    by_image = grid.image_sigma[inside]
    assert np.median(by_image) < np.median(grid.sigma[inside]) / 1.5  # without the shift
    assert config is WIDE or np.mean(error < 2 * by_image[:, None]) < 0.6


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
    flat = gel(depth=0.0)
    bulged = gel(depth=3.0)
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
