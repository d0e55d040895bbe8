"""The kernels of the paper's rule: every map and every corner equals the oracle's.

binarize, criteria, spectral, noise, gate, nms, collect, scale: each setting of each of them.
"""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from configs import rings
from corner_images import board, noise

from cmp_cl import (
    AdaptiveMean,
    Detector,
    DetectorConfig,
    RapidCriteria,
    SectorContrast,
    SpectralCriteria,
    reference,
)

EIGHT, DEEP = images.eight_bits(), images.sixteen_bits()
PLAIN = rings(refinement=None)
WIDE = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
OPEN = {"contrast": None, "criteria": WIDE}
DENSE = rings(PLAIN, nms_radius=1, **OPEN)
ANY_SECTORS = SpectralCriteria(correlation=0, corrosion_threshold=None)


def gated(**contrast):
    """Sector thresholds this wide leave candidates whose contrast is 0 or less."""
    criteria = RapidCriteria(sector_threshold=12, ring_threshold=9, corrosion_threshold=12)
    return {"contrast": SectorContrast(**contrast), "criteria": criteria}


SETTINGS = {
    "small window": {"threshold": AdaptiveMean(window=3)},
    "large window": {"threshold": AdaptiveMean(window=41)},
    "offset": {"threshold": AdaptiveMean(offset=7)},
    "outer radius 4": {"outer_radius": 4},
    "strict sectors": {"criteria": RapidCriteria(sector_threshold=1)},
    "strict rings": {"criteria": RapidCriteria(ring_threshold=1)},
    "strict corrosion": {"criteria": RapidCriteria(corrosion_threshold=-2)},
    "no corrosion": {"criteria": RapidCriteria(corrosion_threshold=None)},
    "all candidates": OPEN,
    "all candidates, radius 1": {**OPEN, "nms_radius": 1},
    "all candidates, radius 7": {**OPEN, "nms_radius": 7},
    "no gate": {"contrast": None},
    "gate by a level": gated(minimum=120.5, relative=0, noise=0),
    "gate by the best": gated(minimum=0, relative=1, noise=0),
    "gate by noise": gated(minimum=0, relative=0, noise=1.3),
    "gate of all": gated(minimum=20, relative=0.2, noise=100),
    "spectral": {"criteria": SpectralCriteria()},
    "spectral, any sectors": {"criteria": ANY_SECTORS},
    "spectral, any, no gate": {"criteria": ANY_SECTORS, "contrast": None, "nms_radius": 7},
    "spectral, exact": {"criteria": SpectralCriteria(correlation=1.0), "contrast": None},
    "spectral, in phase": {"criteria": SpectralCriteria(correlation=0.5, phase=0.2)},
    "spectral, radius 4": {"criteria": SpectralCriteria(), "outer_radius": 4},
    "half scale": {"scale": 0.5},
    "odd scale": {"scale": 0.63, "nms_radius": 1},
    "double scale": {"scale": 2.0},
    "few pixels": {"scale": 0.1},
}
CONFIGS = {"default": PLAIN} | {name: rings(PLAIN, **each) for name, each in SETTINGS.items()}
configs = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)


@configs
@pytest.mark.parametrize("name", some(EIGHT, ("texture", "worn scene", "noise")))
def test_maps_and_corners_of_eight_bits_are_the_oracles(detector_for, config, name):
    detector = detector_for(EIGHT[name], config)
    assert_maps_equal(detector, EIGHT[name])
    assert_corners_equal(detector, EIGHT[name])


@configs
@pytest.mark.parametrize("full_scale", some([None, 4095], (4095,)))
@pytest.mark.parametrize("name", some(DEEP, ("12-bit scene",)))
def test_maps_and_corners_of_sixteen_bits_are_the_oracles(detector_for, config, full_scale, name):
    config = config.replace(full_scale=full_scale)
    detector = detector_for(DEEP[name], config)
    assert_maps_equal(detector, DEEP[name])
    assert_corners_equal(detector, DEEP[name])


SHAPES = [(1, 1), (1, 31), (31, 1), (2, 2), (2, 31), (5, 3), (13, 17), (30, 23)]
FEW = ("default", "all candidates, radius 7", "gate by the best", "spectral", "half scale")


