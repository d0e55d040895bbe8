"""kernels/collect.cl: each maximum is listed once, and is found if the list overflows too."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_same_bytes
from configs import rings
from corner_images import noise

from cmp_cl import (
    Detector,
    RapidCriteria,
    SpectralCriteria,
    reference,
)

EIGHT = images.eight_bits()
PLAIN = rings(refinement=None)
DENSE = rings(
    PLAIN,
    contrast=None,
    nms_radius=1,
    criteria=RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17),
)


@pytest.mark.parametrize("config", [PLAIN, DENSE], ids=["gate", "dense"])
@pytest.mark.parametrize("name", some(EIGHT, ("texture", "scene")))
def test_every_maximum_is_listed_once_in_raster_order(detector_for, name, config):
    image = EIGHT[name]
    corners = detector_for(image, config)(image)
    y, x = np.nonzero(reference.maps(image, config).maximum)
    np.testing.assert_array_equal(corners.pixel, np.stack([x, y], axis=1))


def test_maxima_in_the_outermost_rows_and_columns_are_found(detector_for):
    """The image is cut so that corners lie in the first and last row and column."""
    image = images.texture((61, 83))
    seen = set()
    for dy, dx in np.ndindex(4, 4):
        part = np.ascontiguousarray(image[dy : 40 + dy, dx : 60 + dx])
        corners = assert_corners_equal(detector_for(part, DENSE), part)
        x, y = corners.pixel.T
        seen |= {("top", (y == 0).any()), ("bottom", (y == 39).any())}
        seen |= {("left", (x == 0).any()), ("right", (x == 59).any())}
    assert {(side, True) for side in ("top", "bottom", "left", "right")} <= seen


@pytest.mark.parametrize("shape", some([(1, 31), (31, 1), (2, 3), (23, 29)], ((1, 31),)))
def test_corners_of_images_of_few_pixels_are_the_oracles(detector_for, shape):
    image = noise(shape, seed=8)
    assert_corners_equal(detector_for(image, DENSE), image)


def with_capacity(detector, capacity):
    plan = detector._plans.lend()
    plan.list_capacity = plan.corner_capacity = capacity
    plan._allocate()
    plan._bind()


@pytest.mark.parametrize(("count", "regrown"), [(63, False), (64, False), (65, True), (128, True)])
def test_a_capacity_of_64_holds_64(device, count, regrown):
    """A mask leaves exactly that many candidates, each of which is a maximum."""
    image = images.texture((300, 60), seed=9)
    maxima = np.argwhere(reference.maps(image, DENSE).maximum)
    mask = np.zeros(image.shape, np.bool_)
    mask[tuple(maxima[:count].T)] = True
    with Detector(shape=image.shape, config=DENSE, device=device, mask=mask) as detector:
        with_capacity(detector, 64)
        corners = assert_corners_equal(detector, image, mask=mask)
        assert len(corners) == count
        assert (detector.regrown > 0) is regrown


@pytest.mark.parametrize("config", [PLAIN, DENSE], ids=["gate", "dense"])
def test_a_frame_beyond_the_capacity_is_counted_and_processed_again(detector_for, config):
    image = images.texture((300, 60), seed=9)
    small = config.replace(max_corners=3)
    detector = detector_for(image, small)
    with_capacity(detector, 64)
    corners = assert_corners_equal(detector, image)
    assert len(corners) > 64
    assert detector.regrown > 0
    times = detector.regrown
    assert_same_bytes(detector(image), corners)
    assert detector.regrown == times


def test_every_maximum_of_a_spectral_response_is_listed(detector_for):
    image = EIGHT["texture"]
    config = rings(DENSE, criteria=SpectralCriteria(correlation=0))
    corners = assert_corners_equal(detector_for(image, config), image)
    assert corners.response.max() > 255
