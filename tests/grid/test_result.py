"""A grid as a result: turned, cut, aligned with another, printed, and kept in a file."""

import dataclasses
import itertools
import math
import re

import numpy as np
import pytest
from lattices import drawn
from scenes import board, corners_of

from cmp_cl import Grid, GridError, build_grid, detect
from cmp_cl.grid import Others, Rival, Sides, align
from cmp_cl.grid.choice import Asked, Found, chosen_of
from cmp_cl.lattice.arrays import Board, Border
from cmp_cl.lattice.numbers import Decision, Numbering


@pytest.fixture(scope="module")
def grid() -> Grid:
    image, _ = drawn(6, 9)
    return build_grid(detect(image), image)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"border": None, "confidence": 2.5, "rival": Rival(2, -1, 1), "origin": (-3, 4)},
        {"border": Sides(left=True), "seen_shape": (7, 9), "edge_radius": math.nan},
        {"others": 40, "others_are": Others.GAP},
    ],
)
def test_a_saved_grid_comes_back_as_it_was(grid, changes, tmp_path):
    grid = dataclasses.replace(grid, **changes)
    grid.save(tmp_path / "rest.npz")
    found = Grid.load(tmp_path / "rest.npz")
    for field in dataclasses.fields(Grid):
        one, other = getattr(grid, field.name), getattr(found, field.name)
        assert type(one) is type(other), field.name
        np.testing.assert_array_equal(one, other, err_msg=field.name)
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None)
    assert found.doubts == grid.doubts


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        (
            "image_sigma",
            np.zeros((6, 8), "f4"),
            r"image_sigma must be \(6, 9\) of float32, found",
        ),
        ("status", np.zeros((6, 9), "u1"), "xy must be NaN where status is 0 and finite elsewhere"),
        (
            "index",
            np.full((54, 2), 7, "i4"),
            r"index must lie in \(6, 9\) or be -1, found \[7, 7\]",
        ),
        ("origin", None, "there is no array 'origin'"),
        ("rival", np.array([None]), "is damaged or holds no grid"),
    ],
)
def test_a_file_that_holds_no_grid_is_refused_in_one_line(grid, tmp_path, name, values, said):
    path = tmp_path / "rest.npz"
    grid.save(path)
    arrays = dict(np.load(path)) | {name: values}
    np.savez(path, **{key: each for key, each in arrays.items() if each is not None})
    with pytest.raises(GridError, match=said) as caught:
        Grid.load(path)
    assert "rest.npz" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3, 4, -1])
def test_a_turned_grid_has_the_same_nodes_and_turning_back_gives_the_grid(grid, quarters):
    grid = dataclasses.replace(grid, border=Sides(top=True), seen_shape=(7, 9))
    other = grid.turned(quarters)
    np.testing.assert_array_equal(other.xy, np.rot90(grid.xy, quarters))
    known = other.index[:, 0] >= 0
    one, same = other.xy[tuple(other.index[known].T)], grid.xy[tuple(grid.index[known].T)]
    np.testing.assert_array_equal(one, same)
    side = (Sides(top=True), Sides(left=True), Sides(bottom=True), Sides(right=True))
    assert other.border == side[quarters % 4]
    back = other.turned(-quarters)
    for name in ("xy", "status", "sigma", "index"):
        np.testing.assert_array_equal(getattr(back, name), getattr(grid, name))
    for name in ("parity", "border", "seen_shape", "reach"):
        np.testing.assert_array_equal(getattr(back, name), getattr(grid, name))


def test_a_grid_cut_to_another_has_its_numbers(grid):
    rest = dataclasses.replace(grid, origin=(2, -1))
    cut = grid.cut_to(rest)
    assert (cut.shape, cut.origin) == (grid.shape, rest.origin)
    np.testing.assert_array_equal(cut.xy[:4, 1:], grid.xy[2:, :8])
    assert not cut.valid[4:].any()
    assert not cut.valid[:, 0].any()
    assert not grid.covers(rest)
    assert grid.covers(dataclasses.replace(rest, xy=rest.xy[:4, 1:], origin=(2, 0)))
    known = cut.index[:, 0] >= 0
    np.testing.assert_array_equal(cut.index[known], grid.index[known] - [2, -1])
    assert known.sum() == cut.valid.sum() == 32
    np.testing.assert_array_equal(cut.cut_to(grid).xy[2:, :8], grid.xy[2:, :8])


def test_views_of_a_board_are_numbered_alike_whichever_way_the_cameras_are_turned():
    views = [board(number) for number in range(4)]
    grids = align([build_grid(corners_of(view), view.image) for view in views])
    for view, grid in zip(views, grids, strict=True):
        away = np.linalg.norm(grid.xy - view.corners[:, :2].reshape(6, 9, 2), axis=2)
        turned = np.linalg.norm(grid.turned(2).xy - view.corners[:, :2].reshape(6, 9, 2), axis=2)
        assert min(away.max(), turned.max()) < 0.5
        assert (away.max() < 0.5) == (grids[0].xy[0, 0, 0] < grids[0].xy[0, 8, 0])
    with pytest.raises(GridError, match="numbered alike"):
        align([grids[0], grids[0].cut_to(dataclasses.replace(grids[0], xy=grids[0].xy[:5]))])


