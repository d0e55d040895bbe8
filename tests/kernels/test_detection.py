"""The kernels from an image to its corners before refinement: both rules equal the oracle.

Rings: binarize, criteria, spectral, noise, gate, nms, collect. Grey levels: harmonic, in both
forms.
"""

import time

import images
import numpy as np
import pyopencl as cl
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from configs import ANY_RINGS, rings
from corner_images import board, noise
from detectors import in_form

from cmp_cl import (
    AdaptiveMean,
    Detector,
    DetectorConfig,
    RapidCriteria,
    RingHarmonic,
    SectorContrast,
    SpectralCriteria,
    reference,
)
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.reference.paper import gate
from cmp_cl.stages.layout import PlanBase

EIGHT, DEEP = images.eight_bits(), images.sixteen_bits()


def harmonic(nms_radius=3, full_scale=None, **rule):
    return DetectorConfig(
        detection=RingHarmonic(**rule),
        nms_radius=nms_radius,
        full_scale=full_scale,
        refinement=None,
    )


def gated(**contrast):
    """Sector thresholds this wide leave candidates whose contrast is 0 or less."""
    criteria = RapidCriteria(sector_threshold=12, ring_threshold=9, corrosion_threshold=12)
    return rings(PLAIN, contrast=SectorContrast(**contrast), criteria=criteria)


PLAIN = rings(refinement=None)
DENSE = harmonic(noise=0, relative=0, nms_radius=1)
DENSE_RINGS = rings(PLAIN, contrast=None, criteria=ANY_RINGS, nms_radius=1)
CONFIGS = {  # others are drawn in tests/test_properties.py
    "harmonic": harmonic(),
    "harmonic, all": DENSE,
    "harmonic, half the noise": harmonic(noise=0.5),
    "rings, offset": rings(PLAIN, threshold=AdaptiveMean(offset=7)),
    "rings, all, radius 7": DENSE_RINGS.replace(nms_radius=7),
    "rings, gate by the best": gated(minimum=0, relative=1, noise=0),
    "rings, gate by noise": gated(minimum=0, relative=0, noise=1.3),
    "spectral": rings(PLAIN, criteria=SpectralCriteria()),
}
DENSEST = "harmonic, all", "rings, all, radius 7", "rings, gate by the best"


def assert_equal(detector, image, **mask):
    assert_maps_equal(detector, image, **mask)
    return assert_corners_equal(detector, image, **mask)


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("name", some(EIGHT, ("texture", "worn scene")))
def test_images_of_eight_bits(detector_in_form, config, name):
    assert_equal(detector_in_form(EIGHT[name], CONFIGS[config]), EIGHT[name])


@pytest.mark.parametrize("config", some(CONFIGS, DENSEST))
@pytest.mark.parametrize("full_scale", some([None, 1, 200, 4095], (200, 4095)))
@pytest.mark.parametrize("name", some(("12-bit scene", "noise", "bright"), ("12-bit scene",)))
def test_images_of_sixteen_bits_and_levels_above_full_scale(
    detector_in_form, config, full_scale, name
):
    config = CONFIGS[config].replace(full_scale=full_scale)
    assert_equal(detector_in_form(DEEP[name], config), DEEP[name])


