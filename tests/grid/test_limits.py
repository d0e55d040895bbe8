"""Input from which no grid is built: too many nodes, corners without a position."""

import numpy as np
import pytest
from lattices import board
from stereo_data import grid_of

from cmp_cl import GridError, build_grid


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        ((1500, 1500), "1500 x 1500 nodes is too large for 36 corners"),
        ((9999, 9999), "9999 x 9999 nodes is beyond the limit"),
        ((10**9, 10**9), "1000000000 x 1000000000 nodes is beyond the limit"),
    ],
)
def test_a_shape_far_larger_than_the_corners_is_refused_before_memory_is_allocated(shape, reason):
    with pytest.raises(GridError, match=reason):
        build_grid(board(6, 6).corners, shape=shape)


def test_more_markers_than_a_grid_may_have_nodes_are_refused():
    row, column = np.indices((3, 4))
    grid = grid_of(np.stack([column * 10.0, row * 10.0], axis=-1))
    assert grid.with_virtual_markers(9).shape == (21, 31)
    with pytest.raises(GridError, match="2000003 x 3000004 nodes is beyond"):
        grid.with_virtual_markers(10**6)


@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_corners_without_a_position_are_refused(value):
    corners = board(5, 5).corners
    corners.xy[3, 0] = value
    with pytest.raises(GridError, match="1 of the 25 corners have no finite position"):
        build_grid(corners)
