"""Corners are numbered by row and column."""

import copy
import json
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from cases import some
from configs import rings
from lattices import board, drawn, joined, keep

from cmp_cl import detect, reference, synthetic
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.errors import GridError, ImageError
from cmp_cl.grid import Grid, NodeStatus, build_grid, build_grids
from cmp_cl.grid.grow import drop_misfits
from cmp_cl.grid.joints import cut
from cmp_cl.grid.lattice import _counted, lattice, lines_of, near_pairs
from cmp_cl.grid.nodes import Nodes, boxed
from cmp_cl.grid.predict import mean_steps, predict, predict_all, predict_some, predict_within
from cmp_cl.grid.second_look import RINGS, _look, edge_lines, ring, second_look

DATA = Path(__file__).parents[3] / "shared" / "data"
MEASURED = [NodeStatus.DETECTED, NodeStatus.ATTACHED, NodeStatus.SECOND_LOOK]


def right(grid: Grid, index: np.ndarray) -> np.ndarray:
    """Return which true corners in the grid have their own row and column."""
    there = (grid.index[:, 0] >= 0) & (index[:, 0] >= 0)
    return (grid.index == index).all(1)[there]


@pytest.mark.parametrize("shape", [None, (44, 40)])
def test_a_warped_board_is_numbered(shape):
    corners, index, truth = board(44, 40)
    grid = build_grid(corners, shape=shape)
    np.testing.assert_array_equal(grid.index, index)
    assert grid.shape == (44, 40)
    assert (grid.status == NodeStatus.DETECTED).all()
    assert np.abs(grid.xy @ [1, 1j] - truth).max() < 1.5  # px; the jitter is 0.2 px per axis
    np.testing.assert_array_equal(grid.xy[tuple(index.T)], corners.xy)
    np.testing.assert_array_equal(grid.sigma[tuple(index.T)], corners.sigma)


def test_a_grid_prints_its_content_in_one_line():
    corners, _, _ = board(8, 11)
    assert repr(build_grid(corners)) == "<Grid of 8 x 11 nodes: 88 detected>"
    assert repr(corners) == f"<Corners: 88, found on {corners.device}>"


@pytest.mark.parametrize("seed", range(6))
def test_lost_and_false_corners_do_not_shift_the_numbers(seed):
    corners, index, _ = board(44, 44, lost=0.03, false=0.1, seed=seed)
    grid = build_grid(corners, shape=(44, 44))
    assert right(grid, index).all()
    assert len(right(grid, index)) > 0.99 * (index[:, 0] >= 0).sum()
    assert (index[grid.index[:, 0] >= 0, 0] < 0).sum() < 5


def test_numbers_are_right_with_a_tenth_of_the_corners_lost_and_half_as_many_false_ones():
    corners, index, _ = board(30, 30, lost=0.1, false=0.5, seed=1)
    grid = build_grid(corners, shape=(30, 30))
    assert right(grid, index).mean() > 0.98
    assert len(right(grid, index)) > 0.9 * (index[:, 0] >= 0).sum()


@pytest.mark.parametrize("seed", [2, 35, 222, 231, 273, 309, 344])
def test_false_cells_do_not_join_parts_of_different_numbers(seed):
    corners, index, _ = board(
        36, 36, lost=0.1, false=0.4, seed=seed, jitter=0.4, twist=0.5, pull=2.0
    )
    z = corners.xy @ np.array([1, 1j])
    found = lattice(z.astype(np.complex64), lines_of(corners.edges))
    found = cut(found, boxed(z, found)) or found
    member = (found.component == 0) & (index[:, 0] >= 0)
    assert member.sum() > 300
    place = index[member] @ np.array([1j, 1])
    shifts = [found.node[member] * 1j**quarter - place for quarter in range(4)]
    assert min(len(np.unique(np.rint(shift))) for shift in shifts) == 1


@pytest.mark.parametrize("quarters", range(4))
def test_rows_run_down_and_columns_right_however_the_camera_is_rotated(quarters):
    corners, index, _ = board(12, 9, rotation=0.1 + quarters * np.pi / 2)
    grid = build_grid(corners)
    row, column = index.T
    row, column = [
        (row, column),
        (column, 11 - row),
        (11 - row, 8 - column),
        (8 - column, row),
    ][quarters]
    np.testing.assert_array_equal(grid.index, np.stack([row, column], axis=1))


@pytest.mark.parametrize("black", [True, False])
def test_the_parity_is_the_colour_of_the_first_cell(black):
    assert build_grid(board(8, 8, black=black).corners).parity == (not black)
    corners, index, _ = board(8, 8, black=black)
    rest = keep(corners, index[:, 0] > 0)
    assert build_grid(rest).parity == black


def with_middles(share: float) -> Corners:
    """Return the corners of a board and corners in the middle of that share of its cells, with
    edges along the diagonals."""
    whole = board(10, 10, jitter=0.0)
    at = whole.truth
    middles = ((at[1:, 1:] + at[:-1, :-1]) / 2).ravel()
    middles = middles[: round(share * len(middles))]
    nodes = len(whole.corners)
    both = keep(whole.corners, np.arange(nodes + len(middles)) % nodes)
    both.xy[nodes:] = np.stack([middles.real, middles.imag], axis=1)
    both.edges[nodes:] = np.angle(at[1, 1] - at[0, 0]) + np.arange(4) * np.pi / 2
    return both


