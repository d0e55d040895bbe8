"""The kernels of refinement equal the oracle: both forms of each, at every kind of corner.

edge_lines, edge_step (one corner at a time, and eight), midlines, centroid, centroids.
"""

import functools

import images
import numpy as np
import pytest
from cases import some
from comparison import POSITION, assert_corners_equal, assert_same_bytes
from configs import ANY_RINGS, rings
from corner_images import board, corner, from_nearest, grain, to_nearest
from detectors import FORMS, in_form

from cmp_cl import (
    Detector,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Method,
    Midlines,
    detect,
    reference,
)
from cmp_cl.corners import Refusal
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.synthetic import boards

EIGHT, DEEP = images.eight_bits(), images.sixteen_bits()
DENSE = {"contrast": None, "nms_radius": 1, "criteria": ANY_RINGS}
REFINEMENTS = {  # and the method of a corner that is not refused
    "centroid": (None, Method.CENTROID),
    "edge lines": (EdgeLines(), Method.EDGE_LINES),
    "edge step": (EdgeStep(), Method.EDGE_STEP),
    "wide disc": (EdgeStep(cell=30.0), Method.EDGE_STEP),
    "midlines": (Midlines(), Method.MIDLINE),
    "quadratic midlines": (Midlines(fit=Fit.QUADRATIC), Method.MIDLINE),
}
refinements = pytest.mark.parametrize("name", REFINEMENTS)


