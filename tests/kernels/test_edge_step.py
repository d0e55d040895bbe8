"""kernels/edge_step.cl and kernels/cpu/edge_step.cl: both forms of EdgeStep equal the oracle."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal
from configs import rings
from corner_images import board

from cmp_cl import EdgeStep, Method, reference
from cmp_cl.stages.moments import moments
from cmp_cl.stages.refine import CORRELATION, METHOD, RESULT_FIELDS, RESULT_HEAD


@pytest.mark.parametrize("cell", some([4.0, 6.7, 10.0, 30.0], (6.7, 30.0)))
def test_the_cell_sets_the_radius(detector_in_form, cell):
    image = images.scene(1.0, seed=5).image
    detector = detector_in_form(image, rings(refinement=EdgeStep(cell=cell)))
    corners = assert_corners_equal(detector, image)
    assert (corners.method == Method.EDGE_STEP).sum() > 20


def test_corners_between_saturated_cells_are_refined_as_in_the_oracle(detector_in_form):
    """Nearly all grey levels are 0 or 255."""
    grey = (images.eight_bits()["board"].astype(np.float64) - 120) * 20 + 120
    image = np.clip(grey, 0, 255).astype(np.uint8)
    detector = detector_in_form(image, rings(refinement=EdgeStep()))
    assert_corners_equal(detector, image)


@pytest.mark.parametrize("depth", [8, 16])
def test_soft_corners_are_refined_as_in_the_oracle(detector_in_form, depth):
    image = board(121, 83, 12)[0]
    if depth == 16:
        image = image.astype(np.uint16) * 257
    detector = detector_in_form(image, rings(refinement=EdgeStep()))
    corners = assert_corners_equal(detector, image)
    assert (corners.method == Method.EDGE_STEP).sum() > 20


def test_corners_in_light_that_grows_steeply_are_refined_as_in_the_oracle(detector_in_form):
    """Grey levels grow tenfold over the image, by far more than noise."""
    image = board(121, 83, 12)[0]
    image = (image * np.geomspace(0.1, 1.0, image.shape[1])).astype(np.uint8)
    detector = detector_in_form(image, rings(refinement=EdgeStep(cell=12)))
    corners = assert_corners_equal(detector, image)
    assert (corners.method == Method.EDGE_STEP).sum() > 20


@pytest.mark.parametrize("cell", some([20.0, 60.0, 130.0], (60.0,)))
def test_discs_of_a_scaled_image_equal_the_oracle(detector_in_form, cell):
    """Discs have a radius of 0.6 cells: one part, or several; some leave the image."""
    image = board(int(4 * cell), int(5 * cell), cell)[0]
    config = {"scale": 15 / cell, "refinement": EdgeStep(cell=cell)}
    detector = detector_in_form(image, rings(**config))
    corners = assert_corners_equal(detector, image)
    stepped = corners.xy[corners.method == Method.EDGE_STEP]
    distance = np.minimum(stepped, np.array(image.shape[::-1]) - 1 - stepped).min(axis=1)
    assert (distance < 0.6 * cell).any()
    assert (distance > 0.6 * cell).any()


@pytest.mark.parametrize("radius", [4.5, 6.45, 9.0, 40.0])
def test_the_table_of_moments_holds_the_integrals_of_the_model(radius):
    """The integrals hold at the angles of the table, and between them by linear interpolation."""
    table = moments(radius).astype(np.float64)
    place = np.array([9.0, 20.0, 31.5, 40.5, 55.0]) * (len(table) // 64)
    below = place.astype(int)
    between = (table[below] + table[np.ceil(place).astype(int)]) / 2
    half = np.arcsin((2 * place / (len(table) - 1) - 1) / np.sqrt(2)) + np.pi / 4
    half = np.stack([np.cos(half), np.sin(half)], axis=1)
    exact = reference.edge_step.moments(half, radius)
    exact[..., 0] /= half**4
    exact[..., 1:3] /= half[..., None] ** 2
    slope, place = np.sqrt(exact[..., 0]), np.sqrt(exact[..., 3])
    size = np.stack([slope * slope, *2 * [slope * place], *3 * [place * place]], axis=-1)
    assert (np.abs(between[..., :6] - exact) < 0.002 * size).all()


def test_a_rejected_step_has_no_autocorrelation(detector_in_form):
    """The median that shows which corners are doubtful is that of the accepted steps."""
    image = images.texture((120, 150), seed=9)
    detector = detector_in_form(image, rings(refinement=EdgeStep(), contrast=None))
    count = len(detector(image))
    numbers = detector._plans.lend().read(detector._queue)[0, RESULT_HEAD:]
    fields = numbers[: RESULT_FIELDS * -(-count // 8) * 8].reshape(RESULT_FIELDS, -1)
    accepted = fields[METHOD].view(np.uint8)[:count] == Method.EDGE_STEP
    assert 0 < accepted.sum() < count
    np.testing.assert_array_equal(accepted, fields[CORRELATION, :count] > -np.inf)
