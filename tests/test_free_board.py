"""Calibration on boards that are bent or not exact: their nodes are found with the cameras."""

import cv2
import numpy as np
import pytest
from stereo_data import grid_of, project, toed_in_rig

from cmp_cl import CalibrationError, calibrate, calibrate_camera
from cmp_cl.measure import find_board, trusted
from cmp_cl.points import sides

SQUARE, ROWS, COLUMNS = 3.0, 7, 10
SIZE = (800, 1200)
BOW = 0.3  # mm from the middle of the board to the line through its ends, which are 27 mm apart


def cylinder(flat):
    """Return a board (R, C, 3), bent along its columns without stretch."""
    radius = 27.0**2 / 8 / BOW
    bent = flat.copy()
    bent[..., 0] = radius * np.sin(flat[..., 0] / radius)
    bent[..., 2] = radius * (1 - np.cos(flat[..., 0] / radius))
    return bent


def flat_board():
    row, column = np.indices((ROWS, COLUMNS))
    x, y = column - (COLUMNS - 1) / 2, row - (ROWS - 1) / 2
    return np.stack([x, y, np.zeros(x.shape)], axis=-1) * SQUARE


def pairs(board, count=10, noise=0.05, seed=0):
    """Return views of a board in both cameras of a rig."""
    draw = np.random.default_rng(seed)
    views = []
    for _ in range(count):
        rotation = cv2.Rodrigues(draw.uniform(-0.5, 0.5, 3))[0]
        translation = [*draw.uniform(-3, 3, 2), 50 + draw.uniform(-6, 6)]
        seen = project(toed_in_rig(), board @ rotation.T + translation)
        views.append(tuple(grid_of(view + draw.normal(0, noise, view.shape)) for view in seen))
    return views


def calibrated(views, *, free):
    return calibrate(views, spacing=SQUARE, image_size=SIZE, free_board=free)


def aligned(found, truth):
    """Return a found board after the rigid motion that brings it nearest to the true one."""
    one, other = found.reshape(-1, 3), truth.reshape(-1, 3)
    first, second = one - one.mean(axis=0), other - other.mean(axis=0)
    u, _, v = np.linalg.svd(first.T @ second)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    return (first @ rotation + other.mean(axis=0)).reshape(truth.shape)


def test_a_bent_board_spoils_a_calibration_unless_it_is_free():
    rig, views = toed_in_rig(), pairs(cylinder(flat_board()))
    stiff, free = (calibrated(views, free=free) for free in (False, True))

    def off(found):
        return abs(found.rig.K1[0, 0] - rig.K1[0, 0]), np.linalg.norm(found.rig.T - rig.T)

    assert off(stiff)[0] > 5 > 1 > off(free)[0]
    assert off(stiff)[1] > 10 * off(free)[1]
    assert stiff.error > 0.3
    assert free.error == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert off(free)[0] < 3 * np.sqrt(free.rig.covariance[0, 0])
    assert stiff.board is None


def test_the_board_itself_is_found():
    draw = np.random.default_rng(1)
    truth = cylinder(flat_board()) + draw.normal(0, 0.02, (ROWS, COLUMNS, 3))
    found = calibrated(pairs(truth, count=12), free=True).board
    size = np.linalg.norm(found - found.mean(axis=(0, 1))) / np.linalg.norm(
        truth - truth.mean(axis=(0, 1))
    )
    assert size == pytest.approx(1, abs=2e-3)
    assert np.sqrt(np.square(aligned(found / size, truth) - truth).mean()) < 3e-3


def test_the_mean_side_of_a_free_board_is_the_given_one():
    """The views cannot tell how large the board is; the distance of the cameras scales with it."""
    draw = np.random.default_rng(1)
    truth = cylinder(flat_board()) + draw.normal(0, 0.3, (ROWS, COLUMNS, 3))
    truth *= 1.01
    found = calibrated(pairs(truth, count=12), free=True)
    mean, true = (
        np.concatenate([each.ravel() for each in sides(board)]).mean()
        for board in (found.board, truth)
    )
    assert mean == pytest.approx(SQUARE, rel=1e-12)
    length = np.linalg.norm(toed_in_rig().T) * SQUARE / true
    assert np.linalg.norm(found.rig.T) == pytest.approx(length, rel=2e-3)