SOFT = board(121, 83, 12)[0]
GREY = SOFT.astype(np.float64)
NOISY = GREY + np.random.default_rng(0).normal(0, 25, GREY.shape)
EDGE = np.ascontiguousarray(np.tile(corner(20, 20, 0.35), 2)[19:])
Y, X = np.indices(images.SHAPE)
PICTURES = {  # one for each way in which corners can be hard
    "worn scene": images.scene(1.5, seed=3).image,
    "soft": SOFT,
    "noisy": np.clip(np.rint(NOISY), 0, 255).astype(np.uint8),
    "saturated": np.clip((GREY - 120) * 20 + 120, 0, 255).astype(np.uint8),
    "steep light": (GREY * np.geomspace(0.1, 1, 83)).astype(np.uint8),
    "perfect": np.where((X // 12 + Y // 12) % 2 == 0, 40, 200).astype(np.uint8),
    "at the edge": EDGE,
    "at the side": np.ascontiguousarray(EDGE.T),
    "12 bits": DEEP["12-bit scene"],
}
SOME = "worn scene", "saturated", "at the edge", "12 bits"


@refinements
@pytest.mark.parametrize("kind", some(PICTURES, SOME))
def test_positions_are_the_oracles(detector_in_form, name, kind):
    image = PICTURES[kind]
    full_scale = 4095 if kind == "12 bits" else None
    config = rings(refinement=REFINEMENTS[name][0], full_scale=full_scale)
    corners = assert_corners_equal(detector_in_form(image, config), image)
    assert len(corners) > 0
    assert np.isfinite(corners.xy).all()


@refinements
def test_most_maxima_in_texture_are_refused_for_the_oracles_reasons(detector_in_form, name):
    image = np.vstack([images.texture((400, 83)), EIGHT["noise"], EIGHT["worn scene"]])
    config = rings(refinement=REFINEMENTS[name][0], **DENSE)
    corners = assert_corners_equal(detector_in_form(image, config), image)
    assert len(corners) > 500
    refused = corners.refusal != Refusal.NONE
    assert np.array_equal(refused, corners.method != REFINEMENTS[name][1])
    reasons = set(Refusal) - {Refusal.FLAT, Refusal.NONE}
    if "midlines" in name:
        reasons -= {Refusal.RESIDUAL}
    seen = {Refusal(each) for each in corners.refusal[refused]} - {Refusal.FLAT}
    assert seen == (set() if name == "centroid" else reasons)
    if name != "centroid":
        assert np.array_equal(np.isnan(corners.sigma), corners.method == Method.KEPT) or (
            "midlines" in name
        )


@pytest.mark.parametrize("name", ["edge lines", "edge step"])
def test_every_number_of_corners_equals_the_oracle(device_in_form, name):
    """A mask leaves that many corners, so that the last vector of eight is full or not."""
    image = images.texture((120, 150), seed=9)
    config = rings(refinement=REFINEMENTS[name][0], contrast=None)
    with Detector(shape=image.shape, config=config, device=device_in_form) as detector:
        whole = detector(image)
    flipped = image[::-1].copy()
    for count in (1, 7, 8, 9, 16):
        mask = np.zeros(image.shape, np.bool_)
        mask[tuple(whole.pixel[:count, ::-1].T)] = True
        with Detector(
            shape=image.shape, config=config, device=device_in_form, mask=mask
        ) as detector:
            found = assert_corners_equal(detector, image, mask=mask)
            assert len(found) == count
            both = detector.batch([image, flipped, image])
            for one, alone in zip(both, (found, detector(flipped), found), strict=True):
                assert_same_bytes(one, alone)


@pytest.mark.parametrize("name", ["centroid", "edge lines", "edge step"])
@pytest.mark.parametrize("shape", some([(1, 31), (31, 1), (2, 3), (9, 40), (40, 9)], ((9, 40),)))
def test_images_smaller_than_the_rings_equal_the_oracle(detector_in_form, name, shape):
    image = images.texture((60, 60))[: shape[0], : shape[1]].copy()
    detector = detector_in_form(image, rings(refinement=REFINEMENTS[name][0], **DENSE))
    assert_corners_equal(detector, image)


def test_the_forms_agree_to_the_bit(device):
    """Cards have one form; what runs there of the other may fuse other products with sums."""
    if device.kind is not DeviceKind.CPU:
        pytest.skip("cards have one form")
    image = images.texture((240, 300), seed=4)
    for refinement in (EdgeLines(), None):
        config = rings(refinement=refinement, **DENSE)
        results = []
        for form in FORMS:
            with Detector(
                shape=image.shape, config=config, device=in_form(device, form)
            ) as detector:
                results.append(detector(image))
        assert len(results[0]) > 20
        assert_same_bytes(*results)


def test_a_disc_whose_middle_lies_between_two_pixels_equals_the_oracle(detector_in_form):
    """Nearly: rounding near 1024 in float32 took the other one; sigma was 0.05, not 1.24 px."""
    rng = np.random.default_rng(1199)
    noisy = board(400, 400, 9)[0] // 2 + rng.normal(60, 25, (400, 400))
    image = np.clip(noisy[88:169, 260:341], 0, 255).astype(np.uint8)
    assert_corners_equal(
        detector_in_form(image, DetectorConfig(refinement=EdgeStep(cell=8))), image
    )


@pytest.mark.parametrize("cell", [8.0, 12.0])
def test_discs_that_leave_the_image_equal_the_oracle(detector_in_form, cell):
    """Discs have a radius of .75 cells."""
    image = board(int(4 * cell), int(5 * cell), cell)[0]
    config = rings(refinement=EdgeStep(cell=cell))
    corners = assert_corners_equal(detector_in_form(image, config), image)
    stepped = corners.xy[corners.method == Method.EDGE_STEP]
    distance = np.minimum(stepped, np.array(image.shape[::-1]) - 1 - stepped).min(axis=1)
    assert (distance < 0.75 * cell).any()
    assert (distance > 0.75 * cell).any()


@pytest.mark.parametrize("turn", [20, 30, 40])
def test_what_lies_outside_the_image_does_not_bend_the_edges_at_its_border(device, turn):
    view = boards.drawn(boards.plane(cell=17, middle=(130, 100), turn=turn), (200, 260), seed=1)
    corners = detect(view.image, device=device)
    off = from_nearest(corners.xy, view.corners[:, :2])
    truth = corners.xy - off
    inside = np.minimum(truth, [259, 199] - truth).min(axis=1)  # px from the border
    near = (inside > 2) & (inside < 4.5)
    assert near.sum() >= 5
    assert np.sqrt(np.mean(off[near] ** 2)) < 0.1  # px
    assert np.isfinite(corners.sigma[near]).all()


@pytest.mark.parametrize("name", ["edge step", "edge lines", "midlines"])
@pytest.mark.parametrize("columns", some([4000, 16000], (4000,)))
def test_far_columns_are_equally_exact(detector_for, name, columns):
    """If columns are added on the left, corners move by their number, up to float32's spacing."""
    image = board(*images.SHAPE, 12)[0]
    added = columns - images.SHAPE[1]
    wide = np.pad(image, ((0, 0), (added, 0)), mode="edge")
    config = rings(refinement=REFINEMENTS[name][0])
    near, far = reference.detect(image, config), detector_for(wide, config)(wide)
    clear, same = near.pixel[:, 0] > 20, far.pixel[:, 0] > added + 20
    np.testing.assert_array_equal(far.pixel[same], near.pixel[clear] + [added, 0])
    rounding = np.spacing(np.float32(columns)) / 2
    moved = far.xy[same].astype(np.float64) - [added, 0]
    np.testing.assert_allclose(moved, near.xy[clear], rtol=0, atol=rounding + POSITION / 10)


def enlarged(factor):
    """Edges in steps of whole pixels move the corners; the noise of the image does not tell."""
    image, truth = board(180, 240, 20)
    image = image.repeat(factor, axis=0).repeat(factor, axis=1)
    return image, (truth + 0.5) * factor - 0.5


def grainy(smooth):
    """Noise moves a corner by much more than its differences from pixel to pixel tell."""
    image, truth = board(300, 400, 20)
    grey = 30 + 0.7 * image + 8 * grain(image.shape, smooth, 5)
    return np.clip(grey, 0, 255).astype(np.uint8), truth


def sharp(noise):
    """Edges sharper than the model's leave a residual, but move no corner."""
    image, truth = board(300, 400, 20)
    grey = 30.5 + 0.7 * image + noise * grain(image.shape, 0.01, 5)
    return np.clip(grey, 0, 255).astype(np.uint8), truth


@pytest.mark.parametrize(
    ("make", "amounts", "within", "count", "median"),
    [
        (enlarged, (2, 3), 6, 40, np.inf),
        (grainy, (0.01, 1, 2), 3, 150, 2.5),
        (sharp, (0.5, 1, 2), 1, 150, 3),
    ],
)
def test_two_sigma_cover_the_error(detector_for, make, amounts, within, count, median):
    """Where every pixel is repeated, in noise that neighbours share, and on sharp edges."""
    for amount in amounts:
        image, truth = make(amount)
        found = detector_for(image, DetectorConfig())(image)
        error = from_nearest(found.xy, truth)
        near = (np.linalg.norm(error, axis=1) < within) & (found.method == Method.EDGE_STEP)
        assert near.sum() > count
        assert (np.abs(error[near]) < 2 * found.sigma[near, None]).mean() > 0.9
        assert np.median(found.sigma[near]) < median * np.sqrt(np.square(error[near]).mean())


def test_a_small_cell_takes_two_fifths_off_the_errors_by_waves_and_adds_a_quarter_of_noise(
    detector_for,
):
    """Waves of a rolling shutter with the curvature of a circle of five cells; straight edges."""

    def shaken(x, y, amplitude):
        x = x - amplitude * np.sin(y / 12)
        return (0.955 * x + 0.296 * y) / 12.4, (0.955 * y - 0.296 * x) / 12.4

    errors = {}
    for amplitude, noise in ((2.4, 2), (0, 8)):
        camera = functools.partial(shaken, amplitude=amplitude)
        view = boards.drawn(camera, (300, 400), blur=0.8, noise=noise, count=4)
        for cell in (8.6, 6):
            config = DetectorConfig(refinement=EdgeStep(cell=cell))
            xy = detector_for(view.image, config)(view.image).xy
            inside = xy[(np.abs(xy - (199.5, 149.5)) < (190, 140)).all(axis=1)]
            error = to_nearest(inside, view.corners[:, :2])
            errors[noise, cell] = np.sqrt(np.square(error).mean())
    assert errors[2, 6] < 0.65 * errors[2, 8.6]
    assert errors[8, 6] < 1.35 * errors[8, 8.6]
