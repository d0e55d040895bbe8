"""Two boards that touch look like one, and faint corners beside a board look like its own."""

import cv2
import numpy as np
import pytest

from cmp_cl import DetectorConfig, build_grid, detect
from cmp_cl.errors import GridError
from cmp_cl.grid.mirror import has_seam
from cmp_cl.grid.seam import touch

CELL = 20  # px


def plane(rows: int, columns: int, *, tilt: float = 0.0) -> np.ndarray:
    """Return nodes of a board in perspective, with noise, px."""
    row, column = np.indices((rows, columns))
    noise = np.random.default_rng(4).normal(0, 0.05, (2, rows, columns))
    return CELL * (column + 1j * row) / (1 + tilt * column) + noise[0] + 1j * noise[1]


def two_boards(gap: complex, *, tilt: float = 0.0) -> np.ndarray:
    """Return 8 x 15 nodes; column 7 lies between the boards, which are `gap` cells apart."""
    at = plane(8, 15, tilt=tilt)
    at[:, 7] += gap * CELL / 2
    at[:, 8:] += gap * CELL
    return at


@pytest.mark.parametrize("gap", [0.1, -0.1, 0.3, 0.1j, 0.2 + 0.1j])
@pytest.mark.parametrize("seen", [True, False])
def test_boards_that_do_not_touch_exactly_are_told_from_one(gap, seen):
    at = two_boards(gap)
    if not seen:
        at[:, 7] = np.nan
    assert touch(at)
    assert touch(at.T)


def test_a_seam_at_a_line_of_nodes_is_none_between_nodes():
    assert not has_seam(two_boards(0.2))


@pytest.mark.parametrize("tilt", [0, 0.03])
def test_one_board_has_no_seam(tilt):
    assert not touch(two_boards(0, tilt=tilt))


def test_a_step_that_is_largest_at_the_border_is_distortion():
    at = plane(8, 12)
    column = np.arange(12)
    assert not touch(at + CELL * 0.3 * np.maximum(column - 8, 0) ** 2)


def test_a_surface_that_bends_in_one_direction_as_much_as_at_the_seam_has_none():
    at = two_boards(0.1)
    row = np.arange(8)
    assert not touch(at + 0.05j * CELL * np.sin(2 * row)[:, None])


def test_too_few_nodes_show_no_seam():
    assert not touch(two_boards(0.2)[:3, 4:12])
    assert not touch(np.full((8, 9), np.nan + 0j))


def drawn(gap: float) -> np.ndarray:
    """Draw two boards of 7 x 8 squares side by side, `gap` cells apart, in alternate colours."""
    high, wide = 240, 420
    y, x = np.indices((4 * high, 4 * wide)) / 4
    down, across = (y - 40) / CELL, (x - 40) / CELL
    second = across > 8 + gap / 2
    across = across - gap * second
    on = (down > 0) & (down < 7) & (across > 0) & (across < 16)
    on &= second | (across < 8)
    on &= ~second | (across > 8)
    level = np.full(x.shape, 120.0)
    level[on] = np.where((np.floor(across) + np.floor(down)) % 2 == 0, 30.0, 210.0)[on]
    small = cv2.resize(level.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.7)
    small += np.random.default_rng(1).normal(0, 2, small.shape)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def test_two_boards_that_touch_are_numbered_as_one_with_a_warning():
    image = drawn(0.12)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    grid = build_grid(corners, image)
    assert grid.shape == (6, 15)
    assert grid.reflected
    with pytest.raises(GridError, match="another pattern"):
        build_grid(corners, image, strict=True)


def test_one_board_is_numbered_without_a_warning():
    image = drawn(0)
    grid = build_grid(detect(image, DetectorConfig.for_cell(CELL)), image)
    assert grid.shape == (6, 15)
    assert not grid.doubts


def with_marks(grey: float) -> np.ndarray:
    """Draw a board of 6 x 9 corners, and marks of that grey level beside its upper squares.

    The marks make two of its upper squares' outer corners look like corners.
    """
    high, wide = 260, 300
    y, x = np.indices((4 * high, 4 * wide)) / 4
    across, down = (x - 50) / CELL, (y - 70) / CELL
    black = (np.floor(across) + np.floor(down)) % 2 == 0
    level = np.full(x.shape, 200.0)
    for corner in (3, 4):
        mark = np.maximum(np.abs(across - corner), -down) < 0.7
        level[mark & (down < 0) & black] = grey
    level[(across > 0) & (across < 10) & (down > 0) & (down < 7) & black] = 30
    small = cv2.resize(level.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.7)
    small += np.random.default_rng(1).normal(0, 2, small.shape)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("grey", [90, 110])
def test_two_faint_corners_are_no_line_that_a_known_shape_lacks(grey):
    image = with_marks(grey)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    assert build_grid(corners, image, shape=(7, 9)).doubts
    assert not build_grid(corners, image, shape=(6, 9)).doubts
