"""`cmp_cl.number`: corners of any detector get the numbers of the pattern."""

import cv2
import numpy as np
import pytest
from corner_images import to_nearest
from scenes import gel, rendered, turned

import cmp_cl
from cmp_cl import NodeStatus
from cmp_cl.synthetic import Scene
from cmp_cl.synthetic.scoring import agreeing

VIEW = rendered(Scene(markers=12, shape=(240, 260), severity=0.5, seed=900003))


def drawn(view, seed):
    """Return the true corners with noise and others, over 4 px away, in any order, and their
    numbers, -1 of others."""
    draw = np.random.default_rng(seed)
    xy = view.corners[:, :2] + draw.normal(0, 0.3, (len(view.corners), 2))
    more = draw.uniform(3, np.array(view.image.shape[::-1]) - 4, (10, 2))
    more = more[to_nearest(more, view.corners[:, :2]) > 4]
    true = np.concatenate([view.corners[:, 2:], np.full(more.shape, -1)])
    order = draw.permutation(len(true))
    return np.concatenate([xy, more])[order], true[order].astype(int)


def right_and_wrong(grid, xy, true):
    """Count the given corners with their own number, up to a motion of the lattice, and the others
    that have one."""
    some = grid.index[:, 0] >= 0
    np.testing.assert_array_equal(grid.xy[tuple(grid.index[some].T)], xy[some].astype(np.float32))
    own = some & (true[:, 0] >= 0)
    right = np.count_nonzero(agreeing(grid.index[own], true[own]))
    return right, np.count_nonzero(some) - right


@pytest.mark.parametrize("seed", range(6))
def test_corners_among_others_get_their_numbers(device, seed):
    view = gel(20, (240, 320), seed=40 + seed, severity=1.0)
    xy, true = drawn(view, seed)
    right, wrong = right_and_wrong(cmp_cl.number(xy, view.image, device=device), xy, true)
    assert right >= 398
    assert wrong == 0


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_image_has_its_rows_from_the_top(device, quarters):
    view = turned(VIEW, quarters)
    xy, true = drawn(view, quarters)
    grid = cmp_cl.number(xy, view.image, device=device)
    assert right_and_wrong(grid, xy, true) == (144, 0)
    assert grid.shape == (12, 12)
    assert (np.diff(grid.xy[..., 0], axis=1) > 0).all()
    assert (np.diff(grid.xy[..., 1], axis=0) > 0).all()


def test_corners_of_opencv(device):
    image = VIEW.image
    found = cv2.goodFeaturesToTrack(image, 200, 0.02, 8, blockSize=5).reshape(-1, 2)
    grid = cmp_cl.number(found, image, device=device)
    far = np.linalg.norm(grid.xy.reshape(-1, 2) - VIEW.corners[:, :2], axis=1)
    assert grid.shape == (12, 12)
    assert np.count_nonzero(far < 3.5) >= 143
    assert grid.parity == cmp_cl.build_grid(cmp_cl.detect(image), image).parity


@pytest.mark.parametrize("quarters", range(4))
def test_a_missing_corner_is_interpolated_between_two(device, quarters):
    """Beyond corners, or beside another such place, it would be a guess."""
    wanted = np.full((12, 12), NodeStatus.DETECTED)
    wanted[[2, 4, 0], [2, 7, 6]] = NodeStatus.INTERPOLATED
    wanted[[0, 8, 8, 9, 9], [11, 4, 5, 4, 5]] = NodeStatus.MISSING
    kept = wanted.ravel() == NodeStatus.DETECTED
    view = turned(VIEW._replace(corners=VIEW.corners[kept]), quarters)
    image = view.image.astype(np.uint16) * 257
    grid = cmp_cl.number(view.corners[:, :2], image, device=device)
    np.testing.assert_array_equal(grid.status, np.rot90(wanted, quarters))
    np.testing.assert_array_equal(grid.valid, grid.status != NodeStatus.MISSING)
    assert to_nearest(grid.xy[grid.valid], turned(VIEW, quarters).corners[:, :2]).max() < 1.5


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
