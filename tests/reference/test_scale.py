"""The working scale of the oracle."""

import cv2
import numpy as np
import pytest
from corner_images import board, noise, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, EdgeLines, RingHarmonic
from cmp_cl.reference import scale


@pytest.mark.parametrize("factor", [0.05, 0.3, 0.5, 0.75, 1.1, 2.0, 3.7])
@pytest.mark.parametrize("length", [1, 2, 7, 100])
def test_weights_are_of_pixels_in_the_image_and_add_up_to_2048(factor, length):
    index, weight = scale.weights(length, factor)
    assert len(index) == max(1, int(length * factor + 0.5))
    assert (weight >= 0).all()
    assert (weight.sum(axis=1) == 2048).all()
    assert index.min() >= 0
    assert index.max() < length


def test_weights_at_three_quarters_are_those_worked_out_by_hand():
    index, weight = scale.weights(4, 0.75)
    # Intervals 0..4/3, 4/3..8/3, 8/3..4: shares 3/4 1/4, 1/2 1/2, 1/4 3/4.
    assert index.tolist() == [[0, 1], [1, 2], [2, 3]]
    assert weight.tolist() == [[1536, 512], [1024, 1024], [512, 1536]]


def test_weights_at_double_scale_are_those_worked_out_by_hand():
    index, weight = scale.weights(2, 2.0)
    # Positions -1/4, 1/4, 3/4, 5/4; the border pixel is repeated.
    assert index.tolist() == [[0, 0], [0, 1], [0, 1], [1, 1]]
    assert weight.tolist() == [[512, 1536], [1536, 512], [512, 1536], [1536, 512]]


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
