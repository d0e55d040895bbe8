"""A lattice that runs on into another one is cut there."""

import cmath

import cv2
import numpy as np
import pytest

from cmp_cl import DetectorConfig, build_grid, detect
from cmp_cl.errors import GridError
from cmp_cl.grid import build_grids
from cmp_cl.grid.build import Board, Ended, _others
from cmp_cl.grid.grid import MEASURED
from cmp_cl.grid.grow import Seen
from cmp_cl.grid.joints import cut, cut_by_image
from cmp_cl.grid.lattice import Lattice, lines_of
from cmp_cl.grid.nodes import boxed
from cmp_cl.grid.numbering import Numbered
from cmp_cl.synthetic import Indenter, random_scene, render

BOARD = (7, 9)  # inner corners
CELL = 24  # px


def linked(at: np.ndarray, *, unit: complex = 1) -> tuple[np.ndarray, Lattice]:
    """Return positions, and their lattice of one component, whose numbers are rotated by a unit."""
    row, column = np.nonzero(~np.isnan(at.real))
    z = at[row, column]
    steps = at[:, 1:] - at[:, :-1]
    down = at[1:] - at[:-1]
    axis = {1: steps, -1: -steps, 1j: down, -1j: -down}[unit]
    found = Lattice(
        component=np.zeros(len(z), np.int64),
        size=np.array([len(z)]),
        node=((column + 1j * row) / unit).astype(np.complex64),
        turn=np.ones(len(z), np.complex64),
        support=np.zeros(len(z), np.int64),
        axis=np.array([np.nanmean(axis)]),
    )
    return z, found


def cut_of(at: np.ndarray, *, unit: complex = 1) -> tuple[Lattice | None, np.ndarray]:
    z, found = linked(at, unit=unit)
    return cut(found, boxed(z, found)), z


def plane(rows: int, columns: int, step: complex) -> np.ndarray:
    row, column = np.indices((rows, columns))
    return step * (column + 1j * row)


def two_boards() -> tuple[np.ndarray, np.ndarray]:
    """Return 8 x 9 nodes, then 8 x 5 with larger, rotated cells, and a mask of the latter."""
    jitter = np.random.default_rng(5).normal(0, 0.2, (2, 8, 14))
    second = 110 - 20j + plane(8, 5, 16 * cmath.exp(0.5j))
    at = np.hstack([plane(8, 9, 10), second]) + jitter[0] + 1j * jitter[1]
    return at, np.indices(at.shape)[1] >= 9


@pytest.mark.parametrize("unit", [1, 1j, -1, -1j])
def test_two_boards_that_false_cells_link_are_cut_apart(unit):
    at, second = two_boards()
    found, z = cut_of(at, unit=unit)
    np.testing.assert_array_equal(found.size, [72, 40])
    np.testing.assert_array_equal(found.component, second.ravel())
    nodes = boxed(z, found, 1)
    np.testing.assert_allclose(nodes.at, at[:, 9:])


def test_a_larger_component_stays_before_the_parts():
    at, _ = two_boards()
    z, found = linked(at)
    other = plane(9, 9, 12) + 1000
    every = Lattice(
        component=np.append(found.component, np.full(81, 1)),
        size=np.append(found.size, 81),
        node=np.append(found.node, plane(9, 9, 1).ravel()),
        turn=np.append(found.turn, np.ones(81)),
        support=np.zeros(len(z) + 81, np.int64),
        axis=np.append(found.axis, 12),
    )
    z = np.append(z, other.ravel())
    parts = cut(every, boxed(z, every))
    np.testing.assert_array_equal(parts.size, [81, 72, 40])
    assert (parts.component[len(found.node) :] == 0).all()
    assert cut(parts, boxed(z, parts)) is None


def test_a_cell_or_two_that_do_not_agree_are_left_to_the_image():
    at = plane(8, 9, 10)
    odd = at.copy()
    odd[3, 8] += 6 + 5j
    assert cut_of(odd)[0] is None


def test_a_hole_does_not_cut():
    at = plane(9, 12, 10) + np.random.default_rng(2).normal(0, 0.3, (9, 12))
    at[:3, 5] = at[5:, 5] = np.nan
    assert cut_of(at)[0] is None
    at[5, 4] = np.nan  # one row of cells goes across, one of which is lost
    assert cut_of(at)[0] is None


@pytest.mark.parametrize("radius", [2.6, 3.2])
def test_a_bend_is_no_joint(radius):
    row, column = np.indices((8, 7))
    angle = (column - 2.0) / radius
    at = 20 * (radius * np.sin(angle) + 1j * (row - 0.7 * radius * (1 - np.cos(angle))))
    steps = np.abs(np.diff(at, 2, axis=1)).max()
    assert steps > 0.27 * 20  # more than two cells may differ without a bend
    assert cut_of(at)[0] is None


