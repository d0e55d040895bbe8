"""Torn nodes are located along the edges to the nodes around them."""

import dataclasses

import cv2
import numpy as np
import pytest

import cmp_cl
from cmp_cl import NodeStatus
from cmp_cl.grid import build_grid
from cmp_cl.grid.nodes import Nodes
from cmp_cl.grid.predict import mean_steps
from cmp_cl.grid.whole_edges import along_edges

SIZE = 9  # inner corners a side
TORN = (4, 5)  # row, column


def checkerboard(cell, tear=0, size=SIZE, torn=(TORN,)):
    """Return a blurred checkerboard with size x size corners, and these corners, (size, size),
    x + 1j y px. Some are torn: there is a white disc of radius `tear`, px."""
    fine, side = 4, cell * (size + 1)
    y, x = (np.mgrid[: fine * side, : fine * side] + 0.5) / (fine * cell)
    grey = np.where((np.floor(x) + np.floor(y)) % 2 == 0, 40.0, 200.0)
    for row, column in torn:
        grey[np.hypot(x - column - 1, y - row - 1) * cell < tear] = 200
    small = cv2.resize(grey, (side, side), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(np.pad(small, cell, constant_values=120), (0, 0), 0.8)
    column, row = np.meshgrid(np.arange(size), np.arange(size))
    return np.rint(small).astype(np.uint8), (column + 1j * row + 2 + 2j) * cell - 0.5 - 0.5j


def nodes_at(corners):
    nodes = Nodes(corners.shape, 0, np.ones(corners.size, np.bool_))
    nodes.at[:] = corners
    nodes.status[:] = NodeStatus.DETECTED
    return nodes


def asked(image, corners, expected, parity=0):
    nodes = nodes_at(corners)
    nodes.parity = parity
    row, column = (np.array([each]) for each in TORN)
    nodes.drop(row, column)
    steps = mean_steps(nodes.at, row, column)
    return along_edges(nodes, image, row, column, np.array([expected]), steps)[0]


def displaced(
    image: np.ndarray, place: complex, off: complex, sigma: float = np.nan
) -> cmp_cl.Corners:
    """Return the corners of an image; the one at that place, px, is off, with that sigma."""
    found = cmp_cl.detect(image, cmp_cl.DetectorConfig())
    moved = np.abs(found.xy @ [1, 1j] - place).argmin()
    xy, sigmas = found.xy.copy(), found.sigma.copy()
    xy[moved] += off.real, off.imag
    sigmas[moved] = sigma
    return dataclasses.replace(found, xy=xy, sigma=sigmas)


@pytest.mark.parametrize("off", [1.5, -1.5, 1.5j, 1 - 1j])
def test_a_node_moves_towards_where_its_edges_meet(off):
    image, corners = checkerboard(12, tear=3.5)
    found = asked(image, corners, corners[TORN] + off)
    assert abs(found - corners[TORN]) < 0.6 * abs(off)


def test_a_node_that_lies_on_its_edges_stays():
    image, corners = checkerboard(12, tear=3.5)
    assert abs(asked(image, corners, corners[TORN]) - corners[TORN]) < 0.15


def test_a_node_whose_two_lines_nearly_coincide_is_rejected():
    image, corners = checkerboard(12)
    column, row = corners.real, corners.imag
    flat = column + row + 0.05j * row
    assert np.isnan(asked(image, flat, flat[TORN]))


def test_edges_of_the_other_polarity_are_not_taken():
    image, corners = checkerboard(12)
    assert not np.isnan(asked(image, corners, corners[TORN]))
    assert np.isnan(asked(image, corners, corners[TORN], parity=1))


def test_a_node_with_an_invisible_edge_is_rejected():
    image, corners = checkerboard(12)
    x, y = round(corners[TORN].real), round(corners[TORN].imag)
    hidden = np.random.default_rng(1).integers(118, 123, (13, 13))
    image[y - 6 : y + 7, x + 1 : x + 14] = hidden
    assert np.isnan(asked(image, corners, corners[TORN]))


def test_a_node_with_faint_edges_beside_a_much_brighter_spot_is_rejected():
    image, corners = checkerboard(12)
    faint = (100 + image / 10).astype(np.uint8)
    assert not np.isnan(asked(faint, corners, corners[TORN]))
    faint[round(corners[TORN].imag) + 4, round(corners[TORN].real) + 4] = 255
    assert np.isnan(asked(faint, corners, corners[TORN]))


def test_noise_has_no_edges():
    noise = np.random.default_rng(3).integers(0, 256, (144, 144)).astype(np.uint8)
    _, corners = checkerboard(12)
    row, column = (each.ravel() for each in np.mgrid[1 : SIZE - 1, 1 : SIZE - 1])
    steps = mean_steps(corners, row, column)
    found = along_edges(nodes_at(corners), noise, row, column, corners[row, column], steps)
    assert np.isnan(found).all()


def test_a_corner_that_is_torn_open_is_measured():
    image, corners = checkerboard(16, tear=8)
    found = cmp_cl.detect(image, cmp_cl.DetectorConfig())
    assert np.abs(found.xy @ [1, 1j] - corners[TORN]).min() > 3
    grid = build_grid(found, image, shape=(SIZE, SIZE))
    assert grid.status[TORN] == NodeStatus.SECOND_LOOK
    assert abs(grid.xy[TORN] @ [1, 1j] - corners[TORN]) < 0.2


def test_a_torn_corner_whose_four_neighbours_are_torn_is_measured_after_them():
    row, column = TORN
    cross = [TORN, (row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
    image, corners = checkerboard(18, tear=5.4, torn=cross)
    grid = build_grid(cmp_cl.detect(image, cmp_cl.DetectorConfig()), image, shape=(SIZE, SIZE))
    assert [grid.status[each] for each in cross] == [NodeStatus.SECOND_LOOK] * 5
    assert abs(grid.xy[TORN] @ [1, 1j] - corners[TORN]) < 0.2


@pytest.mark.parametrize(
    ("off", "status"), [(0.06, NodeStatus.DETECTED), (0.08, NodeStatus.SECOND_LOOK)]
)
def test_a_torn_corner_is_moved_if_it_is_seven_hundredths_of_a_cell_off(off, status):
    image, corners = checkerboard(18)
    torn = displaced(image, corners[TORN], off * 18)
    assert build_grid(torn, image, shape=(SIZE, SIZE)).status[TORN] == status


@pytest.mark.parametrize(
    ("cell", "sigma", "status"),
    [
        (12, np.nan, NodeStatus.SECOND_LOOK),
        (12, 0.5, NodeStatus.SECOND_LOOK),
        (12, 0.05, NodeStatus.DETECTED),
        (24, np.nan, NodeStatus.DETECTED),
    ],
)
def test_a_corner_far_from_its_prediction_is_moved_if_its_own_image_is_torn(cell, sigma, status):
    image, corners = checkerboard(cell)
    moved = displaced(image, corners[TORN], 0.14 * cell * (1 + 1j), sigma)
    grid = build_grid(moved, image, shape=(SIZE, SIZE))
    off = abs(grid.xy[TORN] @ [1, 1j] - corners[TORN])
    assert grid.status[TORN] == status
    assert off < 0.2 if status == NodeStatus.SECOND_LOOK else off > 0.18 * cell
    others = np.delete(grid.status.ravel(), np.ravel_multi_index(TORN, grid.shape))
    assert (others == NodeStatus.DETECTED).all()


@pytest.mark.parametrize(
    ("off", "status"), [(0.18, NodeStatus.DETECTED), (0.25, NodeStatus.INTERPOLATED)]
)
def test_a_torn_corner_of_wide_cells_that_alone_is_far_off_is_dropped(off, status):
    image, corners = checkerboard(24)
    torn = displaced(image, corners[TORN], off * 24j)
    assert build_grid(torn, image, shape=(SIZE, SIZE)).status[TORN] == status


def test_a_corner_whose_refinement_was_rejected_counts_as_torn():
    image, corners = checkerboard(12)
    found = cmp_cl.detect(image, cmp_cl.DetectorConfig())
    moved = np.abs(found.xy @ [1, 1j] - corners[TORN]).argmin()
    xy, refusal = found.xy.copy(), found.refusal.copy()
    xy[moved] += 1.7
    refusal[moved] = cmp_cl.corners.Refusal.SHIFT
    torn = dataclasses.replace(found, xy=xy, refusal=refusal)
    assert build_grid(torn, image, shape=(SIZE, SIZE)).status[TORN] == NodeStatus.SECOND_LOOK


@pytest.mark.parametrize("seed", range(3))
def test_only_outliers_among_the_corners_of_a_worn_print_are_moved(seed):
    size = 20
    image, corners = checkerboard(12, size=size)
    found = cmp_cl.detect(image, cmp_cl.DetectorConfig())
    scatter = np.random.default_rng(seed).normal(0, 0.35, found.xy.shape)
    moved = np.abs(found.xy @ [1, 1j] - corners[TORN]).argmin()
    scatter[moved] = 2.2, 2.2
    xy = (found.xy + scatter).astype(np.float32)
    worn = dataclasses.replace(found, xy=xy, sigma=np.full_like(found.sigma, np.nan))
    status = build_grid(worn, image, shape=(size, size)).status
    assert status[TORN] == NodeStatus.SECOND_LOOK
    assert np.count_nonzero(status != NodeStatus.DETECTED) < 5


def test_the_only_node_with_all_its_neighbours_does_not_count_as_usual():
    image, corners = checkerboard(12, size=7)
    torn = displaced(image, corners[3, 3], 1.7 + 1.7j)
    assert build_grid(torn, image, shape=(7, 7)).status[3, 3] == NodeStatus.SECOND_LOOK
