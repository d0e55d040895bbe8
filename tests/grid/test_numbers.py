"""What a grid promises: every number is right or the grid says so, in any orientation and order."""

import contextlib
import dataclasses
import functools
import json
import time

import cv2
import numpy as np
import pytest
from cases import some
from corner_images import noise, to_nearest
from lattices import drawn as square_board
from lattices import keep
from scenes import (
    BOARD,
    SCENES,
    SIZE,
    Camera,
    Score,
    View,
    barred,
    board,
    corners_of,
    cut,
    drawn,
    endless,
    fisheye,
    mirrored,
    plane,
    rendered,
    samples,
    scored,
    squares,
    turned,
)
from stereo_data import photographs

from cmp_cl import Corners, Detector, Grid, GridError, ImageError, NodeStatus, build_grid, detect
from cmp_cl.grid import Others, build_grids
from cmp_cl.synthetic import Indenter, random_scene
from cmp_cl.synthetic.boards import covered
from cmp_cl.synthetic.scoring import agreeing


@functools.cache
def seen(name: str) -> tuple[View, Corners]:
    """Return the view of a scene, and its corners."""
    view = SCENES[name].view()
    return view, corners_of(view)


def grid_of(view: View, **given: object) -> Grid:
    return build_grid(corners_of(view), view.image, **given)


def assert_right_or_told(grid: Grid, view: View, known: str = "") -> None:
    """Assert that every measured node is a corner with its number, or the grid has a doubt."""
    assert grid.doubts or scored(grid, view, known=known).clean, scored(grid, view, known=known)


# one view


@pytest.mark.parametrize("name", SCENES)
def test_every_number_is_right_or_the_grid_says_so(name):
    (view, corners), case = seen(name), SCENES[name]
    grid = build_grid(corners, view.image, shape=case.asked)
    score = scored(grid, view, known="board" if case.asked else "")
    assert score.share >= case.share, score
    assert score.wrong == 0, score
    assert score.false <= case.false, score
    assert not (case.asked and grid.doubts)


@pytest.mark.parametrize("name", ["gel, severity 1.5", "board", "gel, cut at left", "16 bits"])
def test_a_grid_says_where_its_corners_are(name):
    view, corners = seen(name)
    grid = build_grid(corners, view.image)
    row, column = np.nonzero(grid.status == NodeStatus.DETECTED)
    owner = np.full(grid.shape, -1)
    known = grid.index[:, 0] >= 0
    owner[tuple(grid.index[known].T)] = np.flatnonzero(known)
    np.testing.assert_array_equal(grid.xy[row, column], corners.xy[owner[row, column]])
    np.testing.assert_array_equal(grid.status == NodeStatus.MISSING, ~grid.valid)
    middle = (grid.xy[:-1, :-1] + grid.xy[1:, 1:]) / 2
    at = np.argwhere(~np.isnan(middle[..., 0]))
    x, y = np.rint(middle[tuple(at.T)]).T.astype(int)
    bright = view.image[y, x] > np.median(view.image[y, x])
    assert np.mean(bright == ((at.sum(axis=1) + grid.parity) % 2 == 1)) > 0.95
    assert np.nanmedian(grid.sigma[row, column]) < 0.1


@pytest.mark.parametrize(
    ("name", "border"),
    [
        ("gel, severity 1.0", (1, 1, 1, 1)),
        ("board", (1, 1, 1, 1)),
        ("board before bars, 0", (1, 1, 1, 1)),
        ("board, cut at left", (1, 1, 0, 1)),
        ("gel, cut at top", (0, 1, 1, 1)),
        ("gel, cut at all sides", (0, 0, 0, 0)),
        ("endless, turned", (0, 0, 0, 0)),
    ],
)
def test_the_sides_on_which_a_pattern_ends_are_known(name, border):
    view, corners = seen(name)
    assert build_grid(corners, view.image).border == border


@pytest.mark.parametrize("name", ["gel, severity 1.0", "board, cut at left", "torn gel 62"])
@pytest.mark.parametrize("change", [1, 2, 3, "mirrored"])
def test_a_turned_or_mirrored_image_has_the_same_nodes(name, change):
    view, corners = seen(name)
    grid = build_grid(corners, view.image)
    other = mirrored(view) if change == "mirrored" else turned(view, change)
    again = grid_of(other)
    xy = grid.xy.astype(np.float64)
    if change == "mirrored":
        xy[..., 0] = view.image.shape[1] - 1 - xy[..., 0]
        xy = xy[:, ::-1]
    else:
        moved = View(view.image, np.concatenate([xy, xy], axis=2).reshape(-1, 4), (0, 0), 1)
        xy = np.rot90(turned(moved, change).corners[:, :2].reshape(xy.shape), change)
    assert again.shape == xy.shape[:2]  # row 0 is at the top of either image
    both = ~np.isnan(xy[..., 0]) & again.valid
    assert both.sum() >= 0.995 * grid.valid.sum()
    torn = "torn" in name
    assert np.quantile(np.abs(again.xy - xy)[both], 0.98 if torn else 1) < (0.2 if torn else 0.02)