def test_parts_with_the_same_steps_but_other_positions_are_cut_apart():
    at = plane(8, 14, 10)
    at[:, 7:] += 5 + 4j
    at[[0, 1, 2, 4, 5, 6, 7], 7] = np.nan
    found, _ = cut_of(at)
    np.testing.assert_array_equal(found.size, [56, 48])


def test_a_single_pair_of_cells_shows_no_bend_but_a_whole_line_does():
    at = plane(8, 14, 10)
    at[:, 10:] += 3.9 * np.arange(1, 5)  # wider cells, by less than a bend may change them
    assert cut_of(at)[0] is None
    at[[0, 1, 2, 5, 6, 7], 9] = np.nan
    found, _ = cut_of(at)
    np.testing.assert_array_equal(found.size[:2], [74, 32])


def before_squares(seed: int = 0, *, rotation: float = 0.45, square: float = 19.0) -> np.ndarray:
    """Draw a board on white paper in front of a rotated floor of grey squares, `square` px wide."""
    high, wide = 330, 400
    y, x = np.indices((4 * high, 4 * wide)) / 4
    u, v = x * np.cos(rotation) + y * np.sin(rotation), y * np.cos(rotation) - x * np.sin(rotation)
    level = np.where((np.floor(u / square) + np.floor(v / square)) % 2 == 0, 85.0, 150.0)
    across, down = (x - 70) / CELL, (y - 60) / CELL
    rows, columns = BOARD[0] + 1, BOARD[1] + 1
    paper = (across > -0.3) & (across < columns + 0.3) & (down > -0.3) & (down < rows + 0.3)
    on = (across > 0) & (across < columns) & (down > 0) & (down < rows)
    level[paper] = 220
    level[on & ((np.floor(across) + np.floor(down)) % 2 == 0)] = 30
    small = cv2.resize(level.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.7)
    small += np.random.default_rng(seed).normal(0, 2, small.shape)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def on_board(grid) -> np.ndarray:
    """Return which nodes are corners of the drawn board."""
    at = grid.xy[grid.valid] - np.array([70, 60]) + 0.5
    number = np.rint(at / CELL)
    near = np.abs(at - number * CELL).max(axis=1) < 2
    return near & (number >= 1).all(axis=1) & (number <= BOARD[::-1]).all(axis=1)


@pytest.mark.parametrize(("rotation", "square"), [(0.25, 30), (0.45, 30)])
def test_a_board_in_front_of_a_floor_of_squares_is_numbered_alone(rotation, square):
    image = before_squares(rotation=rotation, square=square)
    grid = build_grid(detect(image, DetectorConfig.for_cell(CELL)), image)
    assert grid.shape in (BOARD, BOARD[::-1])
    assert on_board(grid).all()


FLOORS = [(0.15, 22), (0.15, 26), (0.45, 19)]  # of more corners than the board has


@pytest.mark.parametrize(("rotation", "square"), FLOORS)
def test_a_board_is_the_grid_and_a_floor_of_many_squares_is_reported(rotation, square):
    image = before_squares(rotation=rotation, square=square)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    grid = build_grid(corners, image)
    assert grid.shape in (BOARD, BOARD[::-1])
    assert on_board(grid).all()
    assert grid.doubts[0].startswith(f"another pattern of {grid.others} corners is seen")
    with pytest.raises(GridError, match="another pattern"):
        build_grid(corners, image, strict=True)
    own = [on_board(grid).mean() for grid in build_grids(corners, image)]
    assert own.count(1.0) == 1
    assert own.count(0.0) == len(own) - 1


@pytest.mark.parametrize(("rotation", "square"), FLOORS)
def test_a_known_size_or_a_region_leaves_no_doubt(rotation, square):
    image = before_squares(rotation=rotation, square=square)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    for grid in (
        build_grid(corners, image, shape=BOARD),
        build_grid(corners, image, region=(75, 65, 300, 245)),
    ):
        assert on_board(grid).all()
        assert np.count_nonzero(grid.valid) == BOARD[0] * BOARD[1]
        assert not grid.doubts


@pytest.mark.parametrize(("missing", "whole"), [(10, True), (11, False)])
def test_a_pattern_is_seen_whole_in_a_known_shape_with_nine_tenths_of_its_nodes(missing, whole):
    at = plane(10, 10, 20)
    at.ravel()[11:89:7][:missing] = np.nan
    board = Board(Numbered(boxed(*linked(at))), Ended())
    assert board.is_whole((10, 10)) is whole
    assert not board.is_whole(None)


def test_another_lattice_is_compared_with_the_linked_corners_though_most_are_attached():
    z, found = linked(plane(8, 10, 20))
    board = Board(Numbered(boxed(z, found)), Ended())
    other = 300 + plane(4, 4, 20).ravel()
    label = np.where(np.arange(96) < 36, 0, -1)
    label[80:] = 1
    found = found._replace(component=label, size=np.array([36, 16]))
    board.numbered.nodes.owner.ravel()[36:] = np.arange(36, 80)
    edges = np.zeros((96, 4), np.float32)
    seen = Seen(np.append(z, other), edges, lines_of(edges), None, np.zeros(97, np.bool_))
    assert _others(found, board, seen, alone=False) == 16
    found = found._replace(component=np.where(label == 0, -1, label))
    assert _others(found, board, seen, alone=False) == 0


