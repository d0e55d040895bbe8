"""The working scale of the oracle."""

import cv2
import numpy as np
import pytest
from corner_images import board, noise, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, EdgeLines, RingHarmonic
from cmp_cl.reference import scale


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("factor", [0.25, 0.5, 1.5, 2.0])
def test_scaling_agrees_with_opencv(dtype, factor):
    image = noise((40, 48)).astype(dtype)
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    peer = cv2.resize(image, None, fx=factor, fy=factor, interpolation=how)
    found = scale.to_working(image, factor)
    assert found.dtype == dtype
    assert np.abs(found.astype(np.int64) - peer).max() <= 1


@pytest.mark.parametrize("factor", [0.5, 0.62])
def test_large_cells_are_found_at_a_smaller_scale(factor):
    image, truth = board(240, 260, 30)
    config = DetectorConfig(detection=RingHarmonic(octaves=0), scale=factor, refinement=EdgeLines())
    corners = reference.detect(image, config)
    assert to_nearest(truth, corners.xy).max() < 0.2
    assert to_nearest(truth, corners.pixel).max() < 4
    working = reference.maps(image, config)
    assert working.maximum.shape == (round(240 * factor), round(260 * factor))
    y, x = np.nonzero(working.maximum)
    place = np.floor(scale.to_full(np.stack([x, y], axis=1).astype(float), factor) + 0.5)
    np.testing.assert_array_equal(corners.pixel, place)
