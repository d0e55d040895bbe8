"""The adjustment of a calibration: its derivatives, its units, and the weights of nodes."""

import cv2
import numpy as np
import pytest
from stereo_data import grid_of, project, toed_in_rig

from cmp_cl import calibrate, calibrate_camera
from cmp_cl.space.adjustment import misfit
from cmp_cl.space.lens import Lens, camera_of, projected

SQUARE = 3.0


@pytest.mark.parametrize("extra", [0.0, 0.01, 4.0])
def test_the_misfit_is_what_the_residuals_have_beyond_their_nodes(extra):
    draw = np.random.default_rng(0)
    variance = draw.uniform(0.001, 0.1, 20_000)
    off = draw.normal(size=(20_000, 2)) * np.sqrt(variance + extra)[:, None]
    found = misfit(np.square(off).sum(axis=1), variance, 40_000)
    # A variance from 40 000 residuals has a standard error of 0.7 %.
    assert found == pytest.approx(extra, rel=0.03, abs=3e-4)


def test_residuals_smaller_than_their_nodes_allow_show_no_misfit():
    assert misfit(np.full(50, 0.5), np.ones(50), 100) == 0
    assert misfit(np.zeros(50), np.ones(50), 100) == 0


@pytest.mark.parametrize("lens", list(Lens))
def test_the_derivatives_of_a_projection_are_its_differences(lens):
    draw = np.random.default_rng(0)
    points = draw.uniform([-15, -15, 40], [15, 15, 60], (20, 3))
    matrix = np.array([[900.0, 0, 400], [0, 910, 300], [0, 0, 1]])
    rotation = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0]
    distortion = draw.uniform(-0.02, 0.02, lens.coefficients)
    camera = camera_of(matrix, distortion, rotation, np.array([1.0, -2, 3]))
    found = projected(lens, points, camera)[1]
    for parameter, slopes in enumerate(np.moveaxis(found, 2, 0)):
        step = np.zeros(len(camera))
        step[parameter] = 1e-5
        more, less = (projected(lens, points, camera + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose(slopes, (more - less) / 2e-5, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(unit, free):
    draw = np.random.default_rng(3)
    views = []
    for _ in range(6):
        rotation = cv2.Rodrigues(draw.uniform(-0.5, 0.5, 3))[0]
        seen = project(toed_in_rig(), flat_board() @ rotation.T + [0, 0, draw.uniform(44, 56)])
        views.append([grid_of(each + draw.normal(0, 0.05, each.shape), 0.05) for each in seen])
    one, other = (
        calibrate(views, spacing=SQUARE * each, image_size=(800, 1200), free_board=free)
        for each in (1, unit)
    )
    factor = np.ones(22)
    factor[19:] = unit
    np.testing.assert_allclose(other.rig.K1, one.rig.K1, rtol=1e-6)
    np.testing.assert_allclose(other.rig.T, one.rig.T * unit, rtol=1e-5)
    assert other.error == pytest.approx(one.error, rel=1e-6)
    deviations = (np.sqrt(np.diag(found.rig.covariance)) for found in (other, one))
    np.testing.assert_allclose(next(deviations), next(deviations) * factor, rtol=1e-3)


def flat_board():
    row, column = np.indices((7, 10))
    return np.stack([column - 4.5, row - 3.0, np.zeros((7, 10))], axis=-1) * SQUARE


def views_of_board(draw, printing_error):
    """Return views of a printed board, each node with a sigma of its own."""
    row, column = np.indices((7, 9))
    board = np.stack([column - 4.0, row - 3.0, np.zeros((7, 9))], axis=-1) * SQUARE
    board += draw.normal(0, printing_error, board.shape)
    views = []
    for _ in range(4):
        rotation = cv2.Rodrigues(draw.uniform(-0.5, 0.5, 3))[0]
        place = board @ rotation.T + [*draw.uniform(-3, 3, 2), 50 + draw.uniform(-6, 6)]
        sigma = 0.04 * np.exp(draw.normal(0, 0.7, (7, 9)))
        seen = project(toed_in_rig(), place)[0]
        views.append(grid_of(seen + draw.normal(size=seen.shape) * sigma[..., None], sigma))
    return views


@pytest.mark.parametrize(("printing_error", "least", "most"), [(0.0, 0.0, 0.7), (0.03, 0.8, 1.1)])
def test_sigma_decides_where_the_print_is_exact_and_hardly_where_it_is_not(
    printing_error, least, most
):
    """The ratio is the error of the focal length with the sigma of each node over that without."""
    off = {True: [], False: []}
    for seed in range(16):
        views = views_of_board(np.random.default_rng(seed), printing_error)
        for told in off:
            grids = views if told else [grid_of(view.xy) for view in views]
            camera = calibrate_camera(grids, spacing=SQUARE, image_size=(800, 1200))
            off[told].append(camera.matrix[0, 0] - toed_in_rig().K1[0, 0])
    ratio = np.linalg.norm(off[True]) / np.linalg.norm(off[False])
    assert least < ratio < most
