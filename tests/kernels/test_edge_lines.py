"""kernels/edge_lines.cl and kernels/cpu/edge_lines.cl: one corner at a time, and eight."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_same_bytes
from configs import rings
from corner_images import board
from forms import in_form

from cmp_cl import (
    Detector,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Midlines,
    RapidCriteria,
    RingHarmonic,
    SpectralCriteria,
)
from cmp_cl.stages.form import Form

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
WIDE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
DENSE = {"contrast": None, "nms_radius": 1, "criteria": WIDE}

LINES = pytest.mark.parametrize(
    "refinement", [EdgeLines(), EdgeStep()], ids=lambda refinement: type(refinement).__name__
)


def detector_of_form(device, image, mask=None, **settings):
    config = rings(**settings)
    return Detector(shape=image.shape, dtype=image.dtype, config=config, device=device, mask=mask)


@pytest.mark.parametrize("scale", [None, 0.63])
@pytest.mark.parametrize(
    "rule",
    [rings(), DetectorConfig(detection=RingHarmonic(octaves=0))],
    ids=["rings", "harmonic"],
)
def test_refinement_launches_the_kernels_of_the_form_of_the_device(
    detector_in_form, form, rule, scale
):
    image = EIGHT["board"]
    for refinement, kernels in (
        (EdgeLines(), {"edge_lines"}),
        (EdgeStep(), {"edge_step"}),
        (Midlines(), set()),
        (None, set()),
    ):
        detector = detector_in_form(image, rule.replace(refinement=refinement, scale=scale))
        launched = {launch.stage for launch in detector._plans.lend().launches}
        expected = {f"{name}_eight" for name in kernels} if form is Form.CPU else kernels
        all_forms = {"edge_lines", "edge_step", "edge_lines_eight", "edge_step_eight"}
        assert launched & all_forms == expected


@LINES
def test_every_number_of_corners_equals_the_oracle(device_in_form, refinement):
    """A mask leaves that many corners, so that the last vector of eight is full or not."""
    image = images.texture((120, 150), seed=9)
    with detector_of_form(device_in_form, image, refinement=refinement) as detector:
        whole = assert_corners_equal(detector, image)
    assert len(whole) > 40
    for count in (1, 7, 8, 9, 16):
        mask = np.zeros(image.shape, np.bool_)
        mask[tuple(whole.pixel[:count, ::-1].T)] = True
        with detector_of_form(
            device_in_form, image, mask, refinement=refinement, contrast=None
        ) as detector:
            found = assert_corners_equal(detector, image, mask=mask)
            assert len(found) == count
            flipped = image[::-1].copy()
            both = detector.batch([image, flipped, image])
            for one, alone in zip(both, (found, detector(flipped), found), strict=True):
                assert_same_bytes(one, alone)


@LINES
@pytest.mark.exhaustive
@pytest.mark.parametrize("depth", [8, 16])
def test_both_forms_give_the_oracles_corners(device_in_form, refinement, depth):
    inputs = EIGHT if depth == 8 else DEEP
    changes = {} if depth == 8 else {"full_scale": 4095}
    first = next(iter(inputs.values()))
    with (
        detector_of_form(device_in_form, first, refinement=refinement, **changes) as plain,
        detector_of_form(device_in_form, first, refinement=refinement, **changes, **DENSE) as noisy,
    ):
        for image in inputs.values():
            assert_corners_equal(plain, image)
            assert_corners_equal(noisy, image)


@LINES
@pytest.mark.parametrize("shape", some([(1, 31), (31, 1), (2, 3), (9, 40), (40, 9)], ((9, 40),)))
def test_images_smaller_than_the_rings_equal_the_oracle(device_in_form, refinement, shape):
    image = images.texture((60, 60))[: shape[0], : shape[1]].copy()
    with detector_of_form(device_in_form, image, refinement=refinement, **DENSE) as detector:
        assert_corners_equal(detector, image)


@pytest.mark.parametrize("factor", some([0.2, 0.63, 2.0], (0.63,)))
@pytest.mark.parametrize("depth", [8, 16])
def test_rings_that_leave_a_scaled_image_equal_the_oracle(device_in_form, factor, depth):
    """Corners lie everywhere, so that some, all or none of the rings in a vector are inside."""
    cell = 12 / factor
    image = board(int(8 * cell), int(9 * cell), cell)[0]
    image += np.random.default_rng(1).integers(0, 20, image.shape, dtype=np.uint8)
    if depth == 16:
        image = image.astype(np.uint16) * 16
    changes = {"contrast": None, "nms_radius": 1, "full_scale": 255 if depth == 8 else 4095}
    for refinement in (EdgeLines(), EdgeStep(cell=cell)):
        with detector_of_form(
            device_in_form, image, scale=factor, refinement=refinement, **changes
        ) as detector:
            found = assert_corners_equal(detector, image)
        reach = 5 / factor + 1
        distance = np.minimum(found.pixel, np.array(image.shape[::-1]) - 1 - found.pixel).min(1)
        assert (distance < reach).sum() > 5
        assert (distance > reach).sum() > 8


@pytest.mark.parametrize("factor", some([0.3, 0.63, 1.5], (1.5,)))
def test_the_forms_agree_to_the_bit_on_a_scaled_image(device, factor):
    image = images.texture((240, 300), seed=4)
    changes = {**DENSE, "scale": factor, "refinement": EdgeLines()}
    results = []
    for form in Form:
        with detector_of_form(in_form(device, form), image, **changes) as detector:
            results.append(detector(image))
    assert len(results[0]) > 20
    assert_same_bytes(*results)


@LINES
def test_the_largest_responses_do_not_overflow(device_in_form, refinement):
    """Those of the spectral criteria, and the largest ones of the rapid criteria."""
    image = EIGHT["texture"]
    for changes in (
        {"criteria": SpectralCriteria(correlation=0), "contrast": None},
        {"criteria": RapidCriteria(sector_threshold=16)},
    ):
        with detector_of_form(device_in_form, image, refinement=refinement, **changes) as detector:
            assert len(assert_corners_equal(detector, image)) > 5
