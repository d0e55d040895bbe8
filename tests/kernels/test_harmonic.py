"""kernels/harmonic.cl and kernels/cpu/harmonic.cl: the grey-level rule, equal to the oracle."""

import time
from pathlib import Path

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from corner_images import board, noise
from forms import in_form

from cmp_cl import Detector, DetectorConfig, EdgeLines, RingHarmonic, reference
from cmp_cl.stages.form import Form
from cmp_cl.stages.layout import PlanBase

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
FEW = ("scene", "fine board", "pixels", "noise", "white")
VECTORS = sorted((Path(__file__).resolve().parents[1] / "data").glob("harmonic-*.npz"))


def configured(refinement=None, nms_radius=3, full_scale=None, **rule):
    return DetectorConfig(
        detection=RingHarmonic(**rule),
        nms_radius=nms_radius,
        full_scale=full_scale,
        refinement=refinement,
    )


EVERYTHING = {"noise": 0, "relative": 0}
DENSE = configured(nms_radius=1, **EVERYTHING)
LINES = configured(EdgeLines(), **EVERYTHING)


# --- stored vectors -------------------------------------------------------------------------------


@pytest.fixture(params=VECTORS, ids=lambda path: path.stem)
def stored(request):
    """Return a vector, and the settings that it was made with."""
    with np.load(request.param) as file:
        vector = dict(file)
    made_with = {"noise": 2.0, "relative": 24 / 128, "fine": True, "octaves": 0}
    return vector, configured(nms_radius=3, full_scale=int(vector["full_scale"]), **made_with)


def test_corners_are_those_of_the_stored_vector(detector_in_form, stored):
    vector, config = stored
    corners = detector_in_form(vector["image"], config)(vector["image"])
    np.testing.assert_array_equal(corners.pixel, vector["kept"][:, :2])
    np.testing.assert_array_equal(corners.response, vector["kept"][:, 2])


# --- images --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", some(EIGHT, FEW))
def test_corners_of_eight_bits_are_the_oracles(detector_in_form, name):
    """Corners with all checks, with none, and refined."""
    image = EIGHT[name]
    for config in (DetectorConfig(), DENSE, LINES):
        assert_corners_equal(detector_in_form(image, config), image)


@pytest.mark.parametrize("full_scale", [1, 200, 255, 4095, 65535])
@pytest.mark.parametrize("name", some(DEEP, ("12-bit board", "noise")))
def test_grey_levels_above_full_scale_count_as_full_scale(detector_in_form, name, full_scale):
    image = DEEP[name]
    config = configured(full_scale=full_scale, **EVERYTHING)
    assert_corners_equal(detector_in_form(image, config), image)
    assert_corners_equal(detector_in_form(image, DetectorConfig(full_scale=full_scale)), image)
    assert_maps_equal(detector_in_form(image, config), image)
    maps = reference.maps(image, config)
    clipped = reference.maps(np.minimum(image, full_scale).astype(np.uint16), config)
    np.testing.assert_array_equal(maps.fine, clipped.fine)
    assert maps.fine.max() <= 4080  # 255 grey levels in sixteenths


