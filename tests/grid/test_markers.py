"""Virtual markers on the edges between neighbours."""

import dataclasses

import numpy as np
import pytest
from stereo_data import grid_of

from cmp_cl.grid import Grid, NodeStatus
from cmp_cl.grid.grid import Rival


def regular(rows: int, columns: int) -> Grid:
    row, column = np.mgrid[:rows, :columns] * 10.0
    return grid_of(np.stack([column + 0.1 * row, row], axis=2), 0.1)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_nodes_stay_where_they_are_and_markers_divide_the_edges(count):
    grid = regular(6, 9)
    dense = grid.with_virtual_markers(count)
    times = count + 1
    assert dense.shape == (5 * times + 1, 8 * times + 1)
    np.testing.assert_array_equal(dense.xy[::times, ::times], grid.xy)
    np.testing.assert_array_equal(dense.status[::times, ::times], grid.status)
    np.testing.assert_array_equal(dense.sigma[::times, ::times], grid.sigma)
    np.testing.assert_array_equal(dense.xy[tuple(dense.index.T)], grid.xy.reshape(-1, 2))
    assert np.isnan(dense.sigma[dense.status == NodeStatus.VIRTUAL]).all()
    row, column = np.indices(dense.shape)
    np.testing.assert_array_equal(dense.valid, (row % times == 0) | (column % times == 0))


def test_numbers_and_doubts_of_the_nodes_remain():
    grid = dataclasses.replace(regular(6, 9), origin=(-2, 1), confidence=0.0, rival=Rival(1, -1))
    dense = grid.with_virtual_markers(3)
    assert dense.origin == (-8, 4)
    assert dense.ambiguous
    assert dense.rival == Rival(4, -4)
    asked = dataclasses.replace(grid, seen_shape=(7, 9)).with_virtual_markers(1)
    assert asked.doubts[0] == "the board looks like 13 x 17 corners; 11 x 17 were asked for"


def test_markers_lie_on_a_parabola_through_the_nodes():
    row, column = np.mgrid[0:25, 0:25] / 4
    x = 20 * column + 0.4 * column**2 - 0.2 * row**2
    y = 15 * row + 0.3 * row**2 + 0.5 * column**2
    wanted = np.stack([x, y], axis=-1)
    dense = grid_of(wanted[::4, ::4]).with_virtual_markers(3)
    assert np.abs(dense.xy - wanted)[dense.valid].max() < 1e-4


def test_an_edge_without_one_of_its_nodes_has_no_markers():
    row, column = np.mgrid[0:5, 0:5] * 10.0
    xy = np.stack([column, row], -1)
    xy[2, 2] = np.nan
    dense = grid_of(xy).with_virtual_markers(3)
    assert not dense.valid[8, 5:12].any()
    assert not dense.valid[5:12, 8].any()
    assert dense.valid.sum() == 24 + 3 * (40 - 4)
    at = np.argwhere(dense.valid)
    np.testing.assert_allclose(dense.xy[dense.valid], at[:, ::-1] * 2.5, atol=1e-5)
