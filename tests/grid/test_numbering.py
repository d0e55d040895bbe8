"""Numbers are right, or the grid says that they may be wrong."""

import dataclasses
import math
import time

import cv2
import numpy as np
import pytest
from lattices import Board, board, drawn, endless, joined, keep

from cmp_cl import detect, reference
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.errors import GridError
from cmp_cl.grid import Grid, NodeStatus, Sides, align, build_grid, build_grids
from cmp_cl.grid.align import row_direction
from cmp_cl.grid.border import Border, common_reach
from cmp_cl.grid.evidence import _typical
from cmp_cl.grid.fingerprint import Fingerprint, turn_to
from cmp_cl.grid.grow import Seen
from cmp_cl.grid.lattice import lattice, lines_of
from cmp_cl.grid.nearest import Reference
from cmp_cl.grid.nodes import boxed, kept_by_mask, median, turned_lines
from cmp_cl.grid.numbering import Numbered
from cmp_cl.grid.sizes import _full, followed

MEASURED = [NodeStatus.DETECTED, NodeStatus.ATTACHED, NodeStatus.SECOND_LOOK]


def numbers(grid: Grid) -> np.ndarray:
    """Return the number (row, column) of each corner; far from all others if it has none."""
    return np.where(grid.index < 0, -999, grid.index + np.array(grid.origin))


def offset(grid: Grid, seen: Board) -> np.ndarray:
    """Return the difference of the true numbers from a grid's, which is the same for all nodes."""
    known = grid.index[:, 0] >= 0
    off = np.unique((seen.index - numbers(grid))[known], axis=0)
    assert len(off) == 1
    return off[0]


def like_rest(*, errors: float = 0.0, **moved) -> tuple[Grid, bool]:
    """Return the grid of an endless pattern that moved, and whether its numbers are right."""
    rest = endless(errors=errors, seed=1)
    at_rest = build_grid(rest.corners)
    now = endless(errors=errors, **moved)
    grid = build_grid(now.corners, like=at_rest)
    return grid, bool((offset(grid, now) == offset(at_rest, rest)).all())


# patterns without a border in view

ERRORS = 0.03  # cells: standard deviation of the printing errors


@pytest.mark.parametrize("zoom", [0.9, 0.94, 0.97, 1.0, 1.03, 1.06, 1.1])
@pytest.mark.parametrize("errors", [0, ERRORS])
def test_an_endless_pattern_keeps_its_numbers_at_any_zoom(zoom, errors):
    grid, right = like_rest(zoom=zoom, errors=errors)
    assert right
    assert grid.ambiguous == (errors == 0)


@pytest.mark.parametrize("degrees", [-20, 5, 30, 100])
def test_an_endless_pattern_keeps_its_numbers_when_it_is_rotated(degrees):
    grid, right = like_rest(rotation=np.deg2rad(degrees), errors=ERRORS)
    assert right
    assert not grid.ambiguous


@pytest.mark.parametrize("translation", [0, 0.4 + 0.4j, 1.6 + 0.2j, 1 + 1j, 2j, 3 - 5j, 7.3 - 4.1j])
def test_printing_errors_show_where_a_pattern_has_moved(translation):
    grid, right = like_rest(translation=translation, zoom=1.02, rotation=0.1, errors=ERRORS)
    assert right
    assert not grid.ambiguous


@pytest.mark.parametrize(
    "translation", [0, 0.3, 0.4 + 0.4j, 1.2, 1.6 + 0.2j, 3.3 - 1.1j, 1 + 1j, 2, 4j]
)
def test_a_translation_that_the_period_hides_is_never_silently_wrong(translation):
    grid, _ = like_rest(translation=translation)
    assert grid.ambiguous


def test_errors_that_do_not_move_with_the_pattern_are_no_printing_errors():
    rest, now = endless(jitter=0), endless(jitter=0, translation=1 + 1j)
    np.testing.assert_allclose(rest.corners.xy, now.corners.xy, atol=1e-3)
    of_camera = np.random.default_rng(0).normal(0, 0.06, rest.corners.xy.shape)
    for seen in (rest, now):
        seen.corners.xy[:] += of_camera
    grid = build_grid(now.corners, like=build_grid(rest.corners))
    assert grid.ambiguous


def test_the_rival_of_a_wrong_numbering_is_the_right_one():
    now = endless(translation=0.7 + 0.5j)
    rest = endless()
    at_rest = build_grid(rest.corners)
    grid = build_grid(now.corners, like=at_rest)
    wrong = offset(grid, now) - offset(at_rest, rest)
    assert wrong.any()
    np.testing.assert_array_equal(wrong, grid.rival[:2])
    assert grid.rival.quarters == 0
    assert grid.turned(1).ambiguous
    assert grid.turned(1).rival is None  # it was relative to the former numbers


def test_frames_in_order_continue_the_numbers_over_any_distance():
    rest = endless()
    before = at_rest = build_grid(rest.corners)
    for step in np.arange(0.4, 4.2, 0.4):
        now = endless(translation=step * (1 + 0.3j), seed=int(10 * step))
        before = build_grid(now.corners, like=at_rest, previous=before)
        assert (offset(before, now) == offset(at_rest, rest)).all()