def test_a_grid_says_in_one_line_what_it_is_and_gives_opencv_its_points(grid):
    assert repr(grid) == "<Grid of 6 x 9 nodes: 54 detected>"
    nodes, points = grid.to_opencv(2.5)
    assert nodes.shape == (54, 1, 3)
    np.testing.assert_array_equal(nodes[-1, 0], [8 * 2.5, 5 * 2.5, 0])
    np.testing.assert_array_equal(points[-1, 0], grid.xy[5, 8])


@pytest.mark.parametrize(("second", "counted"), [(0, 0), (2, 0), (3, 9), (5, 15)])
@pytest.mark.parametrize("first", [5, 6])
def test_regions_are_of_cells_with_firm_nodes_that_share_sides(first, second, counted):
    """The second region has three rows, and touches the first by one side or by none."""
    firm = np.zeros((12, 20), np.bool_)
    firm[:6, :10] = True
    firm[first : first + 3, 10 : 10 + second] = True
    nodes = np.zeros(firm.shape, np.float32)
    board = Board(x=nodes, y=nodes, owner=nodes.astype(int), torn=~firm, firm=firm, sign=1)
    for each in (board, board.turned(1)):
        found = Found(each, Decision(Numbering(0, 0, 0, 0, 0), None, np.inf), 0)
        assert chosen_of([found], Asked(), firm.size) == (
            found,
            (counted, Others.HANGING if counted else Others.NONE),
        )


def whole(cell: float, left: float, ends: int = 4) -> Found:
    """Return a board of 6 x 9 nodes whose border is seen on some sides; cell, left: px."""
    none, side = np.zeros((6, 9), np.bool_), np.arange(4)
    x, y = cell * np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)))
    reach = np.where(side < ends, 1, np.nan)
    border = Border(reach=reach, follows=side < 0, room=side < ends)
    owner = np.arange(54).reshape(6, 9)
    board = Board(x=x + left, y=y, owner=owner, torn=none, firm=~none, sign=1, border=border)
    return Found(board, Decision(Numbering(0, 0, 0, 0, 0), None, np.inf), 0)


@pytest.mark.parametrize(("ends", "first"), [(0, False), (1, True)])
def test_only_a_lattice_that_ends_nowhere_is_the_ground_behind_a_smaller_board(ends, first):
    """A board that an object hides in part is no full rectangle either."""
    side, none = np.arange(4), np.zeros((20, 20), np.bool_)
    border = Border(np.where(side < ends, 1, np.nan), side < 0, side < 0)
    owner = np.where(
        np.add.outer(np.arange(20), np.arange(20)) < 15, -1, np.arange(400).reshape(20, 20)
    )
    x, y = 10 * np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)))
    seen = Board(x=x, y=y, owner=owner, torn=none, firm=~none, sign=1, border=border)
    large = Found(seen, Decision(Numbering(0, 0, 0, 0, 0), None, np.inf), 0)
    small = whole(10, 0, 2)
    chosen, told = chosen_of([large, small], Asked(), 400)
    assert chosen is (large if first else small)
    assert told == ((small if first else large).size, Others.PATTERN)


@pytest.mark.parametrize("asked", [Asked(), Asked(shape=(6, 9))])
def test_no_more_boards_are_laid_out_once_two_leave_no_choice(asked):
    def boards():
        yield from (whole(10, 0), whole(10, 200))
        raise AssertionError("a third one was laid out")

    said = "two patterns are seen, of 54 and 54 corners, within 0,0,80,50 and 200,0,80,50 (X,Y,W"
    with pytest.raises(GridError, match=re.escape(said)):
        chosen_of(boards(), asked, 1000)


@pytest.mark.parametrize("asked", [Asked(), Asked(shape=(6, 9))])
def test_a_small_board_before_a_large_one_leaves_a_choice(asked):
    for boards in itertools.permutations([whole(9, 0), whole(30, 100), whole(30, 500)]):
        with pytest.raises(GridError, match="two patterns are seen"):
            chosen_of(boards, asked, 1000)


def test_small_boards_in_the_background_of_a_large_one_are_told_though_they_are_alike():
    """One board of a box of prints is as large as the next."""
    large = whole(70, 0)
    for asked in (Asked(), Asked(shape=(6, 9))):
        chosen, told = chosen_of([large, whole(9, 800), whole(9, 900)], asked, 1000)
        assert chosen is large
        assert told == (54, Others.PATTERN)