def test_levels_of_every_full_scale(detector_in_form):
    """Divisions leave every remainder; the forms divide in different ways."""
    image = np.arange(61 * 83, dtype=np.uint16).reshape(61, 83)
    for full_scale in (3, 254, 1000, 4079, 4080, 4081, 5062, 40_000):
        scaled = (image.astype(np.int64) * full_scale // 5062).astype(np.uint16)
        config = DENSE.replace(full_scale=full_scale)
        assert_maps_equal(detector_in_form(scaled, config), scaled)
        rough = (noise((61, 83)).astype(np.int64) * full_scale // 255).astype(np.uint16)
        assert_corners_equal(detector_in_form(rough, config), rough)


# shapes

SHAPES = [(1, 1), (1, 40), (31, 1), (2, 2), (2, 31), (5, 3), (9, 11), (11, 64), (34, 7), (30, 23)]


@pytest.mark.parametrize("shape", some(SHAPES, ((1, 1), (2, 31), (9, 11))), ids=str)
@pytest.mark.parametrize("config", some(CONFIGS, ("harmonic, all", "spectral")))
def test_images_smaller_than_rings_and_windows(detector_in_form, shape, config):
    for image in (noise(shape, seed=4), np.full(shape, 255, np.uint8)):
        assert_equal(detector_in_form(image, CONFIGS[config]), image)


WIDTHS = [31, 32, 33, 47, 48, 49, 63, 64, 65, 95, 96, 97, 127, 128, 129, 159, 160, 161]


@pytest.mark.parametrize("width", some(WIDTHS, (32, 33, 96)))
@pytest.mark.parametrize("config", [DENSE, DENSE_RINGS], ids=["harmonic", "rings"])
def test_widths_around_words_and_vectors(detector_in_form, config, width):
    """Maxima lie in the first and the last columns too."""
    tall = images.texture((500, width), seed=6)
    seen = set()
    for top in (0, 50, 100):
        image = tall[top : top + 50]
        corners = assert_corners_equal(detector_in_form(image, config), image)
        seen |= set(corners.pixel[:, 0].tolist())
    assert seen & {0, 1}
    assert seen & {width - 2, width - 1}


@pytest.mark.parametrize("width", [2**16, 2**16 + 90])
def test_corners_beyond_column_65536_are_found(detector_in_form, width):
    """The form for CPUs keeps 16 bits of a column."""
    part = images.texture((34, 90))
    image = np.pad(part, ((0, 0), (width - 90, 0)))

    def last(image):
        """Return the corners of the last 80 columns, as seen from the image's right border."""
        place = detector_in_form(image, DENSE)(image).pixel - (image.shape[1], 0)
        return place[place[:, 0] >= -80]

    assert len(last(part)) > 10
    assert np.array_equal(last(image), last(part))


@pytest.mark.parametrize("bands", some([1, 2, 3, 5, 7, 36, 70], (2, 7)))
def test_any_number_of_bands_gives_the_same_corners(device, monkeypatch, bands):
    """Even so many that the last ones have no row."""
    monkeypatch.setattr(PlanBase, "bands", bands)
    image = images.texture((70, 64), seed=2)
    for nms_radius in (1, 3, 15):
        config = DENSE.replace(nms_radius=nms_radius)
        with Detector(
            shape=image.shape, config=config, device=in_form(device, DeviceKind.CPU)
        ) as detector:
            corners = assert_corners_equal(detector, image)
            assert_same_bytes(detector.batch([image] * 2)[1], corners)
    assert len(corners) > 0


# the largest numbers


def test_a_threshold_beyond_32_bits_does_not_overflow(detector_for):
    """The sums of 255 x 255 pixels at full scale, and of as many offsets, are near 2^32 each."""
    white = np.full((33, 41), 65535, np.uint16)  # of the shape of tests/test_portability.py
    config = rings(PLAIN, threshold=AdaptiveMean(window=255, offset=65535))
    assert not assert_maps_equal(detector_for(white, config), white).binary.any()


def test_the_largest_harmonics_fit_with_the_largest_factors(detector_in_form):
    """The product of two second harmonics and a factor is beyond 32 bits."""
    y, x = np.indices(images.SHAPE)
    image = np.where((x // 12 + y // 12) % 2 == 0, 0, 255).astype(np.uint8)
    corners = assert_corners_equal(detector_in_form(image, harmonic()), image)
    assert corners.response.max() > 5000
    assert len(corners) > 20


# the noise


def summed(detector, image):
    """Return the noise of the last frame, summed over the bands."""
    detector(image)
    plan = detector._plans.lend()
    sums = np.empty(plan.sizes["noise"] // 8, np.uint64)
    cl.enqueue_copy(plan.queue, sums, plan.arrays["noise"])
    return int(sums.sum())


@pytest.mark.parametrize("config", [harmonic(), PLAIN], ids=["harmonic", "rings"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
@pytest.mark.parametrize("columns", some([1, 2, 3, 4, 5, 6, 7, 8, 9, 31, 33, 64], (2, 3, 33)))
def test_the_noise_is_the_oracles_for_every_width(detector_for, dtype, columns, config):
    """On a CPU too the rings have the noise of the portable kernels."""
    image = np.random.default_rng(6).integers(0, np.iinfo(dtype).max + 1, (19, columns), dtype)
    assert summed(detector_for(image, config), image) == gate.noise_amplitude(image)[0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
def test_the_largest_noise_does_not_overflow(detector_in_form, dtype):
    """Black and white pixels in turn: eight full scales at every inner pixel. The bound of the
    responses is above all, and the product that gives it is near 64 bits."""
    most = np.iinfo(dtype).max
    image = (np.indices((500, 88)).sum(0) % 2 * most).astype(dtype)
    for config in (harmonic(noise=100), PLAIN):
        detector = detector_in_form(image, config)
        assert summed(detector, image) == 8 * most * 498 * 86
        assert len(assert_corners_equal(detector, image)) == 0


# the gate


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_percentile_of_short_lists_has_the_right_rank(detector_for, dtype):
    """Parts of a texture have about 1 to 10 candidates; the bound is the contrast of one."""
    texture = images.texture((200, 200)).astype(dtype)
    config = rings(PLAIN, contrast=SectorContrast(minimum=0, relative=1, noise=0))
    counts = set()
    for k in range(40):
        image = texture[4 * k : 4 * k + 23, :31]
        maps = assert_maps_equal(detector_for(image, config), image)
        counts.add(int((maps.candidate & (maps.contrast != 0)).sum()))
    assert len(counts) > 3


# masks, batches, capacity


@pytest.mark.parametrize("config", [DENSE, DENSE_RINGS], ids=str)
def test_corners_lie_inside_the_mask_and_samples_beyond_it(detector_in_form, config):
    image = EIGHT["texture"]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[11:40, 5:81:2] = True
    corners = assert_equal(detector_in_form(image, config, mask), image, mask=mask)
    assert 0 < len(corners) < len(detector_in_form(image, config)(image))
    assert mask[corners.pixel[:, 1], corners.pixel[:, 0]].all()


@pytest.mark.parametrize(
    "config", [harmonic(), DENSE, DENSE_RINGS], ids=["default", "all", "rings"]
)
def test_frames_of_a_batch_do_not_see_each_other(detector_in_form, config):
    """Frames are cut so that corners lie in the first and the last row; no response lies beyond."""
    texture = images.texture((120, 83))
    frames = [np.ascontiguousarray(texture[y : y + 40]) for y in range(12)]
    frames[1][:] = 255
    detector = detector_in_form(frames[0], config)
    for one, frame in zip(detector.batch(frames), frames, strict=True):
        assert_same_bytes(one, assert_corners_equal(detector, frame))


@pytest.mark.parametrize(("count", "regrown"), [(64, False), (65, True)])
@pytest.mark.parametrize("config", [harmonic(1, noise=0, relative=0, fine=False), DENSE_RINGS])
def test_a_list_that_overflows_is_made_again_and_holds_every_maximum(
    device_in_form, monkeypatch, config, count, regrown
):
    """A mask leaves exactly that many candidates in one list, each of which is a maximum.

    There is one band, because each band that finds one takes a block of the list.
    """
    monkeypatch.setattr(PlanBase, "bands", 1)
    image = images.texture((200, 83), seed=9)
    mask = np.zeros(image.shape, np.bool_)
    mask[tuple(np.argwhere(reference.maps(image, config).maximum)[:count].T)] = True
    with Detector(shape=image.shape, config=config, device=device_in_form, mask=mask) as detector:
        plan = detector._plans.lend()
        plan.list_capacity = plan.corner_capacity = 64
        plan._allocate()
        plan._bind()
        assert len(assert_corners_equal(detector, image, mask=mask)) == count
        assert (detector.regrown > 0) is regrown


# the worst case

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