def test_a_lattice_that_leaves_out_the_corners_between_its_rows_is_refused():
    corners = with_middles(1.0)
    with pytest.raises(GridError, match="the lattice of 100 nodes leaves out corners"):
        build_grid(corners)
    assert build_grids(corners) == []


def test_marks_in_half_of_the_cells_are_no_corners_that_are_left_out():
    corners = with_middles(0.5)
    assert build_grid(corners).shape == (10, 10)
    assert [grid.shape for grid in build_grids(corners)] == [(10, 10)]


@pytest.mark.parametrize("seed", range(4))
def test_part_of_a_pressed_pattern_is_numbered_as_at_rest(seed):
    rest = build_grid(board(24, 24, pull=0, twist=0, black=False).corners)
    corners, index, _ = board(24, 24, pull=2.5, black=False, lost=0.05, false=0.1, seed=seed)
    seen = (index[:, 0] >= 3 + seed) & (index[:, 1] < 20)
    grid = build_grid(keep(corners, seen), like=rest)
    assert grid.shape == (24, 24)
    assert right(grid, index[seen]).all()
    assert (grid.status[: 3 + seed] == NodeStatus.MISSING).all()
    assert np.isnan(grid.xy[: 3 + seed]).all()
    assert grid.parity == rest.parity


@pytest.mark.parametrize("quarters", range(4))
def test_part_of_a_pattern_is_numbered_as_at_rest_in_any_orientation(quarters):
    corners, index, _ = board(24, 20, pull=0, twist=0)
    rest = build_grid(corners).turned(quarters)
    numbers = np.empty((24, 20, 2), int)
    numbers[tuple(index.T)] = rest.index
    now, index, _ = board(24, 20, pull=1.0, seed=1)
    lower, upper = index.min(1) > 2, (index[:, 0] < 21) & (index[:, 1] < 17)
    for seen in (index[:, 0] >= 0, lower, upper, index[:, 1] > 5):
        grid = build_grid(keep(now, seen), like=rest)
        assert grid.shape == rest.shape
        np.testing.assert_array_equal(grid.index, numbers[tuple(index[seen].T)])


def test_a_whole_pattern_that_moved_by_cells_keeps_its_numbers():
    rest = build_grid(board(10, 10, pull=0, twist=0).corners)
    corners, index, _ = board(10, 10, pull=0, twist=0, origin=60 + 50j + 13 * (2 + 2j))
    np.testing.assert_array_equal(build_grid(corners, like=rest).index, index)


def test_the_colour_of_the_cells_tells_which_part_of_a_board_is_out_of_view():
    rest = build_grid(board(10, 10, pull=0, twist=0).corners)
    corners, index, _ = board(10, 10, pull=0, twist=0, origin=60 + 50j + 13 * (6 + 6j))
    for seen in (index[:, 0] > 0, index[:, 0] < 9, index[:, 1] > 0, index[:, 1] < 9):
        grid = build_grid(keep(corners, seen), like=rest)
        np.testing.assert_array_equal(grid.index, index[seen])


def test_the_colour_of_the_cells_decides_if_a_view_moved_by_most_of_a_cell():
    rest = build_grid(board(12, 12, pull=0, twist=0, rotation=0).corners)
    corners, index, _ = board(12, 12, pull=0, twist=0, rotation=0, origin=60 + 50j + 0.7 * 13)
    seen = (index[:, 1] > 0) & (index[:, 1] < 9)
    grid = build_grid(keep(corners, seen), like=rest)
    np.testing.assert_array_equal(grid.index, index[seen])


def test_the_colour_of_the_cells_decides_if_all_but_one_column_seem_in_place():
    corners, index, _ = board(12, 13, pull=0, twist=0, rotation=0)
    rest = build_grid(keep(corners, index[:, 1] < 12))
    corners, index, _ = board(
        12, 13, pull=0, twist=0, rotation=0, origin=60 + 50j - 0.6 * 13, seed=1
    )
    seen = index[:, 1] > 0
    grid = build_grid(keep(corners, seen), like=rest)
    assert grid.shape == (12, 13)
    np.testing.assert_array_equal(grid.index, index[seen])


def test_junctions_with_the_surround_do_not_move_the_window():
    corners, index, _ = board(8, 8, pull=0, twist=0)
    rim = index[:, 0] == 0
    corners.edges[rim, 1] += 0.9
    grid = build_grid(corners, shape=(7, 8))
    np.testing.assert_array_equal(grid.index[~rim], index[~rim] - [1, 0])


@pytest.mark.parametrize("sign", [1, -1])
def test_a_rotated_grid_at_rest_gives_its_orientation(sign):
    sideways = build_grid(board(9, 14, rotation=sign * 0.6).corners)
    now = board(9, 14, rotation=sign * 0.9, pull=0.5, twist=0.1)
    by_axes = build_grid(now.corners)
    assert by_axes.shape == (14, 9)
    grid = build_grid(now.corners, like=sideways)
    assert grid.shape == (9, 14)
    np.testing.assert_array_equal(grid.index, now.index)