def test_levels_of_every_full_scale_equal_the_oracle(detector_in_form):
    """Divisions leave every remainder; the forms divide in different ways."""
    image = np.arange(61 * 83, dtype=np.uint16).reshape(61, 83)
    for full_scale in (3, 254, 1000, 4079, 4080, 4081, 5062, 40_000):
        scaled = (image.astype(np.int64) * full_scale // 5062).astype(np.uint16)
        config = configured(full_scale=full_scale, nms_radius=1, **EVERYTHING)
        assert_maps_equal(detector_in_form(scaled, config), scaled)
        rough = (noise((61, 83)).astype(np.int64) * full_scale // 255).astype(np.uint16)
        assert_corners_equal(detector_in_form(rough, config), rough)


SHAPES = [(1, 1), (1, 40), (40, 1), (2, 2), (2, 31), (3, 3), (5, 4), (9, 11), (11, 64), (34, 7)]


@pytest.mark.parametrize("shape", some(SHAPES, ((1, 1), (9, 11))), ids=str)
def test_images_smaller_than_the_ring_equal_the_oracle(detector_in_form, shape):
    for image in (noise(shape, seed=3), np.full(shape, 255, np.uint8)):
        for config in (DetectorConfig(), DENSE, configured(nms_radius=15, **EVERYTHING)):
            detector = detector_in_form(image, config)
            assert_corners_equal(detector, image)
            assert_maps_equal(detector, image)


WIDTHS = [31, 32, 33, 47, 48, 49, 63, 64, 65, 95, 96, 97, 127, 128, 129, 159, 160, 161]


@pytest.mark.parametrize("width", some(WIDTHS, (32, 33, 97)))
def test_widths_around_words_and_vectors_equal_the_oracle(detector_in_form, width):
    """Maxima lie in the first and the last columns too."""
    tall = images.texture((500, width), seed=6)
    seen = set()
    for top in (0, 50, 100):
        image = tall[top : top + 50]
        corners = assert_corners_equal(detector_in_form(image, DENSE), image)
        seen |= set(corners.pixel[:, 0].tolist())
    assert seen & {0, 1}
    assert seen & {width - 2, width - 1}


@pytest.mark.parametrize("bands", some([1, 2, 3, 5, 7, 36, 70], (2, 7)))
def test_any_number_of_bands_gives_the_same_corners(device, monkeypatch, bands):
    """Even so many that the last ones have no row."""
    monkeypatch.setattr(PlanBase, "bands", bands)
    image = images.texture((70, 64), seed=2)
    for nms_radius in (1, 3, 15):
        config = configured(nms_radius=nms_radius, **EVERYTHING)
        with Detector(
            shape=image.shape, config=config, device=in_form(device, Form.CPU)
        ) as detector:
            corners = assert_corners_equal(detector, image)
            assert_same_bytes(detector.batch([image] * 2)[1], corners)
    assert len(corners) > 0


# --- the rule ------------------------------------------------------------------------------


@pytest.mark.parametrize("nms_radius", some([1, 2, 3, 4, 5, 7, 8, 15], (1, 4, 15)))
@pytest.mark.parametrize(
    "name", some(["texture", "fine board", "pixels", "stripes 4"], ("texture",))
)
def test_corners_are_the_oracles_for_every_radius(detector_in_form, name, nms_radius):
    config = configured(nms_radius=nms_radius, **EVERYTHING)
    assert_corners_equal(detector_in_form(EIGHT[name], config), EIGHT[name])


RULES = {
    "wide cells": {"fine": False},
    "no noise": {"noise": 0, "relative": 0},
    "half the noise": {"noise": 0.5},
    "much noise": {"noise": 7.3},
    "all noise": {"noise": 100},
    "half the reference": {"relative": 0.5},
    "the reference": {"relative": 1},
}


@pytest.mark.parametrize("rule", some(RULES, ("wide cells", "half the noise")))
@pytest.mark.parametrize("name", some(["texture", "worn scene", "fine board"], ("texture",)))
def test_every_setting_of_the_rule_equals_the_oracle(detector_in_form, name, rule):
    image, config = EIGHT[name], configured(**RULES[rule])
    detector = detector_in_form(image, config)
    assert_corners_equal(detector, image)
    assert_maps_equal(detector, image)


def test_the_largest_harmonics_fit_with_the_largest_factors(detector_in_form):
    """The product of two second harmonics and a factor is beyond 32 bits."""
    y, x = np.indices(images.SHAPE)
    image = np.where((x // 12 + y // 12) % 2 == 0, 0, 255).astype(np.uint8)
    config = configured()
    corners = assert_corners_equal(detector_in_form(image, config), image)
    assert corners.response.max() > 5000
    assert len(corners) > 20


@pytest.mark.parametrize("pixel", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
def test_the_largest_noise_does_not_overflow(detector_in_form, pixel):
    """The bound is above every response, and the product that gives it is near 64 bits."""
    most = np.iinfo(pixel).max
    image = (np.indices((200, 220)).sum(0) % 2 * most).astype(pixel)
    corners = assert_corners_equal(detector_in_form(image, configured(noise=100)), image)
    assert len(corners) == 0


def test_a_mask_leaves_corners_inside_and_suppression_as_it_is(detector_in_form):
    image = EIGHT["texture"]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[10:40, 5:81:2] = True
    whole = reference.maps(image, DENSE).maximum
    detector = detector_in_form(image, DENSE, mask)
    corners = assert_corners_equal(detector, image, mask=mask)
    assert_maps_equal(detector, image, mask=mask)
    x, y = corners.pixel.T
    assert mask[y, x].all()
    assert 0 < len(corners) < whole.sum()


@pytest.mark.parametrize("config", [DetectorConfig(), DENSE], ids=["default", "dense"])
def test_frames_of_a_batch_do_not_see_each_other(detector_in_form, config):
    frames = [EIGHT[name] for name in ("texture", "white", "worn scene")]
    detector = detector_in_form(frames[0], config)
    for one, frame in zip(detector.batch(frames), frames, strict=True):
        assert_same_bytes(one, assert_corners_equal(detector, frame))


# --- capacity ------------------------------------------------------------------------------


def test_more_maxima_than_the_capacity_are_counted_and_found_all_the_same(device_in_form):
    """Noise has more maxima in windows of 3 x 3 than the list can hold."""
    image = noise((600, 200), seed=3)
    config = DENSE.replace(max_corners=1)
    with Detector(shape=image.shape, config=config, device=device_in_form) as detector:
        capacity, memory = detector._plans.lend().list_capacity, detector.memory
        corners = assert_corners_equal(detector, image)
        assert detector.regrown > 0
        assert detector._plans.lend().list_capacity > capacity
        assert detector.memory > memory
        assert len(corners) > capacity
        times = detector.regrown
        assert_same_bytes(detector(image), corners)
        assert_same_bytes(detector.batch([image, image[::-1].copy()])[0], corners)
        assert len(detector(np.zeros_like(image))) == 0
        assert_same_bytes(detector(image), corners)
        assert detector.regrown - times <= 2  # the plan of the batch grows too


# --- the worst case ------------------------------------------------------------------------

LARGE = (1200, 1600)
WORST = {
    "a rotated board of 7 px cells": lambda: tiled(board(300, 400, 7, angle=0.4)[0]),
    "white noise": lambda: noise(LARGE, seed=1),
    "a fine texture": lambda: tiled(images.texture((300, 400))),
}


def tiled(tile):
    return np.tile(tile, (LARGE[0] // tile.shape[0], LARGE[1] // tile.shape[1]))


@pytest.mark.exhaustive
def test_no_image_takes_more_than_ten_times_a_typical_one(device):
    typical = tiled(board(300, 400, 25)[0])
    with Detector(shape=LARGE, device=device) as detector:
        memory = detector.memory

        def spent(image):
            """Return the time of a call, s."""
            start = time.perf_counter()
            detector(image)
            return time.perf_counter() - start

        for name, make in WORST.items():
            image = make()
            turns = [(spent(typical), spent(image)) for _ in range(25)]
            # The least of each: other programs use the machine too.
            usual, most = (min(each) for each in zip(*turns, strict=True))
            assert most < 10 * usual, name
            assert detector.memory <= 2 * memory, name
            assert detector.regrown <= 2, name
