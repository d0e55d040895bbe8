"""Boards: parts in one frame of numbers, across tears where that is sure."""

import dataclasses

import cv2
import numpy as np
import pytest
from lattice_plans import K, gel, started
from scenes import board

from cmp_cl import Detector, DetectorConfig, detect
from cmp_cl.lattice.boards import boards
from cmp_cl.synthetic import Indenter, random_scene, render
from cmp_cl.synthetic.boards import drawn, plane
from cmp_cl.synthetic.scoring import agreeing


def found(device, image, **changed):
    """Return the corners, and the boards of an image, the largest part's first; changed: constants
    of the lattice."""
    corners = detect(image, device=device)
    plan = started(device, image, corners, constants=dataclasses.replace(K, **changed))
    return corners, list(boards(plan, corners.xy))


def right(corners, board, truth):
    """Return how many corners are nodes, and how many of these have the numbers of the truth, up to
    one turn and one shift."""
    row, column = np.nonzero(board.owner >= 0)
    xy = corners.xy[board.owner[row, column]]
    away = np.linalg.norm(xy[:, None] - truth.reshape(1, -1, 2), axis=2)
    true_row, true_column = np.divmod(away.argmin(axis=1), truth.shape[1])
    numbers, true = np.stack([row, column], 1), np.stack([true_row, true_column], 1)
    return len(row), np.count_nonzero(agreeing(numbers, true))


@pytest.mark.parametrize("seed", [3, 8])
def test_a_gel_torn_all_around_a_ring_is_one_board_with_right_numbers(device, seed):
    scene = random_scene(720_000 + seed, markers=40 + seed, indenter=Indenter.TORUS, severity=2.0)
    shot = render(scene)
    corners, (largest, *_) = found(device, shot.image)
    nodes, agreed = right(corners, largest, shot.truth)
    assert agreed == nodes
    assert nodes > 0.88 * shot.truth[..., 0].size


@pytest.mark.parametrize("seed", [5, 6])
def test_a_corner_is_a_node_of_one_board_at_most(device, seed):
    """A whole gel of small parts, of which none are joined: a board grows into others."""
    image = gel(1.0, seed=seed)
    _, every = found(device, image, agree=0.05, join_votes=np.inf)
    assert len(every) > 1
    assert all(np.count_nonzero(each.there) >= K.least_board for each in every)
    owner = np.concatenate([each.owner[each.owner >= 0] for each in every])
    assert len(np.unique(owner)) == len(owner)


@pytest.mark.parametrize("number", range(1, 5))
def test_the_edge_of_a_shadow_parts_no_board(device, number):
    """An eighth of the light is left behind it."""
    image = board(number).image
    light = 0.125 + 0.875 / (1 + np.exp((200.0 - np.arange(image.shape[1])) / 12))
    _, (seen, *_) = found(device, (light * image).astype(np.uint8))
    assert np.count_nonzero(seen.owner >= 0) == 54


def test_a_fine_board_in_noise_is_one_board(device):
    """Noise leaves parts of a few faces."""
    camera = plane(cell=6, middle=(0, 0), turn=17)
    corners, (largest, *_) = found(device, drawn(camera, (300, 400), noise=50, seed=1).image)
    at = np.stack(camera(*corners.xy.T), axis=1)  # columns and rows
    row, column = np.nonzero(largest.owner >= 0)
    number = np.rint(at[largest.owner[row, column]])[:, ::-1].astype(int)
    assert agreeing(np.stack([row, column], 1), number).sum() > 0.95 * len(corners)


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


def in_pixels(black):
    """Return an image of cells that are drawn with 3 samples for each pixel and axis."""
    blurred = cv2.GaussianBlur((210 - 170.0 * black).astype(np.float32), (0, 0), 2.4)
    size = black.shape[1] // 3, black.shape[0] // 3
    return cv2.resize(blurred, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


def test_sides_that_bend_are_links(device):
    """Wide cells, the middles of whose sides lie up to 8 px beside their chords."""
    y, x = np.mgrid[:1800, :2100] / 3
    bent_x, bent_y = x + 25 * np.sin(y / 60), y + 25 * np.sin(x / 60)
    black = (np.floor(bent_x / 90) + np.floor(bent_y / 90)) % 2
    image = in_pixels(black)
    corners = detect(image, device=device)
    plan = started(device, image, corners)
    twin = plan.read("twin", np.int32)[: 4 * len(corners)]
    assert np.count_nonzero(twin >= 0) > 3 * len(corners)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_tabs_on_the_sides_of_a_puzzle_part_no_board(device, seed):
    """Cells of 60 px; a disc of one of the two colours hides the middle of each side."""
    colour = np.random.default_rng(seed).random((17, 17)) < 0.5
    v, u = np.mgrid[:1440, :1440] / 90  # half cells
    row, column = np.rint(v).astype(int), np.rint(u).astype(int)
    disc = (np.hypot(u - column, v - row) < 0.34) & ((row + column) % 2 == 1)
    black = np.where(disc, colour[row, column], (np.floor(u / 2) + np.floor(v / 2)) % 2 == 0)
    _, (seen, *_) = found(device, in_pixels(black))
    assert np.count_nonzero(seen.owner >= 0) == 49