def test_a_shape_with_rows_and_columns_exchanged_rotates_the_numbers():
    corners, index, _ = board(6, 9)
    grid = build_grid(corners, shape=(9, 6))
    assert grid.valid.all()
    turned = np.stack([8 - index[:, 1], index[:, 0]], axis=1)
    other = np.stack([index[:, 1], 5 - index[:, 0]], axis=1)
    assert (grid.index == turned).all() or (grid.index == other).all()


@pytest.mark.parametrize("sign", [1, -1])
def test_a_known_shape_keeps_its_numbers_beyond_a_rotation_by_45_degrees(sign):
    before, after = (board(6, 9, rotation=sign * rotation, twist=0) for rotation in (0.74, 0.84))
    np.testing.assert_array_equal(build_grid(before.corners, shape=(6, 9)).index, before.index)
    np.testing.assert_array_equal(build_grid(after.corners, shape=(6, 9)).index, after.index)


def test_a_hole_is_filled_by_its_neighbours_and_marked():
    corners, index, truth = board(12, 12, jitter=0.0)
    lost = (index == [5, 6]).all(1) | (index == [8, 3]).all(1)
    grid = build_grid(keep(corners, ~lost))
    assert (grid.status == NodeStatus.INTERPOLATED).sum() == 2
    for row, column in ((5, 6), (8, 3)):
        assert grid.status[row, column] == NodeStatus.INTERPOLATED
        assert abs(grid.xy[row, column] @ [1, 1j] - truth[row, column]) < 0.6
        assert np.isnan(grid.sigma[row, column])


def test_nothing_is_invented_beyond_the_pattern():
    corners, index, _ = board(12, 12)
    seen = index.sum(1) >= 6
    grid = build_grid(keep(corners, seen), shape=(12, 12))
    row, column = np.indices((12, 12))
    np.testing.assert_array_equal(grid.status == NodeStatus.MISSING, row + column < 6)
    np.testing.assert_array_equal(grid.valid, row + column >= 6)


def test_a_corner_without_edges_is_attached_by_its_position():
    corners, index, _ = board(12, 12)
    blind = (index == [5, 6]).all(1)
    corners.edges[blind] = np.nan
    grid = build_grid(corners)
    np.testing.assert_array_equal(grid.index, index)
    assert grid.status[5, 6] == NodeStatus.ATTACHED
    assert grid.sigma[5, 6] == corners.sigma[blind]


def test_a_corner_of_the_other_colour_is_not_attached():
    corners, index, _ = board(12, 12)
    other = (index == [5, 6]).all(1)
    corners.edges[other] = corners.edges[other][:, [1, 2, 3, 0]]
    grid = build_grid(corners)
    assert grid.status[5, 6] == NodeStatus.INTERPOLATED
    assert (grid.index[other] == -1).all()


def test_a_corner_far_from_its_neighbours_prediction_is_dropped():
    corners, index, truth = board(12, 12, jitter=0.0)
    strayed = (index == [5, 6]).all(1)
    corners.xy[strayed] += [4.5, 2.0]
    grid = build_grid(corners)
    assert (grid.index[strayed] == -1).all()
    assert (grid.index[~strayed] == index[~strayed]).all()
    assert abs(grid.xy[5, 6] @ [1, 1j] - truth[5, 6]) < 0.6


def test_two_boards_are_refused_unless_a_region_selects_one():
    first = board(9, 9, pull=0)
    second = board(8, 9, pull=0, origin=260 + 50j)
    both = joined(first, second)
    with pytest.raises(GridError, match="two patterns are seen, of 81 and 72 corners"):
        build_grid(both)
    assert build_grid(both, region=(30, 0, 210, 400)).shape == (9, 9)
    grid = build_grid(both, region=(230, 0, 500, 400))
    assert grid.shape == (8, 9)
    assert (grid.index[both.xy[:, 0] < 230] == -1).all()


def test_a_small_second_board_is_left_out():
    both = joined(board(12, 12, pull=0), board(4, 4, pull=0, origin=300 + 50j))
    grid = build_grid(both)
    assert grid.shape == (12, 12)
    assert (grid.index >= 0).all(1).sum() == 144


def test_a_lattice_of_few_of_the_corners_is_refused():
    corners = board(3, 3, false=60.0, seed=3).corners
    with pytest.raises(GridError, match="has 4 of 549 corners, expected at least 55;"):
        build_grid(corners)


