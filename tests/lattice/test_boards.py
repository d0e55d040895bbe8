"""Boards: parts in one frame of numbers, across tears where that is sure."""

import dataclasses

import numpy as np
import pytest
from lattice_plans import K, gel, started

from cmp_cl import Detector, DetectorConfig, detect
from cmp_cl.lattice.arrays import Board
from cmp_cl.lattice.boards import boards
from cmp_cl.synthetic.boards import drawn, plane


def found(device, image, **changed):
    """Return the corners, and the boards of an image, the largest part's first; changed: constants
    of the lattice."""
    corners = detect(image, device=device)
    plan = started(device, image, corners, constants=dataclasses.replace(K, **changed))
    return corners, list(boards(plan, corners.xy))


@pytest.mark.parametrize("seed", [5, 6])
def test_a_corner_is_a_node_of_one_board_at_most(device, seed):
    """A whole gel of small parts, of which none are joined: a board grows into others."""
    image = gel(1.0, seed=seed)
    _, every = found(device, image, agree=0.05, join_votes=np.inf)
    assert len(every) > 1
    assert all(np.count_nonzero(each.there) >= K.least_board for each in every)
    owner = np.concatenate([each.owner[each.owner >= 0] for each in every])
    assert len(np.unique(owner)) == len(owner)


def around(columns, inner, outer):
    """Return the camera of rows that close on themselves, between two radii, px; as in a mirror on
    a cone, each cell is as large as the one before times the same factor."""

    def to_cells(x, y):
        x, y = x - 320, y - 240
        across = np.log(np.hypot(x, y).clip(1) / inner) / np.log(outer / inner)
        return columns * (1.5 + np.arctan2(y, x) / (2 * np.pi)), 6 * across - 1

    return to_cells


@pytest.mark.parametrize(("columns", "radii"), [(38, (80, 205)), (50, (95, 205))])
def test_rows_that_close_on_themselves_are_numbered_all_around(device, columns, radii):
    """No part of them is without a contradiction: the board grows from a single face."""
    camera = around(columns, *radii)
    image = drawn(camera, (480, 640), (5, 3 * columns)).image
    corners, boards_of_ring = found(device, image)
    largest = max(boards_of_ring, key=lambda each: np.count_nonzero(each.there))
    assert np.count_nonzero(largest.owner >= 0) == len(corners) == 5 * columns
    at = np.rint(np.stack(camera(*corners.xy.T), axis=1)).astype(int)  # columns and rows
    owner = largest.owner
    for first, second in ((owner[:, :-1], owner[:, 1:]), (owner[:-1], owner[1:])):
        both = (first >= 0) & (second >= 0)
        step = at[second[both]] - at[first[both]]
        step[:, 0] = (step[:, 0] + 1) % columns - 1  # the last column is beside the first
        assert (np.abs(step).sum(axis=1) == 1).all()


def test_a_patch_of_fewer_than_nine_cells_is_no_board(device):
    ground = drawn(plane(cell=20, middle=(60, 60)), (300, 400), (6, 9)).image.astype(np.float32)
    camera = plane(cell=20, middle=(300, 200))
    for shape, count in (((3, 4), 1), ((4, 4), 2)):
        assert len(found(device, drawn(camera, (300, 400), shape, ground=ground).image)[1]) == count


def test_a_frame_with_more_corners_than_expected_is_numbered(device):
    """Cells of 6 px: the list of corners grows after the numbers were started."""
    y, x = np.mgrid[:240, :320]
    image = (((x // 6 + y // 6) % 2) * 150 + 50).astype(np.uint8)
    with Detector(
        shape=image.shape, config=DetectorConfig.for_cell(6.0), device=device
    ) as detector:
        for _ in range(2):
            corners, grid = detector.grid(image)
            assert np.count_nonzero(grid.index[:, 0] >= 0) > 0.95 * len(corners) > 1800
        assert detector.regrown > 0


@pytest.mark.parametrize("quarters", range(4))
def test_a_board_is_turned_until_its_rows_follow_the_x_axis(quarters):
    owner = np.arange(12).reshape(3, 4)
    at = (owner % 4 + 1j * (owner // 4)) * 20 * np.exp(0.6j)
    board = Board(x=at.real, y=at.imag, owner=owner, torn=owner < 0, sign=1)
    came = board.turned(quarters).upright()
    np.testing.assert_array_equal(came.owner, owner)
    assert came.sign == 1
