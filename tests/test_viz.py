"""Pictures: every corner is marked where it is, in the colour of its method."""

import numpy as np
import pytest

from cmp_cl.results import Corners, Method
from cmp_cl.viz import METHOD_COLOURS, corner_overlay


def corners_at(xy, method):
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    count = len(xy)
    return Corners(
        xy=xy,
        pixel=np.rint(xy).astype(np.int32),
        response=np.ones(count, np.float32),
        method=np.broadcast_to(np.uint8(method), (count,)).copy(),
        sigma=np.full(count, np.nan, np.float32),
        edges=np.full((count, 4), np.nan, np.float32),
        doubtful=np.zeros(count, bool),
        device="none",
    )


@pytest.mark.parametrize("method", Method)
def test_the_centre_of_the_marks_is_the_corner(method):
    image = np.full((100, 200), 128, np.uint8)
    xy = [[40.25, 50.5], [159.6, 20.0]]
    picture = corner_overlay(image, corners_at(xy, method))
    factor = 1000 // 200
    assert picture.shape == (100 * factor + 36, 1000, 3)
    rows, columns = np.nonzero((picture[: 100 * factor] != 128).any(axis=2))
    for x, y in xy:
        expected = np.array([(y + 0.5) * factor - 0.5, (x + 0.5) * factor - 0.5])
        distance = np.hypot(rows - expected[0], columns - expected[1])
        near = distance < 50
        assert distance[near].min() < 1  # the dot
        assert distance[near].max() > 10  # the circle
        centre = np.array([rows[near].mean(), columns[near].mean()])
        np.testing.assert_allclose(centre, expected, atol=0.15)


def test_colours_and_legend_tell_the_methods_apart():
    assert len(set(METHOD_COLOURS.values())) == len(Method)
    image = np.full((400, 900), 128, np.uint8)
    xy = [[100 + 120 * method, 200] for method in Method]
    picture = corner_overlay(image, corners_at(xy, list(Method)))
    for method in Method:
        marked = (picture == METHOD_COLOURS[method]).all(axis=2)
        assert marked[:-36].any(), method.name
        assert marked[-36:].any(), f"{method.name} in the legend"


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (3, 2000), (2500, 10)])
def test_any_size_can_be_drawn(shape):
    image = np.zeros(shape, np.uint8)
    picture = corner_overlay(image, corners_at([], Method.KEPT))
    assert picture.dtype == np.uint8
    assert picture.shape[0] >= shape[0] + 36
    assert picture.shape[1] >= shape[1]


def test_an_image_of_any_depth_is_stretched_to_be_seen_and_left_as_it_was():
    deep = np.full((600, 1200), 1000, np.uint16)
    deep[:, :600] = 4000
    before = deep.copy()
    picture = corner_overlay(deep, corners_at([], Method.KEPT))
    assert set(np.unique(picture[:1200])) == {64, 255}
    np.testing.assert_array_equal(deep, before)


def test_small_cells_are_enlarged_until_they_can_be_judged():
    x, y = np.meshgrid(np.arange(5, 595, 8), np.arange(5, 395, 8))
    corners = corners_at(np.column_stack([x.ravel(), y.ravel()]), Method.EDGE_LINES)
    picture = corner_overlay(np.zeros((400, 600), np.uint8), corners)
    assert picture.shape[:2] == (400 * 4 + 36, 600 * 4)