@pytest.mark.parametrize("side", [6, 9])
def test_a_grid_that_keeps_few_of_the_corners_is_refused(side):
    image, at = drawn(side, side)
    corners = detect(image)
    rows, columns = image.shape
    blocks = np.random.default_rng(0).choice([40, 190], (rows // 6 + 1, columns // 6 + 1))
    texture = blocks.repeat(6, 0).repeat(6, 1)[:rows, :columns]
    y, x = np.indices(image.shape)
    centre = at[side // 2, side // 2]
    image = np.where(np.hypot(x - centre[0], y - centre[1]) > 28, texture, image)
    with pytest.raises(GridError, match=rf"has \d of {side**2} corners, expected at least 9;"):
        build_grid(corners, image.astype(np.uint8))


def test_a_second_look_alone_does_not_complete_a_known_shape():
    image, at = drawn(8, 4)
    left, top = (at[0, 0] + 0.5).astype(int) - (0, 20)  # a place on the border
    image[top - 12 : top, left : left + 12] = image[top + 10, left - 10]
    corners = detect(image)
    missed = np.abs(corners.xy - (left, top)).max(axis=1) < 5
    assert missed.sum() == 1
    assert build_grid(keep(corners, ~missed), image, shape=(9, 4)).doubts


def test_a_tiny_board_with_gaps_is_not_taken_for_the_asked_size_beside_a_full_board():
    large = board(6, 9, cell=40, pull=0)
    tiny = board(6, 8, cell=6, pull=0, jitter=0.05, origin=500 + 50j)
    gap = (tiny.index == (0, 0)).all(1) | (tiny.index == (5, 7)).all(1)
    torn = tiny._replace(corners=keep(tiny.corners, ~gap))
    grid = build_grid(joined(large, torn), shape=(6, 8))
    assert grid.doubts == ["the board looks like 6 x 9 corners; 6 x 8 were asked for"]
    assert (grid.xy[..., 0] < 480).all()
    whole = build_grid(joined(large, tiny), shape=(6, 8))
    assert not whole.doubts
    assert (whole.xy[..., 0] > 480).all()


def test_a_lattice_of_few_corners_is_no_board_among_many_others_unless_a_board_is_so_small():
    corners = board(2, 4, false=4.0, seed=0).corners
    with pytest.raises(GridError, match="has 6 of 40 corners, expected at least 9;"):
        build_grid(corners)
    assert build_grid(board(2, 4).corners).valid.sum() == 8


def test_without_corners_the_grid_is_empty_or_of_the_known_shape():
    corners, index, _ = board(9, 9)
    for few in (index[:, 0] < 0, index[:, 0] == 4, (index == 4).all(1)):
        grid = build_grid(keep(corners, few))
        assert grid.shape == (0, 0)
        assert grid.index.shape == (few.sum(), 2)
        assert (grid.index == -1).all()
        known = build_grid(keep(corners, few), shape=(9, 9))
        assert known.shape == (9, 9)
        assert not known.valid.any()


def marked_board(seed, marks=True, cell=16):
    """Return 7 x 8 squares, each with a square of the other colour in it, behind spots."""
    draw = np.random.default_rng(seed)
    side = 4 * cell
    image = np.full((9 * side, 10 * side), 230, np.uint8)
    for row, column in np.ndindex(7, 8):
        ink, other = (30, 230) if (row + column) % 2 == 0 else (230, 30)
        square = image[(row + 1) * side :, (column + 1) * side :][:side, :side]
        square[:] = ink
        margin = int(side * draw.uniform(0.2, 0.5)) if marks else side
        square[margin : side - margin, margin : side - margin] = other
    for _ in range(6 * marks):
        centre, radius = draw.uniform(0, 8 * side, 2).astype(int), draw.uniform(0.3, 2) * side
        cv2.circle(image, centre.tolist(), int(radius), draw.uniform(0, 255), -1)
    small = cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return np.rint(cv2.GaussianBlur(small, (0, 0), 0.7)).astype(np.uint8)


@pytest.mark.parametrize("seed", [14, 51, 86, 1748])
def test_a_board_whose_marks_hide_its_squares_gives_right_nodes_or_none(seed):
    plain = marked_board(0, marks=False)
    rest = build_grid(detect(plain), plain)
    assert rest.shape == (6, 7)
    image = marked_board(seed)
    corners = detect(image)
    assert len(corners) > 40
    for known in ({"shape": (6, 7)}, {"shape": (8, 9)}, {"like": rest}, {}):
        try:
            grid = build_grid(corners, image, **known)
        except GridError:
            continue
        xy = grid.xy[grid.valid] / 16
        assert np.abs(xy - np.rint(xy)).max(initial=0) < 0.25


@pytest.mark.parametrize("seed", [14, 52])
def test_the_edge_of_a_spot_is_not_taken_for_the_edge_of_a_torn_corner(seed):
    scene = synthetic.render(synthetic.random_scene(seed, markers=20))
    image, draw = scene.image.copy(), np.random.default_rng(seed)
    rows, columns = image.shape
    for _ in range(10):
        x, y = draw.uniform(0, columns, 2) * [1, rows / columns]
        radius, grey = int(draw.uniform(0.6, 1.6) * scene.cell), int(draw.uniform(20, 230))
        cv2.circle(image, (int(x), int(y)), radius, grey, -1, cv2.LINE_AA)
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    corners = detect(image, DetectorConfig.for_cell(scene.cell))
    grid = build_grid(corners, image, shape=(20, 20))
    xy, truth = grid.xy[np.isin(grid.status, MEASURED)], scene.truth.reshape(-1, 2)
    error = np.linalg.norm(xy[:, None] - truth, axis=2).min(axis=1)
    assert len(xy) > 350
    assert error.max() < 0.2 * scene.cell


def test_requests_that_make_no_sense_are_refused():
    corners = board(6, 6).corners
    rest = build_grid(corners)
    for shape in ((0, 6), 6, "66", (6.0, 6.0), (True, 6), (6, 6, 6)):
        with pytest.raises(GridError, match="shape must be"):
            build_grid(corners, shape=shape)
    with pytest.raises(GridError, match="has \\(6, 6\\)"):
        build_grid(corners, shape=(5, 6), like=rest)
    for region in ((50, 0, 40, 10), (0, 0, 40), "left", (0, 0, np.nan, 10)):
        with pytest.raises(GridError, match="region must be"):
            build_grid(corners, region=region)
    with pytest.raises(GridError, match="like must be of type Grid, not Corners"):
        build_grid(corners, like=corners)
    with pytest.raises(GridError, match="corners must be of type Corners, not ndarray"):
        build_grid(corners.xy)
    with pytest.raises(GridError, match="has no nodes"):
        build_grid(corners, like=build_grid(keep(corners, corners.xy[:, 0] < 0)))
    with pytest.raises(ImageError):
        build_grid(corners, np.zeros((10, 10)))
    with pytest.raises(ImageError, match="the image that they were found in"):
        build_grid(corners, np.zeros((10, 10), np.uint8))
    corners.edges[:] = np.nan
    with pytest.raises(GridError, match="no edge angles"):
        build_grid(corners)


def test_a_prediction_is_the_weighted_mean_of_those_from_cubics_lines_and_parallelograms():
    t = np.arange(7.0)
    line = t**3 + 1j * (t**2 - t)
    row = np.tile(line, (7, 1)) + 1j * np.arange(7)[:, None] * 9
    at, weight = predict(row, np.array([3]), np.array([3]))
    # Cubics along both axes, the column's lines and the parallelograms are exact here.
    exact = 27 + 33j
    off = 4 * (9 + 1j) + 0.7 * ((-24 - 2j) + (-12 - 2j) + 6 - 6)  # px, times the weights
    assert abs(at[0] - (exact + off / 43.6)) < 1e-10
    assert weight[0] == pytest.approx(2 * 12 + 2 * 4 + 4 * 1.5 + 8 * 0.7)
    alone = np.full((7, 7), complex(np.nan, np.nan))
    alone[3, [1, 2, 4, 5]] = line[[1, 2, 4, 5]]
    at, weight = predict(alone, np.array([3]), np.array([3]))
    expected = (12 * (27 + 6j) + 4 * (36 + 7j) + 0.7 * ((15 + 4j) + (3 + 4j))) / 17.4
    assert abs(at[0] - expected) < 1e-12
    assert weight[0] == pytest.approx(17.4)


def test_a_mean_step_includes_the_steps_of_the_nodes_around():
    column, row = np.meshgrid(np.arange(7.0), np.arange(6.0))
    at = (column**2 + 20 * column) + 1j * (row**2 + 30 * row)
    along, down, cell = mean_steps(at, np.array([2, 0]), np.array([3, 0]))
    np.testing.assert_allclose(along, [26, 20 + (2 * 1 + 1 * 3) / 3])
    np.testing.assert_allclose(down, [34j, (30 + (2 * 1 + 1 * 3) / 3) * 1j])
    np.testing.assert_allclose(cell, (np.abs(along) + np.abs(down)) / 2)
    at[:] = complex(np.nan, np.nan)
    at[2, 3:5] = 1, 21
    along, down, cell = mean_steps(at, np.array([2, 5]), np.array([3, 0]))
    assert (along[0], cell[0]) == (20, 20)
    assert np.isnan([down[0], along[1], cell[1]]).all()


def test_nodes_are_predicted_alike_at_once_and_one_by_one():
    at = board(12, 9).truth
    at[2, 7] = complex(np.nan, np.nan)
    row, column = (index.ravel() for index in np.indices(at.shape))
    one_by_one, weight = predict(at, row, column)
    at_once, weights = predict_all(nodes_at(at))
    np.testing.assert_allclose(at_once.ravel(), one_by_one, rtol=0, atol=1e-10)
    np.testing.assert_allclose(weights.ravel(), weight, rtol=0, atol=1e-10)
    whole = weight > weight.max() - 0.1
    assert 0 < whole.sum() < len(whole)
    np.testing.assert_array_equal(~np.isnan(predict_within(at).ravel()), whole)


@pytest.mark.parametrize("change", ["put", "pad", "crop", "turned"])
def test_a_node_that_changes_changes_the_predictions_of_its_neighbours(change):
    at = board(9, 9).truth
    at[0] = complex(np.nan, np.nan)
    nodes = nodes_at(at)
    predict_all(nodes)
    if change == "put":
        nodes.put(np.array([4]), np.array([4]), at[4, 4] + 3, NodeStatus.DETECTED)
    elif change == "turned":
        nodes = nodes.turned(1)
    else:
        getattr(nodes, change)()
    predicted, weight = predict_some(nodes, np.array([4]), np.array([3]))
    again, weight_again = predict(nodes.at, np.array([4]), np.array([3]))
    np.testing.assert_allclose(predicted, again, rtol=0, atol=1e-10)
    np.testing.assert_allclose(weight, weight_again, rtol=0, atol=1e-10)


def nodes_at(at):
    nodes = Nodes(at.shape, 0, np.zeros(0, np.bool_))
    row, column = np.nonzero(~np.isnan(at.real))
    nodes.put(row, column, at[row, column], NodeStatus.DETECTED)
    return nodes


def pattern(at):
    """Return these nodes as a pattern without misfits."""
    nodes = nodes_at(at)
    drop_misfits(nodes)
    return nodes


@pytest.mark.parametrize("seed", range(8))
def test_a_search_around_the_changes_alone_finds_all_misfits(seed):
    draw = np.random.default_rng(seed)
    at = board(30, 26).truth
    everywhere = pattern(at)
    assert (everywhere.status == NodeStatus.DETECTED).all()
    assert not everywhere.changed.any()
    around = copy.deepcopy(everywhere)
    row, column = draw.integers(0, 26, (2, 12))
    strayed = at[row, column] + 7 * np.exp(1j * draw.uniform(-np.pi, np.pi, 12))
    for nodes in (everywhere, around):
        nodes.put(row, column, strayed, NodeStatus.SECOND_LOOK)
    everywhere.changed[:] = True
    drop_misfits(everywhere)
    drop_misfits(around)
    assert 8 < (everywhere.status == NodeStatus.MISSING).sum() < 20
    np.testing.assert_array_equal(around.status, everywhere.status)


def test_a_node_is_looked_at_again_when_its_neighbours_come():
    whole = board(20, 20, jitter=0.0).truth
    whole[9, 10] += 6j
    alone = whole.copy()
    alone[6:13, 7:14] = np.nan
    alone[9, 10] = whole[9, 10]
    nodes = pattern(alone)
    assert nodes.status[9, 10] == NodeStatus.DETECTED
    row, column = np.nonzero(nodes.status == NodeStatus.MISSING)
    nodes.put(row, column, whole[row, column], NodeStatus.SECOND_LOOK)
    drop_misfits(nodes)
    np.testing.assert_array_equal(np.argwhere(nodes.status == NodeStatus.MISSING), [[9, 10]])


@pytest.mark.parametrize(("seed", "strayed"), [(0, 4), (20, 5), (69, 4), (204, 6), (209, 8)])
def test_no_misfit_is_left_if_many_nodes_stray(seed, strayed):
    draw = np.random.default_rng(seed)
    at = board(24, 24, pull=0, twist=0, jitter=0.0).truth
    astray = draw.uniform(-strayed, strayed, (2, 12, 12))
    at[6:18, 6:18] += astray[0] + 1j * astray[1]
    nodes = pattern(at)
    left = nodes.status.copy()
    nodes.changed[:] = True
    drop_misfits(nodes)
    np.testing.assert_array_equal(nodes.status, left)
    assert (left == NodeStatus.MISSING).sum() > 8


def test_the_same_corners_give_the_same_bytes():
    corners, _, _ = board(20, 20, lost=0.05, false=0.2)
    first, second = build_grid(corners), build_grid(corners)
    assert first.xy.tobytes() == second.xy.tobytes()
    assert first.index.tobytes() == second.index.tobytes()


def test_numbering_is_quick():
    corners, _, _ = board(44, 44)
    z = (corners.xy @ np.array([1, 1j])).astype(np.complex64)
    times = []
    for _ in range(60):
        start = time.perf_counter()
        lattice(z, lines_of(corners.edges))
        times.append(time.perf_counter() - start)
    assert min(times) < 6e-3  # s: about 1 ms; a loop over corners would take 20 ms


@pytest.mark.parametrize(
    ("wide", "high", "outlier"),
    [(600, 400, False), (600, 3, False), (3, 600, False), (900, 600, True)],
)
def test_near_pairs_are_all_pairs_as_near_as_the_farthest_of_them(wide, high, outlier):
    random = np.random.default_rng(5)
    z = random.uniform(0, wide, 400) + 1j * random.uniform(0, high, 400)
    z = np.append(z, 4000 + 3000j if outlier else 1j).astype(np.complex64)
    order, first, second, step = near_pairs(z)
    np.testing.assert_array_equal(step, z[order[second]] - z[order[first]])
    assert (first < second).all()
    away = np.abs(z[order][:, None] - z[order])
    every = np.triu(away <= np.abs(step).max(), 1)
    assert len(first) == np.count_nonzero(every) > len(z)
    assert every[first, second].all()


@pytest.fixture
def answers(monkeypatch):
    """Return a list that gets the numbers by counting along links, None where votes decide."""
    found = []

    def counted(*arguments):
        found.append(_counted(*arguments))
        return found[-1]

    monkeypatch.setattr("cmp_cl.grid.lattice._counted", counted)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_links_that_agree_give_the_components_that_votes_give(monkeypatch, answers, seed):
    corners = board(20, 16, lost=0.25, seed=seed).corners
    z = (corners.xy @ np.array([1, 1j])).astype(np.complex64)
    one = lattice(z, lines_of(corners.edges))
    assert answers[0] is not None
    monkeypatch.setattr("cmp_cl.grid.lattice._counted", lambda *_: None)
    other = lattice(z, lines_of(corners.edges))
    assert len(one.size) > 1
    for name in ("component", "size", "support"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for component in range(len(one.size)):
        member = one.component == component
        rotation = one.turn[member] / other.turn[member]
        assert (rotation == rotation[0]).all()
        shift = one.node[member] - rotation[0] * other.node[member]
        assert (shift == shift[0]).all()


@pytest.mark.parametrize("back", range(4))
def test_a_link_that_contradicts_the_frames_of_its_corners_leaves_the_numbers_to_votes(back):
    lines = np.array([[1, 1], [1j, 1j]], np.complex64)
    trees = _counted(lines, np.array([0]), np.array([4 + back]))
    assert (trees is None) == (back != 2)
    assert trees is None or trees.node.tolist() == [0, 1]


def test_numbers_that_contradict_each_other_around_a_tear_are_left_to_votes(answers):
    row, column = np.mgrid[0:16, 0:16]
    place = column - 7.5 + 1j * (row - 7.5)
    kept = np.abs(place) > 3
    place, first = place[kept], (row + column)[kept] % 2
    place += np.angle(-place) / np.pi  # on the right the rows below lie two columns off
    edges = (np.arange(4) + first[:, None]) * np.pi / 2
    lines = lines_of(edges.astype(np.float32))
    found = lattice((100 + 100j + 13 * place).astype(np.complex64), lines)
    assert found.size[0] > 200
    assert answers == [None]


def test_a_pattern_that_is_rotated_within_itself_is_numbered_by_votes(answers):
    corners, index, _ = board(24, 24, twist=1.1, pull=0)
    grid = build_grid(corners)
    assert answers == [None]
    np.testing.assert_array_equal(grid.index, index)


def test_a_frame_without_holes_is_not_looked_at_again(monkeypatch):
    def fails(*_):
        raise AssertionError("a second look, with nothing missing")

    monkeypatch.setattr("cmp_cl.grid.grow.second_look", fails)
    whole = board(9, 12)
    x, y = whole.corners.pixel.max(axis=0) + 20
    image = np.zeros((y, x), np.uint8)
    for shape in (None, (9, 12)):
        grid = build_grid(whole.corners, image, shape=shape)
        assert (grid.status == NodeStatus.DETECTED).all()
    monkeypatch.setattr(
        "cmp_cl.grid.grow.second_look", lambda image, at, *_: np.full_like(at, np.nan)
    )
    holed = keep(whole.corners, np.arange(len(whole.corners)) != 50)
    assert np.count_nonzero(build_grid(holed, image).status == NodeStatus.INTERPOLATED) == 1


def test_the_rings_of_a_second_look_are_those_of_refinement():
    assert [len(ring(radius)) for radius in (4, 5)] == [24, 28]
    assert ring(4)[0] == -4j
    assert (np.abs(np.abs(ring(6)) - 6) < 0.6).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_second_look_finds_the_corner_and_rejects_the_other_colour(dtype):
    scene = synthetic.Scene(markers=20, severity=0.5, noise=2.0, seed=4)
    rendered = synthetic.render(scene)
    image = rendered.image.astype(dtype) * (257 if dtype == np.uint16 else 1)
    truth = (rendered.truth @ [1, 1j])[5:15, 5:15]
    draw = np.random.default_rng(0)
    at = (truth + draw.uniform(-1.5, 1.5, truth.shape) * (1 + 1j)).ravel()
    grid = build_grid(reference.detect(rendered.image), shape=(20, 20))
    level = (np.indices(truth.shape).sum(0).ravel() + grid.parity) % 2 == 0
    line = np.where(level, 1, 1j)
    cell = np.full(len(at), rendered.cell)
    found = second_look(image, at, cell, line)
    assert (~np.isnan(found.real)).mean() > 0.95
    assert np.nanmedian(np.abs(found - truth.ravel())) < 0.5
    assert np.isnan(second_look(image, at, cell, line * 1j).real).all()
    aside = at + 0.4 * cell
    astray = second_look(image, aside, cell, line)
    assert not (np.abs(astray - aside) > 0.25 * cell).any()
    blank = np.full_like(image, 90)
    assert np.isnan(second_look(blank, at, cell, line).real).all()


@pytest.mark.parametrize("seed", range(4))
def test_the_noise_of_a_plain_spot_is_no_corner_to_a_second_look(seed):
    image, at = drawn(9, 9)
    y, x = np.indices(image.shape)
    spot = np.hypot(x - at[4, 4, 0], y - at[4, 4, 1]) < 35
    image[spot] = np.rint(np.random.default_rng(seed).normal(225, 3, spot.sum()))
    grid = build_grid(detect(image), image, shape=(9, 9))
    hidden = np.linalg.norm(at - at[4, 4], axis=2) < 30
    assert not np.isin(grid.status[hidden], MEASURED).any()
    assert np.isin(grid.status[~hidden], MEASURED).sum() >= 68


def test_second_looks_move_on_from_pixel_to_pixel():
    scene = synthetic.Scene(markers=20, severity=1.0, corrosion=2.0, seed=3)
    rendered = synthetic.render(scene)
    at = (rendered.truth @ [1, 1j]).ravel() + 1.6 - 1.2j
    cell, line = np.full(len(at), rendered.cell), np.full(len(at), np.exp(0.25j * np.pi))
    rings = RINGS[:1].repeat(len(at), 0)
    before = here = at
    for _ in range(3):
        before = here
        here, along, sine = edge_lines(rendered.image, before, rings)
    good = (np.abs(here - at) < 0.25 * cell) & (np.abs(here - before) < 0.5)
    good &= (np.abs(sine) > 0.3) & (np.abs((along * line.conj()).real) > 0.7)
    found = _look(rendered.image, at, at, rings, cell, line)
    assert 20 < good.sum() < len(at)
    np.testing.assert_array_equal(found, np.where(good, here, np.nan * (1 + 1j)))


@pytest.mark.parametrize("markers", some([20, 40], (20,)))
@pytest.mark.parametrize("severity", some([0.5, 1.0], (1.0,)))
def test_every_index_of_a_pressed_gel_is_right(markers, severity):
    scene = synthetic.random_scene(17 * markers, markers=markers, severity=severity)
    rendered = synthetic.render(scene)
    corners = reference.detect(rendered.image, rings())
    corners = keep(corners, np.arange(len(corners)) % 50 != 7)
    grid = build_grid(corners, rendered.image, shape=(markers, markers))
    error = np.hypot(*(grid.xy - rendered.truth).transpose(2, 0, 1))
    assert np.isin(grid.status, MEASURED).all()
    assert (grid.status == NodeStatus.SECOND_LOOK).sum() > markers * markers / 60
    assert error.max() < min(3, 0.35 * rendered.cell)


def photograph(name: str) -> tuple[np.ndarray, dict]:
    path = DATA / f"{name}.json"
    if not path.exists():
        pytest.skip(f"the shared photographs are not at {DATA}")
    listed = json.loads(path.read_text())
    return cv2.imread(str(path.with_name(listed["image"])), cv2.IMREAD_GRAYSCALE), listed


def agreeing(grid: Grid, listed: dict) -> tuple[int, int]:
    """Return the number of measured nodes at listed corners, and of those that one numbering fits.

    It may differ from the listed one by quarter turns, a reflection and an offset. A node belongs
    to the nearest corner: squeezed cells are narrower than twice the reach.
    """
    corners = np.array([(c["x"], c["y"], c["i"], c["j"]) for c in listed["corners"]])
    row, column = np.nonzero(np.isin(grid.status, MEASURED))
    node = grid.xy[row, column]
    reach = min(3.0, 0.25 * listed["cell_px"]["median"])
    pairs = []
    for start in range(0, len(node), 256):
        part = node[start : start + 256]
        away = np.hypot(*(part[:, None] - corners[None, :, :2]).transpose(2, 0, 1))
        nearest = away.argmin(axis=1)
        near = np.nonzero(away.min(axis=1) < reach)[0]
        pairs.append(np.stack([start + near, nearest[near]], axis=1))
    pairs = np.concatenate(pairs)
    here = column[pairs[:, 0]] + 1j * row[pairs[:, 0]]
    there = corners[pairs[:, 1], 2] + 1j * corners[pairs[:, 1], 3]
    best = 0
    for mirrored in (here, here.conj()):
        for quarter in range(4):
            shift = np.rint(mirrored * 1j**quarter - there)
            best = max(best, np.unique(shift, return_counts=True)[1].max())
    return len(pairs), int(best)


@pytest.mark.parametrize(
    ("name", "least", "wrong"),
    [
        pytest.param("water/reference_df", 10990, 0, marks=pytest.mark.exhaustive),
        pytest.param("water/ellipse_10", 8000, 0, marks=pytest.mark.exhaustive),
        ("puzzleboard/example1", 255, 0),
        ("curved/curve_4", 85, 0),
    ],
)
def test_photographs_get_one_consistent_lattice(name, least, wrong):
    image, listed = photograph(name)
    config = DetectorConfig.for_cell(listed["cell_px"]["median"])
    grid = build_grid(reference.detect(image, config), image)
    for number in {corner.get("board", 0) for corner in listed["corners"]}:
        part = [corner for corner in listed["corners"] if corner.get("board", 0) == number]
        found, same = agreeing(grid, listed | {"corners": part})
        wrong -= found - same
        least -= found
    assert wrong == 0
    assert least <= 0


@pytest.mark.parametrize("name", ["left02", "left03", "left05"])
def test_fine_texture_behind_a_board_is_no_second_pattern(name):
    image, _ = photograph(f"stereo_opencv/{name}")
    grid = build_grid(reference.detect(image, DetectorConfig()), image)
    assert np.count_nonzero(np.isin(grid.status, MEASURED)) == 54


@pytest.mark.parametrize("name", ["left01", "right04", "right02"])
def test_boards_in_a_room_are_found_whole(name):
    image, listed = photograph(f"stereo_opencv/{name}")
    config = DetectorConfig.for_cell(listed["cell_px"]["median"])
    grid = build_grid(reference.detect(image, config), image, shape=(6, 9))
    found, same = agreeing(grid, listed)
    assert np.isin(grid.status, MEASURED).all()
    assert found == same >= 53


def test_no_node_lies_beyond_the_corners_of_a_board_that_is_partly_out_of_view():
    image, listed = photograph("stereo_opencv/left02")
    truth = np.array([(corner["x"], corner["y"]) for corner in listed["corners"]])
    wide = int(np.quantile(truth[:, 0], 0.7))
    view = np.ascontiguousarray(image[:, :wide])
    corners = reference.detect(view, DetectorConfig.for_cell(listed["cell_px"]["median"]))
    for shape in (None, (6, 9)):
        grid = build_grid(corners, view, shape=shape)
        node = grid.xy[np.isin(grid.status, MEASURED)]
        away = np.linalg.norm(node[:, None] - truth, axis=2).min(axis=1)
        assert (away < 5).all()
        assert len(node) >= 0.95 * np.count_nonzero(truth[:, 0] < wide - 3)
