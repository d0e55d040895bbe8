"""kernels/nms.cl: suppression by the smoothed response, equal to the oracle."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from configs import rings
from corner_images import noise

from cmp_cl import (
    BinaryRings,
    Detector,
    DetectorConfig,
    RapidCriteria,
    SpectralCriteria,
)

EIGHT = images.eight_bits()
FIELDS = ("response", "score", "maximum")
DENSE = DetectorConfig(
    detection=BinaryRings(
        contrast=None,
        criteria=RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17),
    ),
    refinement=None,
)


def check(detector_for, image, config=DENSE, **changes):
    config = rings(config, **changes)
    return assert_maps_equal(detector_for(image, config), image, fields=FIELDS)


@pytest.mark.exhaustive
@pytest.mark.parametrize("radius", [1, 2, 3, 7])
@pytest.mark.parametrize("name", EIGHT)
def test_maxima_are_the_oracles_for_every_radius(detector_for, name, radius):
    check(detector_for, EIGHT[name], nms_radius=radius)


def test_a_larger_radius_keeps_fewer(detector_for):
    kept = [
        check(detector_for, EIGHT["texture"], nms_radius=radius).maximum.sum()
        for radius in (1, 2, 3, 7)
    ]
    assert kept == sorted(kept, reverse=True)
    assert kept[0] > kept[-1] > 0


def test_the_largest_scores_do_not_overflow(detector_for):
    """Plateaus of large responses are as wide as the tent, so that the scores are."""
    bars = np.kron(np.indices((8, 11)).sum(0) % 2, np.ones((8, 8)))[:61, :83] * 255
    maps = check(detector_for, bars.astype(np.uint8))
    assert maps.response.max() > 4


@pytest.mark.parametrize(
    "name", some(["texture", "noise", "worn scene", "stripes 3"], ("texture",))
)
def test_maxima_of_spectral_responses_are_the_oracles(detector_for, name):
    criteria = SpectralCriteria(correlation=0, corrosion_threshold=None)
    maps = check(detector_for, EIGHT[name], criteria=criteria)
    if name != "stripes 3":
        assert maps.response.max() > 255


def test_a_plateau_has_one_winner_the_first_in_raster_order(detector_for):
    tile = np.zeros((16, 16))
    tile[:8, :8] = tile[8:, 8:] = 1
    image = (200 - 160 * np.tile(tile, (4, 6))[:61, :83]).astype(np.uint8)
    maps = check(detector_for, image)
    y, x = np.nonzero(maps.maximum)
    inside = (y > 10) & (y < 50) & (x > 10) & (x < 70)
    # One in every cell of 8 x 8 px, at the same place in all cells of a colour.
    assert len(set(zip(y[inside] % 8, x[inside] % 8, strict=True))) <= 2
    near = (maps.score == maps.score[y[0], x[0]])[y[0] : y[0] + 4, x[0] : x[0] + 4]
    assert near.sum() > 1


@pytest.mark.parametrize(
    "shape", some([(1, 1), (1, 31), (31, 1), (3, 2), (29, 31)], ((1, 1), (29, 31)))
)
@pytest.mark.parametrize("radius", some([3, 7], (7,)))
def test_windows_larger_than_the_image_equal_the_oracle(detector_for, shape, radius):
    check(detector_for, noise(shape, seed=6), nms_radius=radius)


def test_frames_of_a_batch_do_not_see_each_other(device):
    """Frames are cut so that corners lie in the first and the last row; no response lies beyond."""
    texture = images.texture((120, 83))
    frames = [np.ascontiguousarray(texture[y : y + 40]) for y in range(16)]
    with Detector(shape=frames[0].shape, config=DENSE, device=device) as detector:
        together = detector.batch(frames)
        for frame, corners in zip(frames, together, strict=True):
            assert_same_bytes(corners, assert_corners_equal(detector, frame))
    rows = np.concatenate([corners.pixel[:, 1] for corners in together])
    assert {0, 39} <= set(rows)