def test_a_board_in_an_image_wider_than_a_work_group_is_numbered(device):
    wide = device.handle.max_work_group_size + 50
    image = np.full((120, wide), 200, np.uint8)
    row, column = np.indices((120, 180)) // 20
    image[:, -180:] = cv2.blur(np.uint8((row + column) % 2 * 150 + 50), (3, 3))
    assert build_grid(detect(image, device=device), image, device=device).shape == (5, 8)


@pytest.mark.parametrize("name", ["gel, severity 1.5", "torn gel 61", "board before blocks, 1"])
def test_the_order_of_the_corners_changes_no_number(name):
    view, corners = seen(name)
    grid = build_grid(corners, view.image)
    order = np.random.default_rng(1).permutation(len(corners))
    again = build_grid(keep(corners, order), view.image)
    np.testing.assert_allclose(again.xy, grid.xy, atol=1e-3)  # sums in another order
    np.testing.assert_array_equal(again.status, grid.status)
    np.testing.assert_array_equal(again.index, grid.index[order])
    assert again.doubts == grid.doubts


def test_lost_corners_leave_holes_and_false_ones_no_nodes():
    view, corners = seen("gel, severity 1.0")
    draw = np.random.default_rng(3)
    kept = np.flatnonzero(draw.random(len(corners)) > 0.1)
    some = keep(corners, kept)
    false = draw.choice(len(kept), 30, replace=False)
    some.xy[false] += draw.uniform(4, 5, (30, 2)).astype(np.float32)
    grid = build_grid(some, view.image)
    score = scored(grid, view)
    assert score.wrong == 0
    assert score.false <= 1
    assert score.right >= 0.985 * (len(kept) - 30)
    assert grid.shape == (24, 24)


# other patterns in view


def two_boards() -> View:
    """Return a board of 6 x 9 corners beside one of 5 x 4; `corners` are those of the first."""
    first = drawn(plane(cell=20, middle=(120, 150), about=(4, 2.5), turn=4), SIZE, BOARD)
    second = drawn(plane(cell=22, middle=(330, 150), about=(1.5, 2), turn=-9), SIZE, (5, 4))
    image = np.where(np.arange(SIZE[1]) < 250, first.image, second.image)
    return first._replace(image=image)


def test_the_larger_board_is_numbered_and_the_other_is_told_or_given_on_demand():
    view = two_boards()
    grid = grid_of(view)
    assert_right_or_told(grid, view)
    assert scored(grid, view).right == 54
    assert (grid.others, grid.others_are) == (20, Others.PATTERN)
    boards = build_grids(corners_of(view), view.image)
    assert [each.shape for each in boards] == [(6, 9), (5, 4)]
    owned = np.sum([each.index[:, 0] >= 0 for each in boards], axis=0)
    assert owned.max() == 1


@pytest.mark.parametrize("seed", some(range(6), range(3)))
def test_a_floor_of_squares_is_not_taken_for_the_board_in_silence(seed):
    view = board(seed, ground=squares(SIZE, 40 + seed))
    with contextlib.suppress(GridError):
        assert_right_or_told(grid_of(view), view)
    sized = grid_of(view, shape=BOARD)
    for grid in (sized, grid_of(view, like=sized)):
        assert scored(grid, view, known="board").right == 54
        assert not grid.doubts


@pytest.mark.parametrize("size", [SIZE, (600, 800)])
@pytest.mark.parametrize("seed", some(range(6), range(2)))
def test_a_board_at_the_edge_of_the_image_is_meant_and_not_the_floor_that_ends_nowhere(seed, size):
    camera = plane(cell=34, middle=(150, size[0] - 93), about=(4, 2.5), turn=2)
    view = drawn(camera, size, BOARD, ground=squares(size, seed), margin=0.3)
    grid = grid_of(view)
    assert sum(grid.border) in (1, 2)
    assert scored(grid, view).right == grid.valid.sum() == 54
    assert grid.others_are == Others.PATTERN


