"""kernels/gate.cl: the contrast gate, equal to the oracle."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_maps_equal
from configs import rings
from corner_images import corner, noise

from cmp_cl import (
    BinaryRings,
    DetectorConfig,
    RapidCriteria,
    SectorContrast,
    SpectralCriteria,
    reference,
)
from cmp_cl.reference import gate

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
FIELDS = ("candidate", "contrast", "response", "maximum")


def check(detector_for, image, **changes):
    config = rings(refinement=None, **changes)
    return assert_maps_equal(detector_for(image, config), image, fields=FIELDS)


@pytest.mark.parametrize("outer_radius", [4, 5])
@pytest.mark.parametrize("name", some(EIGHT, ("texture", "worn scene")))
def test_the_gate_keeps_what_the_oracle_keeps(detector_for, name, outer_radius):
    check(detector_for, EIGHT[name], outer_radius=outer_radius)


@pytest.mark.parametrize("full_scale", [None, 4095])
@pytest.mark.parametrize("name", some(DEEP, ("12-bit scene",)))
def test_the_gate_of_sixteen_bits_keeps_what_the_oracle_keeps(detector_for, name, full_scale):
    check(detector_for, DEEP[name], full_scale=full_scale)


@pytest.mark.parametrize(
    "name", some(["noise", "two levels", "near levels", "worn scene"], ("noise",))
)
def test_any_number_of_sectors_equals_the_oracle(detector_for, name):
    """The spectral criteria accept rings with two, six and more sectors."""
    check(detector_for, EIGHT[name], criteria=SpectralCriteria(correlation=0))


@pytest.mark.parametrize("name", some(["texture", "12-bit scene", "bright"], ("texture",)))
def test_any_number_of_sectors_of_sixteen_bits_equals_the_oracle(detector_for, name):
    check(detector_for, DEEP[name], criteria=SpectralCriteria(correlation=0))


@pytest.mark.parametrize(
    "contrast",
    [
        {"minimum": 0, "relative": 0, "noise": 0},
        {"minimum": 0, "relative": 1, "noise": 0},
        {"minimum": 120.5, "relative": 0, "noise": 0},
        {"minimum": 0, "relative": 0, "noise": 1.3},
        {"minimum": 255, "relative": 0, "noise": 0},
        {"minimum": 0, "relative": 0.7, "noise": 0.5},
        {"minimum": 20, "relative": 0.2, "noise": 100},
    ],
    ids=str,
)
@pytest.mark.parametrize("name", some(["texture", "noise", "worn scene"], ("texture",)))
def test_each_condition_is_the_oracles(detector_for, name, contrast):
    # Sector thresholds this wide leave candidates whose contrast is 0 or less.
    criteria = RapidCriteria(sector_threshold=12, ring_threshold=9, corrosion_threshold=12)
    check(detector_for, EIGHT[name], contrast=SectorContrast(**contrast), criteria=criteria)


def test_each_condition_decides(detector_for):
    def kept(image, **contrast):
        maps = check(detector_for, image, contrast=SectorContrast(**contrast))
        return int(maps.maximum.sum())

    weak = EIGHT["faint board"]
    assert kept(weak, minimum=60) < kept(weak, minimum=20)
    mixed = EIGHT["texture"]
    assert kept(mixed, relative=1) < kept(mixed, relative=0.2)
    grainy = EIGHT["texture"]
    assert kept(grainy, noise=20) < kept(grainy, noise=0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_percentile_of_short_lists_has_the_right_rank(detector_for, dtype):
    """Parts of a texture have about 1 to 10 candidates; the bound is the contrast of one."""
    texture = images.texture((200, 200)).astype(dtype)
    contrast = SectorContrast(minimum=0, relative=1, noise=0)
    counts = set()
    for k in range(40):
        maps = check(detector_for, texture[4 * k : 4 * k + 23, :31], contrast=contrast)
        counts.add(int((maps.candidate & (maps.contrast != 0)).sum()))
    assert len(counts) > 3
    assert max(counts) > 3


def test_a_difference_at_the_noise_bound_is_kept(detector_for):
    """Bounds 2 N sm = F A at the sm of a candidate, and just above it."""
    image = images.texture((200, 200))[:60, :61]
    maps = reference.maps(image, DetectorConfig(detection=BinaryRings(contrast=None)))
    amplitude, pixels = gate.noise_amplitude(image)
    y, x = np.nonzero(maps.candidate & maps.maximum)
    sm = gate.sector_contrast(image, x, y, maps.inner[y, x], 5)[2]
    decided = 0
    for factor in range(1, 200):
        level = -(-factor * amplitude // (2 * pixels))  # the least sm that is kept
        if level in sm or level - 1 in sm:
            decided += 1
            contrast = SectorContrast(minimum=0, relative=0, noise=factor / 6.68)  # F = 6.68 noise
            check(detector_for, image, contrast=contrast)
        if decided == 6:  # each is a detector of its own
            break
    assert decided > 3


def test_without_the_gate_more_maxima_are_found(detector_for):
    image = EIGHT["texture"]
    maps = check(detector_for, image, contrast=None)
    assert maps.contrast is None
    assert maps.maximum.sum() > check(detector_for, image).maximum.sum()


def test_a_single_candidate_is_kept_by_its_own_percentile(detector_for):
    image = np.full(images.SHAPE, 200, np.uint8)
    image[10:51, 20:61] = corner(20, 20, 0.4)
    contrast = SectorContrast(minimum=0, relative=1, noise=0)
    assert check(detector_for, image, contrast=contrast).maximum.any()


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (2, 31), (31, 2), (3, 3)])
def test_images_without_an_inner_pixel_equal_the_oracle(detector_for, shape):
    check(detector_for, noise(shape, seed=4))


@pytest.mark.parametrize("relative", [0.3, 1])
def test_both_levels_of_the_percentile_equal_the_oracle(detector_for, relative):
    """The lower eight bits of the contrasts decide, frame after frame."""
    texture = images.texture((90, 80)).astype(np.uint16) * 3 + 100
    contrast = SectorContrast(minimum=0, relative=relative, noise=0)
    config = DetectorConfig(detection=BinaryRings(contrast=contrast))
    for image in (texture, texture[::-1].copy(), texture):
        assert_maps_equal(detector_for(image, config), image)
