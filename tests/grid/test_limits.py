"""Input from which no grid is built: too many nodes, corners without a position."""

import dataclasses

import numpy as np
import pytest
from stereo_data import grid_of

from cmp_cl import GridError, build_grid, detect
from cmp_cl.synthetic import Scene, render


@pytest.fixture(scope="module")
def corners():
    return detect(render(Scene(markers=5, shape=(120, 120))).image)


def test_a_shape_beyond_all_patterns_is_refused_before_memory_is_allocated(corners):
    with pytest.raises(GridError, match="100000 x 100000 nodes is beyond the limit"):
        build_grid(corners, shape=(100_000, 100_000))


def test_more_markers_than_a_grid_may_have_nodes_are_refused():
    row, column = np.indices((3, 4))
    grid = grid_of(np.stack([column * 10.0, row * 10.0], axis=-1))
    assert grid.with_virtual_markers(9).shape == (21, 31)
    with pytest.raises(GridError, match="2000003 x 3000004 nodes is beyond"):
        grid.with_virtual_markers(10**6)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_corners_without_a_position_are_refused(corners, value):
    xy = corners.xy.copy()
    xy[2, 1] = value
    with pytest.raises(GridError, match=r"1 of the .* corners have no finite position"):
        build_grid(dataclasses.replace(corners, xy=xy))
