"""`cmp_cl.number`: corners of any detector get the numbers of the pattern."""

import cv2
import numpy as np
import pytest

import cmp_cl
from cmp_cl.synthetic import Scene, random_scene, render

VIEW = render(Scene(markers=12, shape=(240, 260), severity=0.5, seed=900003))


def right_and_wrong(grid, xy, true):
    """Count the given corners with their own number, and those with another.

    true: (N, 2) row and column of each, -1 of others; the grid's may differ by one shift.
    """
    some = (grid.index[:, 0] >= 0) & (true[:, 0] >= 0)
    apart = grid.index[some] - true[some]
    same = (apart == np.rint(np.median(apart, axis=0))).all(axis=1)
    np.testing.assert_array_equal(grid.xy[tuple(grid.index[some].T)], xy[some].astype(np.float32))
    false = np.count_nonzero((grid.index[:, 0] >= 0) & (true[:, 0] < 0))
    return np.count_nonzero(same), np.count_nonzero(~same) + false


def drawn(truth, shape, seed, *, noise=0.3, others=10):
    """Return the true corners with noise and others, in any order, and their numbers.

    The others are over 4 px away from a true one.
    """
    draw = np.random.default_rng(seed)
    row, column = (each.ravel() for each in np.mgrid[: truth.shape[0], : truth.shape[1]])
    xy = truth.reshape(-1, 2) + draw.normal(0, noise, (truth.size // 2, 2))
    more = draw.uniform(3, np.array(shape[::-1]) - 4, (others, 2))
    far = np.linalg.norm(more[:, None] - truth.reshape(-1, 2), axis=2).min(axis=1) > 4
    xy = np.concatenate([xy, more[far]])
    true = np.concatenate(
        [np.stack([row, column], axis=1), np.full((np.count_nonzero(far), 2), -1)]
    )
    order = draw.permutation(len(xy))
    return xy[order], true[order]


@pytest.mark.parametrize("seed", range(6))
def test_corners_among_others_get_their_numbers(device, seed):
    scene = random_scene(40 + seed, markers=20, severity=1.0, shape=(240, 320))
    view = render(scene)
    xy, true = drawn(view.truth, view.image.shape, seed)
    grid = cmp_cl.number(xy, view.image, device=device)
    right, wrong = right_and_wrong(grid, xy, true)
    assert right >= 398, (right, wrong)
    assert wrong == 0, (right, wrong)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_image_has_its_rows_from_the_top(device, quarters):
    image, truth = VIEW.image, VIEW.truth
    for _ in range(quarters):
        x, y = truth[..., 0], truth[..., 1]
        truth = np.rot90(np.stack([y, image.shape[1] - 1 - x], axis=2))
        image = np.ascontiguousarray(np.rot90(image))
    xy, true = drawn(truth, image.shape, quarters)
    grid = cmp_cl.number(xy, image, device=device)
    assert right_and_wrong(grid, xy, true) == (144, 0)
    assert grid.shape == (12, 12)
    np.testing.assert_array_equal(grid.index[true[:, 0] >= 0], true[true[:, 0] >= 0])


def test_corners_of_opencv(device):
    image = VIEW.image
    found = cv2.goodFeaturesToTrack(image, 200, 0.02, 8, blockSize=5).reshape(-1, 2)
    grid = cmp_cl.number(found, image, device=device)
    far = np.linalg.norm(grid.xy - VIEW.truth, axis=2)
    assert grid.shape == (12, 12)
    assert np.count_nonzero(far < 3.5) >= 143
    assert grid.parity == cmp_cl.build_grid(cmp_cl.detect(image), image).parity


def test_a_missing_corner_is_interpolated(device):
    xy = np.delete(VIEW.truth.reshape(-1, 2), [40, 77], axis=0)
    grid = cmp_cl.number(xy, VIEW.image.astype(np.uint16) * 257, device=device)
    wanted = np.full((12, 12), cmp_cl.NodeStatus.DETECTED)
    wanted.ravel()[[40, 77]] = cmp_cl.NodeStatus.INTERPOLATED
    np.testing.assert_array_equal(grid.status, wanted)
    assert np.linalg.norm(grid.xy - VIEW.truth, axis=2).max() < 1.5


@pytest.mark.parametrize(
    ("xy", "said"),
    [
        ([[30, 40]], "1 corners form no board: it has 9"),
        (np.zeros((5, 1, 2)), "reshape"),
        ([[1, 2], [3, 4], [5, np.nan], [7, 8]], "not finite"),
        ([[10, 255], [20, 30], [30, 30], [40, 30]], "outside the image of 260 x 240"),
        ("corners", "numbers"),
        (np.random.default_rng(0).uniform(9, 200, (60, 2)), "form no board"),
    ],
)
def test_what_cannot_be_numbered_is_said(device, xy, said):
    with pytest.raises(cmp_cl.GridError, match=said):
        cmp_cl.number(xy, VIEW.image, device=device)
