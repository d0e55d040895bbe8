"""kernels/edge_step_eight.cl: both forms of the step are held to the same oracle."""

import dataclasses

import images
import numpy as np
import pytest
from comparison import assert_corners_equal
from configs import rings
from corner_images import board

from cmp_cl import Detector, DeviceKind, EdgeLines, EdgeStep, Method

KINDS = pytest.mark.parametrize(
    "kind", [DeviceKind.CPU, DeviceKind.GPU], ids=lambda kind: kind.value
)


def detector_of_kind(device, kind, image, **settings):
    form = dataclasses.replace(device, kind=kind)
    config = rings(**settings)
    return Detector(shape=image.shape, dtype=image.dtype, config=config, device=form)


@pytest.mark.parametrize(
    ("kind", "changes", "taken"),
    [
        (DeviceKind.CPU, {"refinement": EdgeStep()}, {"edge_step_eight"}),
        (DeviceKind.GPU, {"refinement": EdgeStep()}, {"edge_step"}),
        (DeviceKind.CPU, {"refinement": EdgeStep(), "scale": 0.63}, {"edge_step_eight"}),
        (DeviceKind.GPU, {"refinement": EdgeStep(), "scale": 0.63}, {"edge_step"}),
        (DeviceKind.CPU, {"refinement": EdgeLines()}, set()),
    ],
)
def test_which_form_is_taken(device, kind, changes, taken):
    image = images.eight_bits()["board"]
    with detector_of_kind(device, kind, image, **changes) as detector:
        launched = {launch.stage for launch in detector._plan(changes.get("scale")).launches}
    assert launched & {"edge_step", "edge_step_eight"} == taken


@KINDS
@pytest.mark.parametrize("cell", [4.0, 6.7, 8.0, 10.0, 12.0, 30.0])
def test_the_cell_sets_the_radius(device, kind, cell):
    image = images.scene(1.0, seed=5).image
    with detector_of_kind(device, kind, image, refinement=EdgeStep(cell=cell)) as detector:
        corners = assert_corners_equal(detector, image)
    assert (corners.method == Method.EDGE_STEP).sum() > 20


@KINDS
def test_a_corner_in_the_very_middle_of_a_pixel(device, kind):
    """That pixel's weight is 0, but the pair it makes with the one before counts."""
    grey = (images.eight_bits()["board"].astype(np.float64) - 120) * 20 + 120
    image = np.clip(grey, 0, 255).astype(np.uint8)
    with detector_of_kind(device, kind, image, refinement=EdgeStep()) as detector:
        assert_corners_equal(detector, image)


@KINDS
@pytest.mark.parametrize("depth", [8, 16])
def test_soft_corners(device, kind, depth):
    image = board(121, 83, 12)[0]
    if depth == 16:
        image = image.astype(np.uint16) * 257
    with detector_of_kind(device, kind, image, refinement=EdgeStep()) as detector:
        corners = assert_corners_equal(detector, image)
    assert (corners.method == Method.EDGE_STEP).sum() > 20


@KINDS
@pytest.mark.parametrize("cell", [20.0, 60.0, 130.0])
def test_discs_of_a_scaled_image(device, kind, cell):
    """Of a radius of 0.6 cells: in one part, in several, and with rows that leave the image."""
    image = board(int(4 * cell), int(5 * cell), cell)[0]
    config = {"scale": 15 / cell, "refinement": EdgeStep(cell=cell)}
    with detector_of_kind(device, kind, image, **config) as detector:
        corners = assert_corners_equal(detector, image)
    stepped = corners.xy[corners.method == Method.EDGE_STEP]
    distance = np.minimum(stepped, np.array(image.shape[::-1]) - 1 - stepped).min(axis=1)
    assert (distance < 0.6 * cell).any()
    assert (distance > 0.6 * cell).any()
