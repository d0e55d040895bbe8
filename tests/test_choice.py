"""Settings that are chosen by the corners that they find in an image."""

import cv2
import numpy as np
import pytest
from corner_images import board

import cmp_cl
from cmp_cl import DetectorConfig, EdgeStep, reference

TOP, LEFT = 70, 110


def before_rings(width, blur):
    """Return a board of cells of 8.5 px in front of black and white rings of that width, px, and
    its corners. A white margin keeps the rings off the board."""
    rows, columns = np.indices((240, 320))
    distance = np.hypot(rows - 120, columns - 160)
    image = np.where(distance % (2 * width) < width, 200, 30).astype(np.uint8)
    if blur:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    part, truth = board(80, 100, 8.5)
    image[TOP - 8 : TOP + 88, LEFT - 8 : LEFT + 108] = part.max()
    image[TOP : TOP + 80, LEFT : LEFT + 100] = part
    return image, truth + np.array([LEFT, TOP])


def errors(image, truth, config, device):
    """Return the distance of each true corner to the nearest one found, px, 9 if none is near."""
    xy = cmp_cl.detect(image, config, device).xy
    return np.linalg.norm(xy[:, None] - truth, axis=2).min(axis=0, initial=9)


def test_a_small_board_in_front_of_wide_shapes_is_found(device):
    image, truth = before_rings(100, 3)
    assert errors(image, truth, DetectorConfig.for_image(image), device).max() > 2
    assert cmp_cl.choose_config(image, device=device) == DetectorConfig()
    assert errors(image, truth, None, device).max() < 0.05


def test_the_oracle_without_settings_chooses_the_same(device):
    image, _ = before_rings(100, 3)
    chosen = cmp_cl.choose_config(image, device=device)
    estimated = DetectorConfig.for_image(image)
    found, told, other = (reference.detect(image, each) for each in (None, chosen, estimated))
    np.testing.assert_array_equal(found.xy, told.xy)
    assert len(found) != len(other)
    np.testing.assert_array_equal(
        reference.maps(image).coarse, reference.maps(image, chosen).coarse
    )


def test_corners_nearer_than_the_estimated_cell_are_refined_with_their_own_cell(device):
    image, truth = before_rings(40, 0)
    estimated = DetectorConfig.for_image(image)
    chosen = cmp_cl.choose_config(image, device=device)
    assert chosen == estimated.replace(refinement=EdgeStep(cell=chosen.refinement.cell))
    assert chosen.refinement.cell <= 9 < estimated.refinement.cell
    assert errors(image, truth, None, device).max() < 0.05
    assert errors(image, truth, estimated, device).max() > 0.1


@pytest.mark.parametrize(("cell", "blur"), [(10, 0.7), (30, 0.7), (60, 3)])
def test_on_a_pattern_that_fills_the_image_the_estimate_is_used(device, cell, blur):
    image, _ = board(240, 320, cell, blur=blur, samples=3)
    assert cmp_cl.choose_config(image, device=device) == DetectorConfig.for_image(image)


def test_an_image_without_corners_has_settings_too(device):
    flat = np.full((60, 70), 100, np.uint16)
    chosen = cmp_cl.choose_config(flat, full_scale=1023, device=device)
    assert chosen == DetectorConfig.for_image(flat).replace(full_scale=1023)


def test_an_image_with_a_single_corner_is_searched_without_a_warning(device):
    image = np.full((60, 60), 200, np.uint8)
    image[:30, :30] = image[30:, 30:] = 40
    assert len(cmp_cl.detect(image, device=device)) == 1