def test_of_two_boards_the_one_of_the_known_size_is_numbered():
    image = np.full((330, 560), 180, np.uint8)
    image[:, :400] = before_squares(square=1000)
    row, column = np.indices((300, 140)) // 20
    image[15:315, 410:550] = np.where((row + column) % 2, 30, 220)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    with pytest.raises(GridError, match="two patterns are seen, of 84 and 63 corners"):
        build_grid(corners, image)
    assert on_board(build_grid(corners, image, shape=BOARD)).all()
    other = build_grid(corners, image, shape=(14, 6))
    assert other.valid.all()
    assert not other.doubts
    assert other.xy[..., 0].min() > 400


def test_a_board_of_wide_cells_in_fine_clutter_is_found():
    blocks = np.random.default_rng(1).uniform(20, 235, (128, 160)).repeat(5, 0).repeat(5, 1)
    image = blocks.astype(np.uint8)
    image[40:280, 50:330] = before_squares()[40:280, 50:330]
    corners = detect(image, DetectorConfig.for_cell(CELL))
    assert BOARD[0] * BOARD[1] < 0.02 * len(corners)
    for shape in (None, BOARD):
        grid = build_grid(corners, image, shape=shape)
        assert on_board(grid).all()
        assert np.count_nonzero(grid.valid) == BOARD[0] * BOARD[1]


@pytest.mark.parametrize("shape", [None, BOARD])
def test_things_that_complete_a_few_squares_are_beyond_the_border(shape):
    image = before_squares(square=1000)
    image[:, 310:] = 120
    for number, level in enumerate((45, 215, 45)):  # beside white, black, white squares
        top = 105 + number * CELL
        image[top : top + CELL, 310:335] = level
    corners = detect(image, DetectorConfig.for_cell(CELL))
    beside = (np.abs(corners.xy[:, 0] - 310) < 3) & (corners.xy[:, 1] > 80)
    assert np.count_nonzero(beside) >= 2
    grid = build_grid(corners, image, shape=shape)
    assert on_board(grid).all()
    assert np.count_nonzero(grid.valid) == BOARD[0] * BOARD[1]
    assert not grid.doubts


def test_cells_between_the_corners_of_a_part_are_not_cut_again_and_again():
    at = plane(9, 9, 10)
    row, column = np.indices(at.shape)
    at[(row % 3 == 1) & (column % 3 == 1)] += 30
    z, found = linked(at)
    for _ in range(len(z)):
        parts = cut(found, boxed(z, found))
        if parts is None:
            break
        assert parts.size[0] < found.size[0]
        found = parts
    assert parts is None


def torn_ring(shift: int, wide: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes of parity 0 with a ring of missing ones, and the image of their squares.

    Inside the ring the numbers are wrong by so many rows and columns. A chain of three rows of
    cells, so many wide, links them to the others.
    """
    true = plane(24, 24, 12) + (20 + 20j)
    squares = np.kron(np.indices((25, 25)).sum(axis=0) % 2, np.ones((12, 12)))
    image = np.pad(np.where(squares > 0, 210, 40).astype(np.uint8), 8)
    at = true.copy()
    at[5:19, 5:19] = np.nan
    at[7:17, 7:17] = true[7 + shift : 17 + shift, 7 - shift : 17 - shift]
    chain = slice(10, 11 + wide)
    at[5:7, chain] = np.linspace(at[4, chain], at[7, chain], 4)[1:3]
    return at, image


@pytest.mark.parametrize("wide", [1, 4])
@pytest.mark.parametrize("quarters", range(4))
def test_a_part_inside_a_torn_ring_is_cut_off_if_its_numbers_are_wrong(quarters, wide):
    at, image = torn_ring(shift=1, wide=wide)
    z, found = linked(np.rot90(at, quarters))
    parts = cut_by_image(found, boxed(z, found), image)
    assert parts is not None
    assert parts.size.tolist() == [24 * 24 - 14 * 14, 10 * 10]


def test_a_part_inside_a_torn_ring_stays_if_its_numbers_are_right():
    at, image = torn_ring(shift=0)
    z, found = linked(at)
    assert cut_by_image(found, boxed(z, found), image) is None


def test_no_number_inside_a_torn_ring_is_wrong():
    scene = random_scene(73004, markers=40, severity=2.0, indenter=Indenter.TORUS)
    shot = render(scene)
    grid = build_grid(detect(shot.image), shot.image, shape=(40, 40))
    off = np.linalg.norm(grid.xy - shot.truth, axis=2)[np.isin(grid.status, MEASURED)]
    assert np.count_nonzero(off < 0.3 * shot.cell) == len(off) > 1250