def test_a_frame_is_ambiguous_if_the_frame_at_rest_and_the_previous_one_disagree():
    rest = endless(errors=ERRORS)
    at_rest = build_grid(rest.corners)
    before = build_grid(
        endless(translation=1.8).corners, like=at_rest, previous=translated(at_rest, 0, 2)
    )
    assert not before.ambiguous
    now = endless(translation=2.0, errors=ERRORS)
    assert not build_grid(now.corners, like=at_rest).ambiguous
    grid = build_grid(now.corners, like=at_rest, previous=translated(before, 0, 2))
    assert grid.ambiguous
    assert (offset(grid, now) == offset(at_rest, rest)).all()


def translated(grid: Grid, rows: int, columns: int) -> Grid:
    """Return the grid with the nodes numbered as if the pattern had moved by whole cells."""
    return dataclasses.replace(grid, origin=(grid.origin[0] - rows, grid.origin[1] - columns))


def test_a_motion_by_more_than_half_a_cell_between_frames_is_ambiguous():
    at_rest = build_grid(endless().corners)
    grid = build_grid(endless(translation=0.6).corners, like=at_rest, previous=at_rest)
    assert grid.ambiguous


def test_what_follows_an_ambiguous_frame_is_ambiguous():
    at_rest = build_grid(endless().corners)
    jumped = build_grid(endless(translation=0.6).corners, like=at_rest, previous=at_rest)
    after = build_grid(endless(translation=0.7).corners, like=at_rest, previous=jumped)
    assert after.ambiguous


def test_nodes_beyond_the_grid_at_rest_keep_their_numbers():
    grid, right = like_rest(zoom=0.9)
    assert right
    assert (grid.index >= 0).all()
    assert min(grid.origin) < 0
    rest = build_grid(endless().corners)
    cut = grid.cut_to(rest)
    assert (cut.shape, cut.origin, cut.parity) == (rest.shape, (0, 0), rest.parity)
    inside = cut.index[:, 0] >= 0
    np.testing.assert_array_equal(cut.index[inside], numbers(grid)[inside])
    assert 0 < np.count_nonzero(inside) < len(inside)
    now = endless(zoom=0.9).corners
    np.testing.assert_array_equal(cut.xy[tuple(cut.index[inside].T)], now.xy[inside])
    assert np.nanmax(np.hypot(*(cut.xy - rest.xy).transpose(2, 0, 1))) < 0.1 * 300


def test_a_grid_with_doubts_is_refused_on_demand():
    at_rest = build_grid(endless().corners)
    zoomed = endless(zoom=0.97).corners
    with pytest.raises(GridError, match="ambiguous"):
        build_grid(zoomed, like=at_rest, strict=True)
    followed = build_grid(zoomed, like=at_rest, previous=at_rest, strict=True)
    assert followed.doubts == []


# patterns with a border in view


def seen_in(image: np.ndarray) -> Corners:
    return reference.detect(image, DetectorConfig.for_cell(20))


