"""Virtual markers on the edges between neighbours."""

import dataclasses

import numpy as np
import pytest
from stereo_data import grid_of

from cmp_cl.grid import Grid, NodeStatus
from cmp_cl.grid.grid import Rival
from cmp_cl.grid.markers import profiles, refine_markers
from cmp_cl.opencl.device import select_device
from cmp_cl.reference.field import markers as oracle


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


def checkerboard(dtype: type, parity: int) -> tuple[np.ndarray, Grid]:
    """Return an image of cells of 16 px with soft edges, and the grid of its nodes."""
    y, x = np.mgrid[0:160, 0:200].astype(float)
    wave = np.tanh(np.sin((x - 10.3) * np.pi / 16) * 4) * np.tanh(
        np.sin((y - 20.6) * np.pi / 16) * 4
    )
    grey = 120 - (90 if parity == 0 else -90) * wave
    row, column = np.mgrid[0:8, 0:11]
    xy = np.stack([10.3 + 16.0 * column, 20.6 + 16 * row], -1)
    scale = 200 if dtype == np.uint16 else 1
    return np.rint(grey * scale).astype(dtype), dataclasses.replace(grid_of(xy), parity=parity)


@pytest.mark.parametrize("parity", [0, 1])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_markers_are_pulled_onto_their_edges(dtype, parity):
    image, grid = checkerboard(dtype, parity)
    dense = grid.with_virtual_markers(3)
    draw = np.random.default_rng(2)
    pushed = dense.xy + draw.uniform(-2, 2, dense.xy.shape).astype(np.float32)
    nodes = dense.status != NodeStatus.VIRTUAL
    pushed[nodes] = dense.xy[nodes]
    refined = refine_markers(dataclasses.replace(dense, xy=pushed), 3, image)
    np.testing.assert_array_equal(refined.xy[nodes], dense.xy[nodes])
    row, column = np.nonzero(dense.status == NodeStatus.VIRTUAL)
    across = np.where(row % 4 == 0, 1, 0)
    before = np.abs(pushed - dense.xy)[row, column, across]
    after = np.abs(refined.xy - dense.xy)[row, column, across]
    assert before.mean() > 0.9
    assert np.percentile(after, 95) < 0.5
    wrong = dataclasses.replace(dense, parity=1 - parity)
    np.testing.assert_array_equal(refine_markers(wrong, 3, image).xy, dense.xy)


@pytest.mark.parametrize("shape", [(1, 1), (37, 53), (160, 200)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_kernel_equals_the_oracle(shape, dtype):
    draw = np.random.default_rng(5)
    image, grid = checkerboard(dtype, 0)
    image = np.ascontiguousarray(image[: shape[0], : shape[1]])
    image += draw.integers(0, 12, image.shape).astype(dtype)
    dense = grid.with_virtual_markers(3)
    moved = dense.xy + draw.normal(0, 1, dense.xy.shape).astype(np.float32)
    dense = dataclasses.replace(dense, xy=moved)
    at = profiles(dense, 3)
    shift = oracle.refine_markers(image, at.pixel, at.line, at.reach, 20)
    expected = dense.xy.copy()
    expected[at.place[:, 0], at.place[:, 1]] += (
        np.where(np.isnan(shift), 0, shift)[:, None] * at.line[:, 2:]
    )
    refined = refine_markers(dense, 3, image, select_device().index)
    apart = np.abs(refined.xy - expected)[dense.valid].max(1)
    # rounding may decide on which side of a sample a crossing lies, or which of two is nearer
    assert np.count_nonzero(apart > 1e-3) <= 0.002 * len(apart)