def test_what_a_round_hole_shows_is_not_taken_for_the_board_in_silence():
    """A drop on a pattern without an end: a dark rim parts what is seen through it."""
    y, x = np.indices((760, 760))
    away = np.hypot(x - 380, y - 380)
    floor, drop = (x // 12 + y // 12) % 2, ((x + 3) // 16 + (y + 5) // 16) % 2
    lit = np.select([away < 165, away < 245], [drop, 0], floor)
    image = cv2.GaussianBlur((30 + 190 * lit).astype(np.uint8), (0, 0), 0.8)
    grid = build_grid(detect(image), image)
    assert grid.shape == (63, 63)
    assert grid.others_are == Others.PATTERN


@pytest.mark.parametrize(("shape", "cell", "seed"), [((8, 11), 22, 4), ((7, 10), 24, 3)])
def test_a_board_held_by_tape_at_all_its_corners_is_meant_and_not_the_floor(shape, cell, seed):
    """It fills more of its rectangle than what a round hole shows."""
    size, (rows, columns) = (420, 560), shape
    camera = plane(cell=cell, middle=(280, 210), about=((columns - 1) / 2, (rows - 1) / 2), turn=8)
    column, row = camera(*samples(size))
    away = np.minimum(column, columns - 1 - column) + np.minimum(row, rows - 1 - row)
    tape = np.where((away < 0.5) & covered(column, row, shape, 1), 150.0, np.nan)
    view = drawn(camera, size, shape, ground=squares(size, seed), front=tape)
    grid = grid_of(view)
    assert not grid.doubts
    assert scored(grid, view).right == grid.valid.sum() == rows * columns - 4


# shape, cell, turn, margin and floor: squares of the floor go on as those of the board, or have
# some of its outer corners
FLOORS = [(BOARD, 20, 15, 1, 2), (BOARD, 20, 15, 1, 8), ((10, 13), 26, 20, 1, 8)]
FLOORS += [((8, 6), 24, 8, 0, 4), (BOARD, 20, 25, 1, 45), ((8, 6), 24, 8, 0, 37)]
FLOORS += [(BOARD, 20, 15, 1, seed) for seed in (12, 24, 30, 34)]


@pytest.mark.parametrize("case", some(FLOORS, FLOORS[:5]))
def test_a_floor_that_goes_on_as_a_board_by_chance_is_parted_from_it(case):
    shape, cell, turn, margin, seed = case
    size, about = (420, 560), np.subtract(shape, 1)[::-1] / 2
    camera = plane(cell=cell, middle=(280, 210), about=about, turn=turn)
    view = drawn(camera, size, shape, ground=squares(size, seed), margin=margin)
    grid = grid_of(view)
    assert scored(grid, view).right == grid.valid.sum() == np.prod(shape)
    boards = build_grids(corners_of(view), view.image)
    owned = np.sum([each.index[:, 0] >= 0 for each in boards], axis=0)
    assert owned.max() == 1
    assert len(boards) > 1


# cell, turn; angle, width, row and column of a bar; row, column and radius of a spot at it
HIDDEN = [(16, 8, (0, 0.7, 3.5, 6), (-9, -9, 1), 104), (16, 40, (0, 0.7, 3.5, 6), (-9, -9, 1), 104)]
HIDDEN += [(18, -10, (0.7, 1.8, 2.7, 4.8), (3.4, 1.1, 2.1), 72)]
HIDDEN += [(21, 5, (0.3, 2.8, 4.4, 6.4), (3.9, 8, 1.6), 62)]
HIDDEN += [(15, 20, (-0.1, 0.7, 5.4, 8.9), (5.7, 8, 1), 85)]


@pytest.mark.parametrize(("cell", "turn", "bar", "spot", "right"), HIDDEN)
def test_a_board_behind_an_object_is_not_parted(cell, turn, bar, spot, right):
    """A doubt is told, but of a board that has all its corners."""
    camera = plane(cell=cell, middle=(200, 150), about=(6, 3.5), turn=turn)
    column, row = camera(*samples(SIZE))
    angle, width, at_row, at_column = bar
    off = (row - at_row) * np.cos(angle) + (column - at_column) * np.sin(angle)
    hidden = (np.abs(off) < width / 2) | (np.hypot(row - spot[0], column - spot[1]) < spot[2])
    view = drawn(camera, SIZE, (8, 13), front=np.where(hidden, 120.0, np.nan))
    grid = grid_of(view)
    assert scored(grid, view).right == grid.valid.sum() == right
    assert bool(grid.doubts) == (right < 8 * 13)


@pytest.mark.parametrize(("lines", "told"), [(1, True), (12, False)])
def test_a_pattern_that_goes_on_as_another_by_chance_is_told(lines, told):
    """Its contrast falls by half at one line of nodes; light that falls along many is no other."""
    view = endless(wear=0.0, cell=20.0, turn=0.0)
    x = view.corners[:, 0]
    line = x[np.argmin(np.abs(x - SIZE[1] / 2))]
    lost = np.clip((np.arange(SIZE[1]) - line) / (20 * (lines - 1) + 1e-6), 0, 1)
    image = 120 + (1 - lost / 2) * (view.image.astype(float) - 120)
    grid = grid_of(view._replace(image=np.rint(image).astype(np.uint8)))
    assert grid.valid.mean() > 0.9
    assert bool(grid.doubts) == told


@pytest.mark.parametrize("seed", some(range(60, 100), [72]))
def test_tiles_of_random_colours_are_not_numbered_in_silence(seed):
    """In some frames they look like a small board with a border."""
    tiles = (np.random.default_rng(seed).random((36, 47)) > 0.5) * 150.0 + 50
    image = np.kron(tiles, np.ones((12, 12)))[:420, :560]
    frame = cv2.GaussianBlur(image, (0, 0), 1).astype(np.uint8)
    with contextlib.suppress(GridError):
        assert build_grid(detect(frame), frame).doubts


# a known size


@pytest.mark.parametrize("shape", [(6, 9), (9, 6)])
@pytest.mark.parametrize("number", range(4))
def test_a_board_of_known_size_has_its_numbers_whichever_way_it_is_asked(number, shape):
    view = board(number)
    grid = grid_of(view, shape=shape)
    assert grid.shape == shape
    assert scored(grid, view, known="board").right == 54
    assert not grid.doubts


@pytest.mark.parametrize("asked", [(5, 9), (6, 8), (7, 9), (6, 10), (4, 7)])
def test_a_wrong_size_is_told_where_the_whole_board_is_in_view(asked):
    view = board(1)
    grid = grid_of(view, shape=asked)
    assert grid.doubts
    rows, columns = asked
    assert f"looks like 6 x 9 corners; {rows} x {columns} were asked for" in grid.doubts[0]
    with pytest.raises(GridError, match="looks like 6 x 9"):
        grid_of(view, shape=asked, strict=True)


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("number", some(range(3), range(1)))
def test_a_board_that_is_cut_at_a_side_has_the_numbers_of_the_whole_or_says_so(number, side):
    view = turned(cut(turned(board(number), side), (0.45, 0, 1, 1)), -side)
    assert_right_or_told(grid_of(view, shape=BOARD), view, "board")


def test_a_view_without_a_border_does_not_say_which_part_of_a_board_it_is():
    view = cut(board(0, ground=205.0), (0.35, 0.35, 0.7, 0.7))
    grid = grid_of(view, shape=BOARD)
    assert grid.shape == BOARD
    assert grid.ambiguous
    assert "ambiguous" in grid.doubts[0]


@pytest.mark.parametrize(
    ("shape", "cell", "turn", "bar", "right", "beyond"),
    [
        (BOARD, 30, 2, {"columns": (7.5, 0.66)}, 48, 6),
        # two rows are hidden; beyond them lies one, three steps away, of colours that fit
        ((9, 10), 24, 2, {"rows": (1.5, 1.0)}, 60, 10),
        ((9, 10), 24, 35, {"rows": (1.5, 1.0)}, 60, 10),
        ((9, 10), 24, 2, {"rows": (1.5, 1.2)}, 60, 10),
        ((9, 10), 24, 35, {"rows": (1.5, 1.2)}, 60, 10),
    ],
)
def test_corners_beyond_a_bar_are_no_neighbours_and_are_told(shape, cell, turn, bar, right, beyond):
    """With the board's size they show that it goes on there."""
    view = barred(shape, cell, turn, **bar)
    grid = grid_of(view)
    score = scored(grid, view)
    assert (score.right, score.clean) == (right, True)
    assert (grid.others, grid.others_are) == (beyond, Others.BESIDE)
    assert f"{beyond} corners lie where its next lines would be" in grid.doubts[0]
    sized = grid_of(view, shape=shape)
    assert scored(sized, view, known="board").right == right
    assert not sized.doubts
    assert grid_of(view, shape=np.subtract(shape, (1, 0)).tolist()).doubts


@pytest.mark.parametrize(
    ("shape", "cell", "turn", "bar", "hidden"),
    [
        *(((9, 10), 24, turn, {"rows": (row, 1.2)}, 20) for row in (2.5, 3.5) for turn in (2, 35)),
        # the middle of the sides that the bar leaves shows little of the colours
        *(((9, 10), 18, turn, {"rows": (2.5, 1.0)}, 20) for turn in (2, 10)),
        # five cells are on the smaller side
        (BOARD, 30, 2, {"columns": (1.7, 0.7)}, 6),
        (BOARD, 30, 2, {"columns": (2.5, 1.4)}, 12),
        # half of an outer row
        *(((9, 10), 24, turn, {"columns": (2, 4.6), "rows": (0, 0.8)}, 5) for turn in (2, 35)),
    ],
)
def test_a_flat_board_goes_on_behind_a_bar(shape, cell, turn, bar, hidden):
    view = barred(shape, cell, turn, **bar)
    grid = grid_of(view)
    score = scored(grid, view, known="board")
    assert (score.right, score.clean) == (np.prod(shape) - hidden, True)
    assert not grid.doubts


@pytest.mark.parametrize("aside", [0.3, -0.2])
def test_two_boards_in_line_by_chance_are_not_taken_for_one_in_silence(aside):
    one, other = (
        plane(cell=16, middle=(200, 150), about=about, turn=10)
        for about in ((6.6, 3.5), (-1.6, 3.5 + aside))
    )
    view = drawn(one, SIZE, (8, 6), noise=0.0)
    both = drawn(other, SIZE, (8, 6), ground=view.image.astype(np.float32))
    try:
        grid = grid_of(both)
    except GridError:
        return
    assert grid.doubts


@pytest.mark.parametrize("shape", [None, (10, 13)])
def test_a_gap_inside_a_board_is_told(shape):
    view = barred((10, 13), 22, 2, columns=(6, 4.8), rows=(5, 2.8))
    grid = grid_of(view, shape=shape)
    assert scored(grid, view).right == 10 * 13 - 15
    assert (grid.others, grid.others_are) == (15, Others.GAP)


def test_corners_that_lie_anywhere_beside_a_board_are_not_told_as_its():
    view = drawn(plane(cell=20, middle=(200, 150)), SIZE, BOARD)
    image, rng = view.image.copy(), np.random.default_rng(4)
    for x, y in rng.integers(20, (SIZE[1] - 20, SIZE[0] - 20), (150, 2)):
        if np.linalg.norm(view.corners[:, :2] - (x, y), axis=1).min() > 30:
            image[y - 6 : y + 6, x - 6 : x + 6] = 30
            image[y - 6 : y, x - 6 : x] = image[y : y + 6, x : x + 6] = 220
    grid = grid_of(view._replace(image=image))
    assert np.count_nonzero(grid.index[:, 0] < 0) > 12
    assert not grid.doubts


@pytest.mark.parametrize("number", some(range(6), range(3)))
def test_a_board_behind_an_arm_is_whole_or_told_without_a_size(number):
    draw, front = np.random.default_rng(number), np.full(SIZE, np.nan)
    slope, width = draw.uniform(-0.6, 0.6), draw.uniform(30, 60)
    y, x = np.indices(SIZE)
    front[abs(x - 150 - slope * (y - 150)) < width / 2] = draw.uniform(60, 180)
    view = drawn(plane(cell=26, middle=(200, 150), about=(4, 2.5)), SIZE, BOARD, front=front)
    grid = grid_of(view)
    assert grid.doubts or (grid.shape == BOARD and scored(grid, view, known="board").clean)
    sized = grid_of(view, shape=BOARD)
    assert_right_or_told(sized, view, "board")


def test_the_last_squares_of_a_tilted_board_reach_as_far_as_the_next_line_would():
    camera = plane(cell=26, middle=(200, 150), about=(4, 2.5), turn=9, tilt=(1.5e-3, 1e-3))
    grid = grid_of(drawn(camera, SIZE, BOARD, margin=0.5))
    np.testing.assert_allclose(grid.reach, 1, atol=0.06)


LOST = pytest.mark.xfail(strict=True, reason="nodes at the rim are lost, or another board is seen")
RIM = [
    (2.0, (0, 0), (0, 0)),
    (1.6, (0.35, 0), (0, 0)),
    (1.8, (0.4, 0.4), (0, 0)),
    (1.8, (-0.5, 0.3), (0, 0)),
    pytest.param(2.0, (0.5, -0.5), (0.5, 0), marks=LOST),
]


def close(focal: float, far: float, tilt: tuple[float, float], aside: tuple[float, float]) -> View:
    """Return a board of 6 x 8 corners close to a fisheye."""
    camera = fisheye(focal, (*tilt, 0.0), np.array([*aside, far]), (3.5, 2.5), (480, 640))
    return drawn(camera, (480, 640), (6, 8), margin=-0.3, noise=1.5)


@pytest.mark.parametrize(("far", "tilt", "aside"), RIM)
def test_a_board_close_to_a_fisheye_keeps_all_corners_that_are_found(far, tilt, aside):
    view = close(180.0, far, tilt, aside)
    corners = corners_of(view)
    seen = to_nearest(view.corners[:, :2], corners.xy) < 1.5
    grid = build_grid(corners, view.image, shape=(6, 8))
    score = scored(grid, view, known="board")
    assert score.right >= np.count_nonzero(seen), score
    assert score.clean
    assert not grid.doubts


HARD = [  # focal length, px; distance, tilt and offset of the board
    (163, 1.40, (-0.56, 0.37), (-0.23, 0.25)),
    (181, 1.44, (0.43, -0.13), (0.25, 0.20)),
    (170, 1.36, (-0.28, -0.38), (-0.09, -0.16)),
    (155, 1.73, (0.43, 0.56), (-0.32, 0.26)),
]


@pytest.mark.parametrize("number", some(range(40), range(len(HARD))))
def test_a_strong_fisheye_numbers_no_node_wrongly_in_silence(number):
    draw = np.random.default_rng(number)
    focal, far = draw.uniform(150, 200), draw.uniform(1.3, 2.4)
    tilt, aside = draw.uniform(-0.6, 0.6, 2), draw.uniform(-0.4, 0.4, 2)
    view = close(*(HARD[number] if number < len(HARD) else (focal, far, tilt, aside)))
    assert_right_or_told(grid_of(view, shape=(6, 8)), view, "board")


# like a grid at rest


@pytest.mark.parametrize(("cells", "told"), [(0, False), (1, True)])
@pytest.mark.parametrize(("columns", "slope", "at"), [(20, 1, 0.1), (40, 0.5, 0.2)])
def test_a_part_that_slides_by_cells_is_told_where_the_border_was_seen_at_rest(
    columns, slope, at, cells, told
):
    """Inside, a slip by a cell along a diagonal shows nothing: colours and surface go on. What lies
    beyond the border are nodes, or, where a line of the board has few of them, free corners."""
    image, _ = square_board(20, columns)
    row, column = np.indices(image.shape) - np.reshape(image.shape, (2, 1, 1)) / 2
    beyond = slope * row + column > at * image.shape[1]
    slid = np.where(beyond, np.roll(image, (20 * cells, -20 * cells), axis=(0, 1)), image)
    at_rest = build_grid(detect(image), image)
    assert all(at_rest.border)
    grid = build_grid(detect(slid), slid, like=at_rest)
    assert np.count_nonzero(grid.valid) > 0.9 * 20 * columns
    assert bool(grid.doubts) == told
    assert grid.ambiguous == told


def test_a_corner_stays_where_it_is_seen_where_the_surface_bends_sharply():
    """The middle of a dome is 2.2 times as large, and its neighbours predict places 2 px off."""

    def dome(x, y):
        x, y = x - 200, y - 150
        keep = 1 - 0.55 * np.exp(-(x**2 + y**2) / (2 * 28**2))
        return x * keep / 14 + 13, y * keep / 14 + 9

    view = drawn(dome, (300, 400), (20, 26))
    grid = grid_of(view)
    row, column = view.corners[:, 2:].T.astype(int)
    off = np.hypot(*(grid.xy[row, column] - view.corners[:, :2]).T)
    assert off.max() < 0.3


def test_a_worn_corner_has_the_sigma_of_its_mean_with_the_prediction():
    """Its image alone, which fits the corner model, tells a tenth of its error."""
    scene = random_scene(81, markers=30, shape=(450, 600), severity=2.0, indenter=Indenter.TORUS)
    view = rendered(scene)
    corners = corners_of(view)
    grid = build_grid(corners, view.image)
    fits = grid.index[(corners.refusal == 0) & (grid.index[:, 0] >= 0)]
    row, column = fits[grid.status[tuple(fits.T)] == NodeStatus.ATTACHED].T
    errors = to_nearest(grid.xy[row, column], view.corners[:, :2]) / grid.sigma[row, column]
    assert len(errors) > 10
    assert np.sqrt((errors**2).mean() / 2) < 1.5


@pytest.mark.parametrize(("turn", "height"), [(0, 1.2), (15, 1.4), (30, 1.4), (45, 1.4)])
def test_a_wave_that_stretches_cells_makes_no_wrong_number(turn, height):
    """Where cells are long the surface through two parts expects more of them than there are."""
    side, cell = 400, 17.0
    y, x = np.mgrid[: 3 * side, : 3 * side] / 3 - 1 / 3
    wave = height * cell * np.sin(2 * np.pi * (x / 210 + y / 330 + 0.13))
    at = ((x - wave) + 1j * (y - 0.4 * wave)) * np.exp(1j * np.deg2rad(turn)) / cell
    white = (np.floor(at.real) + np.floor(at.imag)) % 2
    image = cv2.resize(np.float32(45 + 160 * white), (side, side), interpolation=cv2.INTER_AREA)
    grids = build_grids(detect(image.astype(np.uint8)), image.astype(np.uint8))
    assert np.count_nonzero(grids[0].valid) > 150
    for grid in grids:
        row, column = np.nonzero(grid.valid & (grid.status != NodeStatus.INTERPOLATED))
        places = np.rint(3 * grid.xy[row, column] + 1).astype(int)
        truth = at[places[:, 1], places[:, 0]]
        true = np.rint(np.stack([truth.imag, truth.real], axis=1))
        assert agreeing(np.stack([row, column], axis=1), true).mean() >= 0.98


def pose(frame: int) -> Camera:
    """Return a fisheye before a board that a hand holds anywhere and any way round."""
    draw = np.random.default_rng(frame)
    lean = draw.uniform(-0.7, 0.7, 2)
    turn = draw.uniform(-np.pi, np.pi)
    far = draw.uniform(10, 14)
    place = np.array([*draw.uniform(-0.25, 0.25, 2) * far, far])
    still = np.zeros(3)
    rotation, *_ = cv2.composeRT(np.array([0, 0, turn]), still, np.array([*lean, 0]), still)
    return fisheye(336.0, rotation.ravel(), place, (4, 2.5), (480, 640))


@pytest.mark.parametrize("frame", [44, 45, 46, 47])
def test_a_whole_board_before_a_fisheye_has_the_same_nodes_like_the_rest_as_by_its_size(frame):
    straight = fisheye(336.0, (0, 0, 0), np.array([2.0, -1.0, 13.0]), (4, 2.5), (480, 640))
    rest, view = (drawn(camera, (480, 640), BOARD) for camera in (straight, pose(frame)))
    at_rest = grid_of(rest, shape=BOARD)
    sized, liked = grid_of(view, shape=BOARD), grid_of(view, like=at_rest)
    assert scored(sized, view, known="board").right == 54
    assert scored(liked, view, known="board").right == 54
    assert liked.shape == BOARD
    assert not liked.ambiguous


@pytest.mark.parametrize(("severity", "share"), [(0.5, 0.99), (1.5, 0.99), (2.0, 0.96)])
def test_a_pressed_gel_has_its_numbers_at_rest(severity, share):
    scene = random_scene(81, markers=24, shape=SIZE, severity=severity, indenter=Indenter.TORUS)
    _, grid, score = against(rendered(scene.at_rest()), rendered(scene))
    assert grid.doubts or score.clean, score
    assert score.share > share


def numbered_as(at_rest: Grid, rest: View, view: View) -> View:
    """Return the view with the numbers that the grid at rest gives to the same corners."""
    first = np.argwhere(at_rest.valid)[0]
    away = np.linalg.norm(rest.corners[:, :2] - at_rest.xy[tuple(first)], axis=1)
    offset = rest.corners[away.argmin(), 2:] - first
    return view._replace(corners=view.corners - [0, 0, *offset])


def against(rest: View, view: View) -> tuple[Grid, Grid, Score]:
    """Return the grids of a view at rest and now, and the score of the numbers that it has now."""
    at_rest = grid_of(rest)
    grid = grid_of(view, like=at_rest)
    return at_rest, grid, scored(grid, numbered_as(at_rest, rest, view), known="truth")


SHIFTS = [(0, 0), (0.3, 0), (0, -0.45), (0.5, 0.5), (1, 1), (2, 0), (1.3, -0.6), (3, 1)]


@pytest.mark.parametrize("wear", [0.0, 0.03])
@pytest.mark.parametrize("shift", some(SHIFTS, SHIFTS[1:6]))
def test_an_open_pattern_is_never_numbered_wrongly_in_silence(shift, wear):
    rest, view = (
        endless(number, middle=(200 + 12 * x, 150 + 12 * y), wear=wear)
        for number, (x, y) in enumerate([(0, 0), shift])
    )
    _, grid, score = against(rest, view)
    assert grid.ambiguous or score.clean, (score, grid.confidence)
    if score.wrong and grid.rival is not None and grid.rival.quarters == 0:
        assert grid.doubts[0].startswith("the numbers are ambiguous")
    if wear:
        assert not grid.ambiguous
        assert score.share > 0.99


@pytest.mark.parametrize(("y", "lines"), [(75, (1.4, 3.4)), (225, (57.6, 55.6))])
def test_a_border_that_left_the_view_is_beyond_what_is_seen(y, lines):
    """The pattern moved by two lines, across the upper or the lower side, where it was seen."""
    rest, view = (
        drawn(plane(cell=20, middle=(200, y), about=(6.5, line), turn=3), SIZE, (60, 14))
        for line in lines
    )
    at_rest, grid, score = against(rest, view)
    assert (sum(at_rest.border), sum(grid.border)) == (3, 2)
    assert score.clean


@pytest.mark.parametrize("moved", [{"turn": 12.0}, {"cell": 11.2}, {"cell": 12.9, "turn": -3.0}])
def test_an_open_pattern_that_turned_or_came_nearer_keeps_its_numbers(moved):
    _, grid, score = against(endless(0), endless(1, **moved))
    assert grid.ambiguous or score.clean
    assert score.share > 0.97


def test_a_film_of_an_open_pattern_is_followed_over_any_distance():
    at_rest = before = None
    for step in range(14):
        shift = 0.35 * step
        view = endless(
            step,
            wear=0.0,
            middle=(200 + 12 * shift, 150 - 5 * shift),
            cell=12 + 0.1 * (step % 5),
            turn=4 + 1.5 * step,
        )
        if before is None:
            rest, at_rest = view, grid_of(view)
            before = at_rest
            continue
        grid = grid_of(view, like=at_rest, previous=before)
        score = scored(grid, numbered_as(at_rest, rest, view), known="truth")
        assert not grid.ambiguous
        assert score.clean
        assert score.share > 0.97
        before = grid


@pytest.mark.parametrize("jump", [0.7, 0.95, 1.1])
def test_a_jump_between_frames_is_told_or_numbered_rightly_and_so_is_what_follows(jump):
    rest = endless(0, wear=0.0)
    far = endless(1, wear=0.0, middle=(203 + 12 * jump, 150.0))
    at_rest = grid_of(rest)
    view = numbered_as(at_rest, rest, far)
    near = grid_of(endless(2, wear=0.0, middle=(203.0, 150.0)), like=at_rest, previous=at_rest)
    assert not near.ambiguous
    jumped = grid_of(far, like=at_rest, previous=near)
    after = grid_of(far, like=at_rest, previous=jumped)
    for grid in (jumped, after):
        assert grid.ambiguous or scored(grid, view, known="truth").clean


# what cannot be numbered


def stripes() -> np.ndarray:
    y, x = np.indices(SIZE)
    return np.where((x * 0.8 + y * 0.3) // 6 % 2 == 0, 30, 220).astype(np.uint8)


@pytest.mark.parametrize("image", [noise(SIZE), stripes(), np.zeros(SIZE, np.uint8)])
def test_an_image_without_a_pattern_has_no_nodes_in_silence(image):
    corners = detect(image)
    start = time.perf_counter()
    with contextlib.suppress(GridError):
        grid = build_grid(corners, image)
        assert grid.valid.sum() < 12 or grid.doubts
    assert time.perf_counter() - start < 5


def test_few_corners_give_an_empty_grid_or_that_of_the_known_size():
    view, corners = seen("board")
    for few in ([], [0], [0, 1, 2]):
        some = keep(corners, np.array(few, np.int64))
        grid = build_grid(some, view.image)
        assert grid.shape == (0, 0)
        assert grid.index.shape == (len(few), 2)
        assert (grid.index == -1).all()
        known = build_grid(some, view.image, shape=BOARD)
        assert known.shape == BOARD
        assert not known.valid.any()
        for nothing in (grid, known):
            assert nothing.confidence == 0
            assert not nothing.ambiguous  # there is no number
            (doubt,) = nothing.doubts
            assert "no board is seen: it has nine corners or more" in doubt


def test_a_board_finds_its_place_in_a_size_of_millions():
    view, corners = seen("board")
    start = time.perf_counter()
    grid = build_grid(corners, view.image, shape=(2000, 2000))
    assert time.perf_counter() - start < 5
    assert grid.ambiguous or grid.seen_shape


def test_requests_that_make_no_sense_are_refused_in_one_line():
    view, corners = seen("board")
    rest = build_grid(corners, view.image)
    empty = build_grid(keep(corners, np.arange(2)), view.image)
    alone = rest.within((2, 3), (1, 1))
    between = dataclasses.replace(rest, status=np.full(BOARD, NodeStatus.INTERPOLATED))
    nan, blind = (keep(corners, np.arange(len(corners))) for _ in range(2))
    nan.xy[3, 1] = np.nan
    blind.edges[:] = np.nan
    for said, kind, given in [
        ("shape must be", GridError, {"shape": (0, 6)}),
        ("shape must be", GridError, {"shape": "66"}),
        ("has (6, 9)", GridError, {"shape": (5, 6), "like": rest}),
        ("like must be of type Grid", GridError, {"like": corners}),
        ("no nodes", GridError, {"like": empty}),
        ("no two measured nodes", GridError, {"like": alone}),
        ("no two measured nodes", GridError, {"like": between}),
        ("no two measured nodes", GridError, {"like": rest, "previous": alone}),
        ("needs the grid at rest", GridError, {"previous": rest}),
        ("no edge angles", GridError, {"corners": blind}),
        ("finite", GridError, {"corners": nan}),
        ("image", ImageError, {"image": np.zeros((10, 10))}),
        ("the image that they were found in", ImageError, {"image": np.zeros((10, 10), np.uint8)}),
        ("", GridError, {"shape": (100_000, 100_000)}),
    ]:
        with pytest.raises(kind) as caught:
            build_grid(**({"corners": corners, "image": view.image} | given))
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["gel, severity 0.5", "torn gel 61"])
def test_a_detector_gives_the_grid_of_its_own_corners(name):
    view, _ = seen(name)
    with Detector(shape=view.image.shape) as detector:
        corners, grid = detector.grid(view.image)
        again = build_grid(corners, view.image)
    for field in ("xy", "status", "index", "sigma"):
        np.testing.assert_array_equal(getattr(grid, field), getattr(again, field))


# photographs, where they lie beside the repository


def photograph(name: str) -> View:
    folder, _, stem = name.partition("/")
    path = photographs(folder) / f"{stem}.json"
    listed = json.loads(path.read_text())
    image = cv2.imread(str(path.with_name(listed["image"])), cv2.IMREAD_GRAYSCALE)
    corners = np.array([(c["x"], c["y"], c["j"], c["i"]) for c in listed["corners"]], np.float64)
    return View(image, corners, BOARD, listed["cell_px"]["median"])


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("puzzleboard/example1", 0.98),
        ("curved/curve_4", 0.97),
        pytest.param("water/reference_df", 0.99, marks=pytest.mark.exhaustive),
    ],
)
def test_photographs_get_one_consistent_lattice(name, share):
    view = photograph(name)
    score = scored(grid_of(view), view)
    assert score.wrong == 0
    assert score.share >= share


@pytest.mark.parametrize("name", ["left01", "left02", "left03", "right02", "right04"])
def test_boards_in_a_room_are_found_whole_and_in_part(name):
    view = photograph(f"stereo_opencv/{name}")
    grid = grid_of(view, shape=BOARD)
    score = scored(grid, view, known="board")
    assert score.clean
    assert score.right >= 53
    part = cut(view, (0, 0, np.quantile(view.corners[:, 0], 0.7) / view.image.shape[1], 1))
    for known in ({}, {"shape": BOARD}):
        grid = grid_of(part, **known)
        assert_right_or_told(grid, part, "board" if known else "")
        assert scored(grid, part).share >= 0.95