def true(grid: Grid, corners: np.ndarray, within: float = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the measured nodes and of the true corners there, (-1, -1) for
    none."""
    row, column = np.nonzero(np.isin(grid.status, MEASURED))
    away = np.linalg.norm(grid.xy[row, column][:, None] - corners.reshape(-1, 2), axis=2)
    place = np.stack(np.divmod(away.argmin(axis=1), corners.shape[1]), axis=1)
    place[away.min(axis=1) > within] = -1
    return np.stack([row, column], axis=1) + grid.origin, place


def test_a_shape_that_was_counted_in_the_view_is_not_that_of_the_pattern():
    whole, _ = drawn(20, 30)
    at_rest, moved = (np.ascontiguousarray(whole[90:290, x : x + 250]) for x in (90, 130))
    seen = build_grid(seen_in(at_rest), at_rest)
    for image in (at_rest, None):
        rest = build_grid(seen_in(at_rest), image, shape=seen.shape)
        assert not any(rest.border or Sides())
        now = build_grid(seen_in(moved), None if image is None else moved, like=rest)
        assert now.shape == rest.shape
        assert now.ambiguous


def test_a_pattern_that_moved_by_cells_is_numbered_by_its_border():
    at_rest, _ = drawn(7, 9)
    rest = build_grid(seen_in(at_rest), at_rest)
    assert rest.border == Sides(True, True, True, True)
    moved, corners = drawn(7, 9, origin=(40 + 2 * 20, 40 + 2 * 20))
    grid = build_grid(seen_in(moved), moved, like=rest)
    number, place = true(grid, corners)
    np.testing.assert_array_equal(number, place)
    assert len(place) == 63
    assert not grid.ambiguous


def test_nodes_that_end_without_a_border_in_view_do_not_decide_the_numbers():
    rest = build_grid(board(10, 10, pull=0, twist=0).corners)
    assert rest.border is None  # there was no image
    near = board(10, 10, pull=0, twist=0, cell=15, origin=51 + 41j).corners
    assert not build_grid(near, like=rest).ambiguous
    assert build_grid(near, like=dataclasses.replace(rest, border=Sides())).ambiguous


def rotated(image: np.ndarray, degrees: float) -> np.ndarray:
    rows, columns = image.shape
    around = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), -degrees, 1)
    return cv2.warpAffine(image, around, (columns, rows), borderValue=210)


@pytest.mark.parametrize(
    ("degrees", "ambiguous"), [(-35, False), (35, False), (43, True), (48, True)]
)
def test_a_square_pattern_rotated_by_45_degrees_may_have_rotated_either_way(degrees, ambiguous):
    image, _ = drawn(8, 8, origin=(60, 60))
    rest = build_grid(seen_in(image), image)
    now = rotated(image, degrees)
    grid = build_grid(seen_in(now), now, like=rest)
    assert all(grid.border)
    assert grid.ambiguous == ambiguous
    assert (grid.rival is not None) == ambiguous
    if not ambiguous:
        ahead = row_direction(grid) / row_direction(rest)
        assert np.angle(ahead, deg=True) == pytest.approx(degrees, abs=1)


def test_a_square_pattern_is_followed_beyond_a_rotation_by_45_degrees():
    image, _ = drawn(8, 8, origin=(60, 60))
    before = rest = build_grid(seen_in(image), image)
    for degrees in (25, 50, 75):
        now = rotated(image, degrees)
        before = build_grid(seen_in(now), now, like=rest, previous=before)
        assert not before.ambiguous
    ahead = row_direction(before) / row_direction(rest)
    assert np.angle(ahead, deg=True) == pytest.approx(75, abs=1)


@pytest.mark.parametrize("quarters", range(4))
def test_printing_errors_show_how_a_square_pattern_has_rotated(quarters):
    draw = np.random.default_rng(quarters)
    row, column = np.indices((12, 12))
    errors, noise = draw.normal(0, (0.3, 0.1), (2, 12, 12, 2)).swapaxes(0, 3).swapaxes(1, 2)[:2]
    rest = 10 * (column + 1j * row) + errors[..., 0] + 1j * errors[..., 1]
    now = np.rot90(rest * np.exp(0.2j), -quarters) + noise[..., 0] + 1j * noise[..., 1]
    at_rest = Fingerprint.of(rest)
    assert turn_to(at_rest, Fingerprint.of(now), [2, 0, 3, 1]) == quarters
    flawless = Fingerprint.of(10 * (column + 1j * row) + draw.normal(0, 0.1, (12, 12)))
    assert turn_to(at_rest, flawless, [2, 0, 3, 1]) is None


def test_the_printing_errors_of_another_pattern_show_no_rotation():
    place = 40 * np.add.outer(1j * np.arange(12), np.arange(12))
    draw = np.random.default_rng(0)
    errors = draw.normal(0, 2, (10, 2, 12, 12)) + 1j * draw.normal(0, 2, (10, 2, 12, 12))
    prints = [[Fingerprint.of(place + each) for each in pair] for pair in errors]
    assert [turn_to(rest, now, [0, 1, 2, 3]) for rest, now in prints] == [None] * 10


def test_camera_errors_that_look_the_same_rotated_by_180_degrees_are_no_printing_errors():
    row, column = np.indices((12, 12))
    place = 10 * (column + 1j * row)
    errors = np.random.default_rng(0).normal(0, 0.05, (2, 12, 12))
    of_camera = errors[0] + 1j * errors[1]
    rest, now = (Fingerprint.of(place + each) for each in (of_camera, -of_camera[::-1, ::-1]))
    assert turn_to(rest, now, [0, 2]) is None


def test_a_grid_at_rest_that_is_changed_in_place_counts_as_it_is_now():
    rest = build_grid(endless(seed=1).corners)
    before = Reference.of(rest), Fingerprint.at_rest(rest)
    assert Reference.of(rest) is before[0]
    assert Fingerprint.at_rest(rest) is before[1]
    rest.xy[5, 5] += 1
    assert Reference.of(rest).at[5, 5] == complex(*rest.xy[5, 5])
    assert Fingerprint.at_rest(rest).error[5, 5] != before[1].error[5, 5]
    rest.status[:] = NodeStatus.INTERPOLATED
    assert not Fingerprint.at_rest(rest).known.any()


def test_rotated_lines_and_medians_are_those_of_numpy():
    draw = np.random.default_rng(0)
    for quarters in range(4):
        values = draw.random((3, 4))
        assert (turned_lines(values, quarters) == np.rot90(values, quarters)).all()
    for count in (1, 2, 7, 8):
        values = draw.random(count)
        assert median(values) == np.median(values)


def behind(image: np.ndarray, x: int, slope: float = 0.0) -> np.ndarray:
    """Return the image with a dark object in front of all that lies to the right of a line."""
    row, column = np.indices(image.shape)
    return np.where(column > x + slope * row, 16, image).astype(np.uint8)


def test_a_pattern_is_not_numbered_by_the_edge_of_an_object_in_front_of_it():
    whole, _ = drawn(6, 20)
    views = [behind(np.ascontiguousarray(whole[:, x : x + 240]), 190) for x in (60, 106)]
    rest, now = (build_grid(seen_in(view), view) for view in views)
    assert rest.border.right
    assert now.border.right
    grid = build_grid(seen_in(views[1]), views[1], like=rest)
    assert grid.ambiguous


def test_a_pattern_that_moved_by_a_period_behind_an_edge_is_ambiguous():
    whole, _ = drawn(6, 20)
    rest_view, view = (
        behind(np.ascontiguousarray(whole[:, x : x + 240]), 190) for x in (60, 60 + 2 * 20)
    )
    rest = build_grid(seen_in(rest_view), rest_view)
    grid = build_grid(seen_in(view), view, like=rest)
    np.testing.assert_allclose(grid.reach, rest.reach, atol=0.05)
    np.testing.assert_allclose(grid.past, rest.past, atol=0.05)
    assert grid.ambiguous


@pytest.mark.parametrize(("moved", "edge_moved", "sure"), [(40, 0, False), (10, 10, True)])
def test_an_edge_through_squares_is_a_border_only_if_it_moves_with_the_pattern(
    moved, edge_moved, sure
):
    whole, _ = drawn(6, 20)
    rest_view, view = (np.ascontiguousarray(whole[:, x : x + 240]) for x in (60, 60 + moved))
    rest_view[:, 190:] = view[:, 190 - edge_moved :] = 210  # as the paper beside the pattern
    rest = build_grid(seen_in(rest_view), rest_view)
    grid = build_grid(seen_in(view), view, like=rest)
    np.testing.assert_allclose(grid.reach, [1, 1, np.nan, 0.5], atol=0.05)
    np.testing.assert_allclose(grid.reach, rest.reach, atol=0.05)
    assert grid.ambiguous != sure


@pytest.mark.parametrize(
    ("edge", "moved", "edge_moved", "sure"),
    [(200, 37, 0, False), (198, 42, 0, False), (200, 2, 2, True), (200, 0, 0, True)],
)
def test_an_edge_that_stood_still_while_the_pattern_moved_is_no_border(
    edge, moved, edge_moved, sure
):
    whole, _ = drawn(6, 20)
    rest_view, view = (np.ascontiguousarray(whole[:, x : x + 240]) for x in (60, 60 + moved))
    rest_view[:, edge:] = view[:, edge - edge_moved :] = 210  # as the paper beside the pattern
    rest = build_grid(seen_in(rest_view), rest_view)
    grid = build_grid(seen_in(view), view, like=rest)
    np.testing.assert_allclose(rest.reach, [1, 1, np.nan, 1 - (200 - edge) / 20], atol=0.05)
    assert grid.ambiguous != sure


def through_window(left: int, window: tuple[slice, slice], moved: int) -> np.ndarray:
    """Return the view from a column of a pattern that moved down, px, behind a window."""
    whole, _ = drawn(20, 20)
    view = np.full((280, 280), 16, np.uint8)
    view[window] = whole[100 - moved : 380 - moved, left : left + 280][window]
    return view


@pytest.mark.parametrize(
    ("left", "window", "reach"),
    [
        (60, np.s_[70:210, 70:210], (0.5, 0.5, 0.5, 0.5)),  # through squares
        (200, np.s_[60:200, :], (1, 1, np.nan, 1)),  # along squares, past the end of the pattern
    ],
)
def test_a_pattern_that_moved_by_a_period_behind_a_window_is_ambiguous(left, window, reach):
    views = [through_window(left, window, moved) for moved in (0, 40)]
    rest = build_grid(seen_in(views[0]), views[0])
    grid = build_grid(seen_in(views[1]), views[1], like=rest)
    np.testing.assert_allclose(rest.reach, reach, atol=0.07)
    np.testing.assert_allclose(grid.reach, reach, atol=0.07)
    assert grid.ambiguous


def test_a_sheet_that_was_cut_along_its_squares_has_borders_on_both_sides():
    views = []
    for x in (40, 80):
        image, corners = drawn(7, 9, origin=(x, 40))
        image[:, : x + 1] = image[:, x + 10 * 20 - 1 :] = 90
        views.append(np.ascontiguousarray(image[70:]))
    rest = build_grid(seen_in(views[0]), views[0])
    grid = build_grid(seen_in(views[1]), views[1], like=rest)
    assert rest.border == grid.border == Sides(False, True, True, True)
    assert min(np.abs(rest.past[2:])) > 0.5
    number, place = true(grid, corners - np.array([0, 70]))
    number[:, 0] += 7 - len(rest.xy)
    np.testing.assert_array_equal(number, place)
    assert not grid.ambiguous


def mirrored(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image[:, ::-1])


def test_a_pattern_is_not_numbered_by_an_edge_that_continues_past_it():
    whole, _ = drawn(7, 9)
    right_hidden = behind(whole, 40 + 6 * 20 - 1)
    left_hidden = mirrored(behind(mirrored(whole), whole.shape[1] - 1 - (40 + 4 * 20)))
    rest, now = (build_grid(seen_in(view), view) for view in (right_hidden, left_hidden))
    assert rest.border == now.border == Sides(True, True, True, True)
    assert rest.shape == now.shape == (7, 5)
    assert rest.past[3] < -0.9
    assert now.past[2] < -0.9
    np.testing.assert_allclose([*rest.past[:3], *now.past[:2], now.past[3]], 0, atol=0.05)
    grid = build_grid(seen_in(left_hidden), left_hidden, like=rest)
    assert grid.ambiguous
    assert rest.turned(1).past == (rest.past[3], rest.past[2], rest.past[0], rest.past[1])


def test_nodes_that_were_hidden_at_rest_are_not_cut_off():
    image, corners = drawn(7, 9)
    hidden = behind(image, 40 + 6 * 20 - 1)
    rest = build_grid(seen_in(hidden), hidden)
    grid = build_grid(seen_in(image), image, like=rest)
    assert (rest.shape, grid.shape) == ((7, 5), (7, 9))
    number, place = true(grid, corners)
    np.testing.assert_array_equal(number, place)


def test_a_sliver_of_squares_beyond_the_last_ones_counts_to_their_reach():
    whole, _ = drawn(7, 9)
    view = behind(whole, 40 + 6 * 20 + 2)
    grid = build_grid(seen_in(view), view)
    assert grid.shape == (7, 5)
    assert grid.reach[3] == pytest.approx(1.15, abs=0.06)


@pytest.mark.parametrize(("moved", "ambiguous"), [(0, False), (6, False), (40, True)])
def test_if_a_side_contradicts_the_others_decide_about_half_a_cell_only(moved, ambiguous):
    at_rest, _ = drawn(7, 9)
    at_rest[:, :52] = 210  # on this side the pattern ends within its squares
    rest = build_grid(seen_in(at_rest), at_rest)
    now, corners = drawn(7, 9, origin=(40 + moved, 40))
    grid = build_grid(seen_in(now), now, like=rest)
    number, place = true(grid, corners)
    np.testing.assert_array_equal(number, place)
    assert grid.ambiguous == ambiguous


def test_parts_of_a_pattern_that_hardly_meet_are_not_numbered_by_one_border_each():
    whole, _ = drawn(11, 11)
    left_part = behind(whole, 120, 0.3)
    right_part = mirrored(behind(mirrored(whole), 120, 0.3))
    rest, now = (build_grid(seen_in(view), view) for view in (right_part, left_part))
    assert (rest.border.left, rest.border.right) == (False, True)
    assert (now.border.left, now.border.right) == (True, False)
    grid = build_grid(seen_in(left_part), left_part, like=rest)
    assert grid.ambiguous


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(
    ("beyond", "ends"), [("paper", True), ("the pattern", False), ("other colours", True)]
)
def test_a_pattern_that_continues_beyond_an_object_does_not_end_there(quarters, beyond, ends):
    image, _ = drawn(9, 20)
    if beyond == "paper":
        image[:, 330:] = 210
    elif beyond == "other colours":
        image[:, 380:520] = image[:, 360:500]
    image[:, 330:370] = 210
    image = np.ascontiguousarray(np.rot90(image, quarters))
    grid = build_grid(seen_in(image), image)
    assert sorted(grid.shape) == [9, 14]
    assert grid.border == Sides(True, True, True, ends).turned(quarters)


def test_the_edge_of_an_object_does_not_change_the_numbers_of_the_frame_before():
    whole, corners = drawn(6, 30)
    views, places = [], []
    for step in range(6):  # the pattern moves by 6 px to the left, the edge by 2 px to the right
        view = np.ascontiguousarray(whole[:, 60 + 6 * step : 300 + 6 * step])
        view[:, 180 + 2 * step :] = 210
        views.append(view)
        places.append(corners - (60 + 6 * step, 0))
    rest = before = build_grid(seen_in(views[0]), views[0])
    first = np.subtract(*true(rest, places[0]))
    for view, place in zip(views, places, strict=True):
        before = build_grid(seen_in(view), view, like=rest, previous=before)
        right = (np.subtract(*true(before, place)) == first[0]).all()
        assert right or before.ambiguous
    np.testing.assert_allclose(before.reach, rest.reach, atol=0.05)
    assert not right


@pytest.mark.parametrize("slope", [0.038, 0.1])
def test_an_oblique_edge_is_no_border(slope):
    whole, _ = drawn(20, 20)
    view = behind(np.ascontiguousarray(whole[60:300, 60:300]), 190, slope)
    grid = build_grid(seen_in(view), view)
    assert grid.valid.any()
    assert not grid.border.right


def test_a_pattern_that_is_cut_through_its_last_squares_has_a_border():
    image, _ = drawn(7, 9)
    image[:, :52] = 210
    grid = build_grid(seen_in(image), image)
    assert grid.border == Sides(True, True, True, True)
    np.testing.assert_allclose(grid.reach, [1, 1, 0.4, 1], atol=0.07)
    np.testing.assert_allclose(grid.turned(1).reach, [1, 0.4, 1, 1], atol=0.07)


@pytest.mark.parametrize("side", ["left", "top", "right", "bottom"])
def test_a_board_partly_out_of_view_is_numbered_by_the_borders_that_are_seen(side):
    image, corners = drawn(6, 9)
    cut = {"left": (85, 0), "top": (0, 85)}.get(side, (0, 0))
    image = image[cut[1] :, cut[0] :]
    image = image[: -85 if side == "bottom" else None, : -85 if side == "right" else None]
    image = np.ascontiguousarray(image)
    corners = corners - np.array(cut)
    grid = build_grid(seen_in(image), image, shape=(6, 9))
    number, place = true(grid, corners)
    np.testing.assert_array_equal(number, place)
    x, y = corners.reshape(-1, 2).T
    inside = (x > 4) & (y > 4) & (x < image.shape[1] - 5) & (y < image.shape[0] - 5)
    assert len(place) >= inside.sum() > 30
    assert not grid.ambiguous
    assert grid.doubts == []


def test_a_board_without_a_border_in_view_is_ambiguous():
    image, _ = drawn(6, 9)
    image = np.ascontiguousarray(image[:, 70:-70])
    grid = build_grid(seen_in(image), image, shape=(6, 9))
    assert grid.valid.any()
    assert grid.ambiguous


@pytest.mark.parametrize("squares", [6, 6.5, 6.85])
def test_a_board_behind_an_edge_is_ambiguous(squares):
    image, _ = drawn(6, 9)
    view = behind(image, 40 + round(squares * 20) - 1)
    view = np.ascontiguousarray(view[:, 85:])
    grid = build_grid(seen_in(view), view, shape=(6, 9))
    assert grid.valid.any()
    assert grid.ambiguous


def test_an_edge_that_leaves_as_many_columns_as_a_board_has_rows_leaves_its_rotation_ambiguous():
    image, _ = drawn(5, 8)
    view = behind(image, 40 + 6 * 20 - 1)
    view = np.ascontiguousarray(view[: 40 + 5 * 20 + 10])
    grid = build_grid(seen_in(view), view, shape=(5, 8))
    assert grid.valid.any()
    assert grid.ambiguous


def test_nodes_off_their_predictions_are_compared_with_the_lower_quartile_of_those_around():
    draw = np.random.default_rng(0)
    row, column = np.nonzero(draw.random((9, 9)) < 0.6)
    off, cell = draw.uniform(0, 5, len(row)), np.full(len(row), 9.0)
    around = np.full((13, 13), np.nan)
    around[row + 2, column + 2] = off
    expected = [
        np.nanquantile(around[r : r + 5, c : c + 5], 0.25) if far > 0.12 * 9 else 0
        for r, c, far in zip(row, column, off, strict=True)
    ]
    np.testing.assert_allclose(_typical(off, cell, row, column, (9, 9)), expected, rtol=1e-12)


def test_a_cached_result_is_used_only_for_the_same_mask_of_nodes():
    asked = []

    @kept_by_mask
    def count(there):
        asked.append(there.shape)
        return int(there.sum())

    here, there = np.zeros((2, 3), np.bool_), np.zeros((2, 3), np.bool_)
    there[1, 2] = True
    assert [count(here), count(there), count(here.copy()), count(there)] == [0, 1, 0, 1]
    assert count(there.reshape(3, 2)) == 1
    assert asked == [(2, 3), (2, 3), (3, 2)]
    assert count(there.T[::-1]) == 1  # not in the order that memory has
    large = np.zeros((1 << 7, 1 << 8), np.bool_)
    asked.clear()
    assert [count(large), count(large)] == [0, 0]
    assert asked == [large.shape, large.shape]


def test_one_pair_of_squares_of_many_does_not_tell_that_an_edge_is_parallel():
    assert math.isnan(common_reach(np.array([0.8]), columns=5))
    assert common_reach(np.array([0.8]), columns=3) == 0.8
    assert common_reach(np.array([0.8, 0.9, 0.85, 0.2]), columns=9) == pytest.approx(0.825)
    assert math.isnan(common_reach(np.array([0.8, 0.4, 0.6, 0.2]), columns=9))
    at_round_window = np.array([1.08, 0.95, 1.21])
    assert math.isnan(common_reach(at_round_window, columns=6))


def test_junctions_with_the_surround_are_no_nodes():
    image, corners = drawn(6, 9)
    image = np.ascontiguousarray(image[:, 85:])
    for shape in (None, (6, 9)):
        grid = build_grid(seen_in(image), image, shape=shape)
        assert (true(grid, corners - np.array([85, 0]))[1] >= 0).all()


@pytest.mark.parametrize("shape", [None, (6, 9)])
def test_a_thing_that_completes_one_square_at_a_corner_adds_no_line(shape):
    image, corners = drawn(6, 9)
    image[180:200, 220:240] = 40  # below the last square, which is white
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    seen = seen_in(image)
    assert (np.abs(seen.xy - [219.5, 179.5]).max(axis=1) < 1).any()
    number, place = true(build_grid(seen, image, shape=shape), corners)
    np.testing.assert_array_equal(number, place)
    assert len(place) == 6 * 9


def test_objects_in_front_of_a_pattern_add_no_nodes_at_its_rim():
    image, corners = drawn(14, 14)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    image[np.hypot(x - 191, y - 183) < 66] = 220
    grid = build_grid(seen_in(image), image)
    number, place = true(grid, corners, within=1.5)
    assert np.count_nonzero((number != place).any(axis=1)) <= 1  # 3 if positions are not checked
    assert len(place) > 150


@pytest.mark.parametrize("asked", [(5, 9), (6, 8), (4, 7), (7, 9), (6, 10)])
def test_a_wrong_size_is_reported(asked):
    image, _ = drawn(6, 9)
    corners = seen_in(image)
    grid = build_grid(corners, image, shape=asked)
    assert grid.seen_shape == (6, 9)
    (line,) = grid.doubts
    assert line == f"the board looks like 6 x 9 corners; {asked[0]} x {asked[1]} were asked for"
    with pytest.raises(GridError, match="looks like 6 x 9"):
        build_grid(corners, image, shape=asked, strict=True)
    assert build_grid(corners, image, shape=(6, 9)).seen_shape is None
    assert build_grid(corners, image, shape=(9, 6)).seen_shape is None


def test_a_line_of_a_pattern_has_half_the_corners_of_the_one_before_it_but_more_than_one():
    np.testing.assert_array_equal(_full(np.array([7, 6, 4, 2, 1]), 7.0), [True, True, True, False])
    np.testing.assert_array_equal(_full(np.array([2, 1]), 7.0), [False])


@pytest.mark.parametrize("shown", [3, 4])
def test_a_wrong_size_is_reported_though_most_of_the_last_line_is_hidden(shown):
    image, nodes = drawn(6, 9)
    corner = nodes.reshape(6, 9, 2)[5, shown - 1].astype(int)
    image[corner[1] - 28 :, corner[0] + 8 :] = 128
    corners = seen_in(image)
    grid = build_grid(corners, image, shape=(5, 9))
    assert grid.seen_shape == (6, 9)
    assert build_grid(corners, image, shape=(6, 9)).seen_shape is None


def test_a_wrong_size_is_reported_though_no_corner_of_the_last_line_is_seen():
    image, nodes = drawn(6, 9)
    x = round(float(nodes.reshape(6, 9, 2)[0, -1, 0]))
    image[:, x - 5 : x + 6] = 128  # the last column is hidden, its squares are not
    corners = seen_in(image)
    grid = build_grid(corners, image, shape=(6, 8))
    assert grid.valid.all()
    assert grid.seen_shape == (6, 9)
    assert build_grid(corners, image, shape=(6, 9)).seen_shape is None


@pytest.mark.parametrize("quarters", range(4))
def test_corners_of_a_further_line_are_counted_where_no_border_is_seen(quarters):
    whole = board(9, 7, pull=0, twist=0, rotation=0).corners
    edges, lines = whole.edges, lines_of(whole.edges)
    z = whole.xy.astype(np.float64).view(np.complex128)[:, 0]
    seen = Seen(z, edges, lines, None, np.ones(len(z) + 1, np.bool_))
    found = lattice(z.astype(np.complex64), lines)
    nodes = boxed(z, found).turned(quarters)
    rows, columns = nodes.at.shape
    numbered = Numbered(nodes.window(1, 1, (rows - 2, columns - 2)))
    nothing = followed(numbered, Border(reach=(1.0, 1.0, 1.0, 1.0)), seen)
    assert nothing.seen_shape is None
    assert followed(numbered, Border(), seen).seen_shape == (rows, columns)


def with_marks_at_the_end(rows: int, columns: int) -> np.ndarray:
    """Return an image of a board whose last squares of each row have a mark of the other colour.

    The corners there are found, but do not look like nodes.
    """
    image, nodes = drawn(rows, columns, cell=40)
    x = round(float(nodes.reshape(rows, columns, 2)[0, -1, 0]))
    for row in range(rows + 1):
        y = 40 + 40 * row
        image[y + 7 : y + 33, x + 8 : x + 34] = 40 if (row + columns) % 2 else 210
    return image


@pytest.mark.parametrize("quarters", range(4))
def test_a_wrong_size_is_reported_though_marks_disturb_the_last_line(quarters):
    image = np.ascontiguousarray(np.rot90(with_marks_at_the_end(6, 9), quarters))
    corners = detect(image, DetectorConfig.for_cell(40))
    asked, size = ((6, 8), (6, 9)) if quarters % 2 == 0 else ((8, 6), (9, 6))
    grid = build_grid(corners, image, shape=asked)
    assert grid.seen_shape == size


@pytest.mark.parametrize("missed", [0, 2])
def test_a_wrong_size_is_reported_though_second_looks_may_replace_nodes_outside_it(missed):
    image, nodes = drawn(6, 9)
    corner = nodes.reshape(6, 9, 2)
    x, y = np.rint(corner[2:, -1].mean(axis=0)).astype(int)
    image[y - 36 : y + 37, x - 5 : x + 6] = 128  # two nodes of the last column are left
    corners = seen_in(image)
    away = np.linalg.norm(corners.xy[:, None] - corner[2 : 2 + missed, 4], axis=2)
    grid = build_grid(keep(corners, (away > 2).all(axis=1)), image, shape=(6, 8))
    assert np.count_nonzero(grid.status == NodeStatus.SECOND_LOOK) == missed
    assert grid.seen_shape == (6, 9)


def test_things_beside_a_board_are_not_taken_for_its_squares():
    image, _ = drawn(6, 9)
    for number, level in enumerate((210, 40, 210, 210, 210, 210, 210, 40, 125, 40)):
        x = 40 + 20 * number
        image[186:220, x : x + 20] = level  # three differ from the squares of a longer board
    assert build_grid(seen_in(image), image, shape=(6, 9)).seen_shape is None


@pytest.mark.parametrize(("seed", "size"), [(910011, 6), (910017, 6), (910038, 3)])
def test_spots_beside_a_border_do_not_make_a_wrong_size_sure(seed, size):
    image, _ = drawn(6, 5)
    noise = np.random.default_rng(seed).normal(0, 1, image.shape)
    noise = cv2.GaussianBlur(noise, (0, 0), size)
    view = np.clip(128 + 70 * noise / noise.std(), 0, 255)
    view[37:-37, 37:-37] = image[37:-37, 37:-37]
    view = np.rint(cv2.GaussianBlur(view, (0, 0), 0.8)).astype(np.uint8)
    assert build_grid(seen_in(view), view, shape=(7, 5)).doubts


def test_a_board_that_ends_just_inside_the_image_is_not_taken_for_one_that_is_cut_off():
    image, _ = drawn(6, 9)
    for room in (4, 5, 6, 7):  # px of the surround
        view = np.ascontiguousarray(image[:, : 40 + 10 * 20 + room])
        grid = build_grid(seen_in(view), view, shape=(6, 10))
        assert grid.valid.any()
        assert grid.doubts


# several views and several boards


def test_all_views_of_a_board_have_one_origin():
    views = [board(9, 6, rotation=0.1 + rotation, twist=0) for rotation in (0, 1.4, 2.9, -1.5)]
    grids = align([build_grid(view.corners, shape=(9, 6)) for view in views])
    for view, grid in zip(views, grids, strict=True):
        np.testing.assert_array_equal(grid.index, view.index)
        assert grid.parity == grids[0].parity


def test_views_that_colours_do_not_tell_apart_are_numbered_by_the_direction_of_their_rows():
    views = [board(6, 6, rotation=rotation, twist=0) for rotation in (0.1, -0.4)]
    first, second = align([build_grid(views[0].corners), build_grid(views[1].corners).turned(2)])
    np.testing.assert_array_equal(second.index, views[1].index)
    assert first.shape == second.shape
    with pytest.raises(GridError, match="numbered alike"):
        align([first, build_grid(board(6, 5).corners)])
    oblique = build_grid(board(6, 6, rotation=0.1 + np.deg2rad(43), twist=0).corners)
    with pytest.raises(GridError, match="by 43 degrees or by 47"):
        align([first, oblique])
    empty = build_grid(board(1, 2).corners)
    with pytest.raises(GridError, match="view 2 of 2 shows no node"):
        align([first, empty])


def test_all_boards_of_a_view_are_found():
    first, second = board(9, 9, pull=0), board(6, 8, pull=0, origin=260 + 50j)
    both = joined(first, second)
    grids = build_grids(both)
    assert [grid.shape for grid in grids] == [(9, 9), (6, 8)]
    owned = np.sum([grid.index[:, 0] >= 0 for grid in grids], axis=0)
    np.testing.assert_array_equal(owned, 1)
    assert [grid.shape for grid in build_grids(both, shape=(6, 8))][-1] == (6, 8)
    assert build_grids(joined(board(2, 2), board(1, 2, origin=200 + 60j))) == []


# islands


def island(aside: complex) -> tuple[Board, np.ndarray]:
    """Return a board in which a square ring of corners is missing and those inside it have moved,
    and a mask of the latter. aside: px."""
    whole = board(30, 30, pull=0, twist=0)
    away = np.abs(whole.index - 14.5).max(axis=1)
    inside = away < 5
    whole.corners.xy[inside] += [aside.real, aside.imag]
    kept = inside | (away > 9)
    return Board(keep(whole.corners, kept), whole.index[kept], whole.truth), inside[kept]


def test_an_island_gets_the_numbers_that_its_surroundings_give():
    seen, _ = island(1.5 - 1j)
    grid = build_grid(seen.corners)
    np.testing.assert_array_equal(grid.index, seen.index)


@pytest.mark.parametrize("zoom", [1.35, 0.65 * np.exp(0.4j)])
def test_an_island_with_other_steps_is_another_pattern(zoom):
    seen, inside = island(0)
    xy = seen.corners.xy[inside] @ [1, 1j]
    xy = zoom * (xy - xy.mean()) + xy.mean()
    seen.corners.xy[inside] = np.stack([xy.real, xy.imag], axis=1)
    grid = build_grid(seen.corners)
    np.testing.assert_array_equal(grid.index[~inside], seen.index[~inside])
    assert (grid.index[inside] == -1).all()


def test_an_island_between_two_places_is_left_out():
    seen, inside = island(0.5 * 13 + 0.4 * 13j)
    grid = build_grid(seen.corners)
    np.testing.assert_array_equal(grid.index[~inside], seen.index[~inside])
    assert (grid.index[inside] == -1).all()


# corners that come from no image


def test_many_corners_at_one_position_take_little_time():
    heap = keep(board(12, 12).corners, np.zeros(20_000, np.int64))
    start = time.perf_counter()
    assert build_grid(heap).shape == (0, 0)
    assert time.perf_counter() - start < 3  # s: about 0.2 s; all pairs would take minutes