def test_a_free_board_that_is_flat_loses_no_accuracy():
    rig, views = toed_in_rig(), pairs(flat_board())
    free = calibrated(views, free=True)
    assert free.rig.K1[0, 0] == pytest.approx(rig.K1[0, 0], abs=1)
    assert np.abs(free.board[..., 2]).max() < 0.02


def test_a_free_board_takes_partial_views():
    rig, views = toed_in_rig(), pairs(cylinder(flat_board()))
    for number, (left, right) in enumerate(views):
        left.xy[: number % 3] = np.nan
        right.xy[:, : number % 4] = np.nan
        left.xy[ROWS - 1, COLUMNS - 1] = np.nan
    free = calibrated(views, free=True)
    assert free.rig.K1[0, 0] == pytest.approx(rig.K1[0, 0], abs=1)
    assert np.argwhere(np.isnan(free.board[..., 0])).tolist() == [[ROWS - 1, COLUMNS - 1]]


def test_grids_that_are_numbered_from_the_other_end_are_rotated():
    truth = cylinder(flat_board()) + np.random.default_rng(1).normal(0, 0.05, (ROWS, COLUMNS, 3))
    views = pairs(truth)
    mixed = [
        tuple(grid.turned(2) for grid in pair) if number % 2 else pair
        for number, pair in enumerate(views)
    ]
    assert mixed[1][0].parity != views[1][0].parity
    one, other = (calibrated(each, free=True) for each in (views, mixed))
    np.testing.assert_allclose(one.board, other.board, atol=1e-4)


def test_too_few_or_unlike_views_of_a_free_board_are_refused():
    views = pairs(flat_board())
    with pytest.raises(CalibrationError, match="3 views of a free board, at least 4 are needed"):
        calibrated(views[:3], free=True)
    lefts = [left for left, _ in views]
    lefts[2] = grid_of(lefts[2].xy[1:])
    with pytest.raises(CalibrationError, match=r"numbered alike.*number 2 has"):
        calibrate_camera(lefts, spacing=SQUARE, image_size=SIZE, free_board=True)


def rendered(matrix, rotation, translation, bend):
    """Return an image of a board of 6 x 9 inner corners, 25 mm apart, on z = bend x^2 / 2."""
    high, wide, fine = 480, 640, 2
    v, u = (np.mgrid[: high * fine, : wide * fine] + 0.5) / fine - 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix).T @ rotation
    centre = -rotation.T @ translation
    reach = -centre[2] / rays[..., 2]
    for _ in range(4):
        x = centre[0] + reach * rays[..., 0]
        reach = (bend * x**2 / 2 - centre[2]) / rays[..., 2]
    x, y = (centre[axis] + reach * rays[..., axis] for axis in (0, 1))
    along = x * (1 + bend**2 * x**2 / 6)  # the length of the parabola
    column, row = np.floor(along / 25 + 5).astype(int), np.floor(y / 25 + 3.5).astype(int)
    inside = (column >= 0) & (column < 10) & (row >= 0) & (row < 7)
    grey = np.where(inside & ((column + row) % 2 == 0), 40.0, 210.0)
    grey = grey.reshape(high, fine, wide, fine).mean(axis=(1, 3))
    noise = np.random.default_rng(int(abs(translation[0]) * 100)).normal(0, 2, grey.shape)
    return np.clip(np.rint(cv2.GaussianBlur(grey, (0, 0), 0.7) + noise), 0, 255).astype(np.uint8)


def test_images_of_a_bent_board_give_the_camera_when_it_is_free():
    matrix = np.array([[600.0, 0, 322], [0, 602.0, 236], [0, 0, 1]])
    draw = np.random.default_rng(980_000)
    grids = []
    for _ in range(6):
        rotation = cv2.Rodrigues(draw.uniform([-0.5, -0.5, -0.15], [0.5, 0.5, 0.15]))[0]
        translation = np.array([*draw.uniform(-30, 30, 2), draw.uniform(360, 420)])
        image = rendered(matrix, rotation, translation, bend=2 * 3.0 / 112**2)  # 3 mm at its ends
        grids.append(trusted(find_board(image, (6, 9))))
    stiff, free = (
        calibrate_camera(grids, spacing=25.0, image_size=(640, 480), free_board=free)
        for free in (False, True)
    )
    assert abs(free.matrix[0, 0] - 600) < 0.2 * abs(stiff.matrix[0, 0] - 600)
    assert free.error < 0.1 < stiff.error
    height = free.board[..., 2].max() - free.board[..., 2].min()
    assert height == pytest.approx(3.0 * (100 / 112) ** 2, rel=0.1)