@pytest.mark.parametrize("shape", some(SHAPES, ((1, 31), (5, 3))), ids=str)
@pytest.mark.parametrize("config", some(CONFIGS, FEW))
def test_images_smaller_than_rings_and_windows_equal_the_oracle(detector_for, shape, config):
    image = noise(shape, seed=4)
    detector = detector_for(image, CONFIGS[config])
    assert_maps_equal(detector, image)
    assert_corners_equal(detector, image)


# binarization and rings


def test_a_threshold_beyond_32_bits_does_not_overflow(detector_for):
    """The sums of 255 x 255 pixels at full scale, and of as many offsets, are near 2^32 each."""
    config = rings(PLAIN, threshold=AdaptiveMean(window=255, offset=65535))
    detector = detector_for(DEEP["white"], config)
    assert not assert_maps_equal(detector, DEEP["white"]).binary.any()


def test_candidates_lie_inside_the_mask_and_samples_beyond_it(detector_for):
    image = EIGHT["texture"]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[10:40, 5:83] = True
    everywhere = detector_for(image, PLAIN).maps(image)
    inside = assert_maps_equal(detector_for(image, PLAIN, mask), image, mask=mask)
    np.testing.assert_array_equal(inside.candidate, everywhere.candidate & mask)
    np.testing.assert_array_equal(inside.inner, everywhere.inner)
    assert 0 < inside.candidate.sum() < everywhere.candidate.sum()


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
    assert max(counts) > 3


@pytest.mark.parametrize("relative", [0.3, 1])
def test_both_levels_of_the_percentile_equal_the_oracle(detector_for, relative):
    """The lower eight bits of the contrasts decide, frame after frame."""
    texture = images.texture((90, 80)).astype(np.uint16) * 3 + 100
    config = rings(PLAIN, contrast=SectorContrast(minimum=0, relative=relative, noise=0))
    for image in (texture, texture[::-1].copy(), texture):
        assert_maps_equal(detector_for(image, config), image)


# suppression and the list of maxima


def test_frames_of_a_batch_do_not_see_each_other(device):
    """Frames are cut so that corners lie in the first and the last row; no response lies beyond."""
    texture = images.texture((120, 83))
    frames = [np.ascontiguousarray(texture[y : y + 40]) for y in range(16)]
    with Detector(shape=frames[0].shape, config=DENSE, device=device) as detector:
        together = detector.batch(frames)
        for frame, corners in zip(frames, together, strict=True):
            assert_same_bytes(corners, assert_corners_equal(detector, frame))
    pixel = np.concatenate([corners.pixel for corners in together])
    assert {0, 39} <= set(pixel[:, 1])
    assert {0, 82} <= set(pixel[:, 0])


@pytest.mark.parametrize(("count", "regrown"), [(63, False), (64, False), (65, True), (128, True)])
def test_a_list_that_overflows_is_made_again_and_holds_every_maximum(device, count, regrown):
    """A mask leaves exactly that many candidates, each of which is a maximum."""
    image = images.texture((300, 60), seed=9)
    maxima = np.argwhere(reference.maps(image, DENSE).maximum)
    mask = np.zeros(image.shape, np.bool_)
    mask[tuple(maxima[:count].T)] = True
    with Detector(shape=image.shape, config=DENSE, device=device, mask=mask) as detector:
        plan = detector._plans.lend()
        plan.list_capacity = plan.corner_capacity = 64
        plan._allocate()
        plan._bind()
        corners = assert_corners_equal(detector, image, mask=mask)
        assert len(corners) == count
        assert (detector.regrown > 0) is regrown
        times = detector.regrown
        assert_same_bytes(detector(image), corners)
        assert detector.regrown == times


# the working scale


@pytest.mark.parametrize("factor", some([0.05, 1 / 3, 0.999, 1.001, 1.5, 4.0], (0.05, 1.5)))
def test_odd_scales_give_the_oracles_maps(detector_for, factor):
    for shape in ((30, 23), (2, 2)):
        image = noise(shape, seed=2)
        assert_maps_equal(detector_for(image, rings(PLAIN, scale=factor)), image)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_mask_is_scaled_with_the_image(detector_for, factor):
    image = board(*images.SHAPE, 20)[0]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[:, :41] = True
    detector = detector_for(image, DetectorConfig.replace(PLAIN, scale=factor), mask)
    assert len(assert_corners_equal(detector, image, mask=mask)) > 0
    assert_maps_equal(detector, image, mask=mask)
