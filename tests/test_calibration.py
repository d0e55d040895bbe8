"""One, two or more cameras, calibrated on views of a board."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from cases import some
from stereo_data import SIZE, camera, gel, grid_of, opencv_pairs, project, toed_in_rig, views_of

from cmp_cl import CalibrationError, calibrate
from cmp_cl.points import sides
from cmp_cl.space import Lens
from cmp_cl.space.calibration.advice import advice

THREE = {
    "a": camera(Lens.PINHOLE),
    "b": camera(Lens.PINHOLE, (0.01, 0.15, -0.02), (-50, 2, 5)),
    "c": camera(Lens.PINHOLE, (-0.1, -0.2, 0.05), (60, -3, 8)),
}


def flat_board(rows=6, columns=9):
    row, column = np.mgrid[:rows, :columns]
    return np.stack([column - columns // 2, row - rows // 2, 0 * row], axis=-1) * 20.0


def seen_by(camera, points):
    """Return the projections (..., 2) of points (..., 3), px, by OpenCV."""
    project = cv2.fisheye.projectPoints if camera.lens is Lens.FISHEYE else cv2.projectPoints
    pose = cv2.Rodrigues(camera.R)[0], np.asarray(camera.T, np.float64)
    xy, _ = project(points.reshape(-1, 1, 3), *pose, camera.matrix, camera.distortion)
    return xy.reshape(*points.shape[:-1], 2)


def views(cameras, count=12, board=None, noise=0.03, tilt=0.5, seed=900001):
    """Return grids of a board of 20 mm squares in random poses, without nodes outside."""
    rng = np.random.default_rng(seed)
    board = flat_board() if board is None else board
    seen = {name: [] for name in cameras}
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0]
        place = board @ rotation.T + [*rng.uniform(-60, 60, 2), rng.uniform(190, 330)]
        for name, each in cameras.items():
            xy = seen_by(each, place) + rng.normal(0, noise, (*board.shape[:2], 2))
            outside = (xy < 0).any(axis=-1) | (xy > np.array(SIZE) - 1).any(axis=-1)
            xy[outside] = np.nan
            seen[name].append(grid_of(xy, noise))
    return seen


def calibrated(seen, size=SIZE, **settings):
    return calibrate(seen, spacing=20, sizes=dict.fromkeys(seen, size), **settings)


def rig_views(
    count=12, noise=0.05, seed=3, tilt=0.5, shared=False, printed=0.0, bend=0.0, shape=(7, 10)
):
    """Return views of a board of 3 mm squares in the two cameras of the toed-in rig.

    shared: neighbours have nearly the same noise. printed: by how much its corners are off, mm, but
        for the size of the squares. bend: of the board, 1/mm.
    """
    rng = np.random.default_rng(seed)
    board = flat_board(*shape) * 3 / 20
    off = np.random.default_rng(seed).normal(0, printed, board.shape) * [1, 1, 0]
    board += off - board * (off * board).sum() / np.square(board).sum()
    board[..., 2] += bend * (np.square(board[..., 0]) - board[..., 0] * board[..., 1])
    seen = {"left": [], "right": []}
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-tilt, tilt, 3))[0]
        place = board @ rotation.T + [*rng.uniform(-3, 3, 2), 50 + rng.uniform(-6, 6)]
        pair = views_of(toed_in_rig(), place, rng, noise, shared=shared)
        for name, grid in zip(seen, pair, strict=True):
            seen[name].append(grid)
    return seen


def rig_of(seen, spacing=3.0, **settings):
    sizes = dict.fromkeys(seen, (1000, 1300))
    return calibrate(seen, spacing=spacing, sizes=sizes, **settings)


@pytest.mark.parametrize("lens", list(Lens))
def test_a_camera_of_each_lens_is_found_again(lens):
    truth = {"front": camera(lens)}
    found = calibrated(views(truth), lens=lens)
    assert found.error == pytest.approx(0.03 * math.sqrt(2), rel=0.1)
    assert repr(found).startswith("<Calibration of front: 0.04")
    rms = np.sqrt(np.nanmean(np.square(np.stack(found.residuals["front"])).sum(axis=-1)))
    assert rms == pytest.approx(found.error, rel=0.02)
    row, column = np.mgrid[-3:4, -3:4]
    rays = np.stack([column * 0.2, row * 0.15, np.ones((7, 7))], axis=-1)
    off = seen_by(found.cameras["front"], rays) - seen_by(truth["front"], rays)
    assert np.abs(off).max() < 1.0
    assert lens is not Lens.PINHOLE or found.cameras["front"].distortion[4] == 0  # k3


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(unit):
    seen = rig_views(count=6)
    one, other = (rig_of(seen, spacing=3 * each) for each in (1, unit))
    np.testing.assert_allclose(other.rig().K1, one.rig().K1, rtol=1e-6)
    np.testing.assert_allclose(other.rig().T, one.rig().T * unit, rtol=1e-5)
    factor = np.ones(22)
    factor[19:] = unit
    deviations = [np.sqrt(np.diag(found.covariance)) for found in (other, one)]
    np.testing.assert_allclose(deviations[0], deviations[1] * factor, rtol=1e-3)


@pytest.mark.parametrize("lens", [Lens.PINHOLE, Lens.FISHEYE])
def test_cameras_are_located_though_some_miss_views(lens):
    truth = {
        name: camera(lens, cv2.Rodrigues(each.R)[0].ravel(), each.T) for name, each in THREE.items()
    }
    seen = views(truth, count=14)
    seen["b"][:4] = [None] * 4
    seen["c"][10:] = [None] * 4
    for names in (("a", "b", "c"), ("a", "b")):
        found = calibrated({name: seen[name] for name in names}, lens=lens)
        for name in names:
            np.testing.assert_allclose(found.cameras[name].T, truth[name].T, atol=0.3)
            np.testing.assert_allclose(found.cameras[name].R, truth[name].R, atol=2e-3)
        assert np.isnan(found.view_errors["b"][:4]).all()
        assert found.error < 0.06


ROLLED = [(roll, shape) for roll in (0, 90, 180, 270) for shape in ((6, 9), (6, 8), (7, 7))]


@pytest.mark.parametrize(("roll", "shape"), some(ROLLED, ROLLED[3:9:2], several=True))
def test_a_camera_may_be_rolled_and_each_view_numbered_from_any_corner(roll, shape):
    """Where the colours do not tell the turns of a board apart, only the true ones fit together."""
    tilted = cv2.Rodrigues(np.array([0, 0, np.radians(roll)]))[0] @ THREE["b"].R
    truth = {
        "a": THREE["a"],
        "b": camera(Lens.PINHOLE, cv2.Rodrigues(tilted)[0].ravel(), (-50, 2, 5)),
    }
    seen = views(truth, board=flat_board(*shape))
    rng = np.random.default_rng(roll)
    for grids in seen.values():
        grids[:] = [grid.turned(int(rng.choice([0, 2]))) for grid in grids]
    found = calibrated(seen)
    np.testing.assert_allclose(found.cameras["b"].R, tilted, atol=2e-3)
    np.testing.assert_allclose(found.cameras["b"].T, (-50, 2, 5), atol=0.3)


def test_copies_of_a_view_and_a_board_that_stands_still_count_once():
    seen = views({"a": THREE["a"]}, noise=0.4, count=10)["a"]
    still = views({"a": THREE["a"]}, noise=0.4, count=1)["a"][0]
    rng = np.random.default_rng(1)
    copies = [grid_of(still.xy + rng.normal(0, 0.4, still.xy.shape)) for _ in range(50)]
    for alone in ([seen[0]] * 200, copies, [*copies, seen[1]]):
        with pytest.raises(CalibrationError, match=r"a: 3 different views .* more show the same"):
            calibrated({"a": alone})
    once, often = (
        calibrated({"a": each}) for each in (seen, [*seen, *seen[:3] * 20, seen[0].turned(2)])
    )
    np.testing.assert_array_equal(often.cameras["a"].matrix, once.cameras["a"].matrix)
    assert often.focal_sigma == once.focal_sigma
    assert [group[0] for group in often.alike] == [0, 1, 2]
    assert len(often.alike[0]) == 22


def test_every_good_set_of_fisheye_views_is_solved():
    """An equidistant lens of 336 px; the views are tilted by up to 65 degrees."""
    board = np.stack([*np.meshgrid(np.arange(6) * 26.0, np.arange(9) * 26.0), np.zeros((9, 6))], 2)
    off = []
    for seed in range(6):
        rng, seen = np.random.default_rng(seed), []
        while len(seen) < 15:
            xy = fisheye_view(board, rng)
            if (xy > 3).all() and (xy < (636, 476)).all() and np.ptp(xy, axis=(0, 1)).min() > 40:
                seen.append(grid_of(xy + rng.normal(0, 0.05, xy.shape)))
        found = calibrate({"c": seen}, spacing=26, sizes={"c": SIZE}, lens=Lens.FISHEYE)
        off.append((found.cameras["c"].matrix[0, 0] - 336) / found.focal_sigma["c"])
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.5


def fisheye_view(board, rng):
    azimuth, angle = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, 65))
    turn = cv2.Rodrigues(np.array([np.cos(azimuth), np.sin(azimuth), 0]) * angle)[0]
    turn = turn @ cv2.Rodrigues(np.array([0, 0, rng.uniform(-np.pi, np.pi)]))[0]
    ray = np.append(rng.uniform(-0.8, 0.8, 2), 1.0)
    place = board @ turn.T + rng.uniform(200, 500) * ray / np.linalg.norm(ray)
    place -= turn @ board.mean(axis=(0, 1))
    reach = np.hypot(place[..., 0], place[..., 1])
    angle = np.arctan2(reach, place[..., 2])
    return place[..., :2] * (336 * angle / np.maximum(reach, 1e-9))[..., None] + (319.5, 239.5)


def test_swapped_views_are_refused_and_named():
    seen = views({name: THREE[name] for name in "ab"})
    right = list(seen["b"])
    seen["b"][2], seen["b"][7] = right[7], right[2]
    with pytest.raises(CalibrationError, match="worst fit views 2, 7, from 0"):
        calibrated(seen)
    seen["b"] = [*right[1:], right[0]]  # no view fits
    with pytest.raises(CalibrationError, match="no pose between the cameras fits"):
        calibrated(seen)


@pytest.mark.parametrize("tilt", [0.0005, 0.01])
def test_views_all_from_the_front_are_refused(tilt):
    for seed in range(4):
        seen = rig_views(count=6, tilt=tilt, seed=seed)
        with pytest.raises(CalibrationError, match=r"left: the views .*tilted") as refusal:
            rig_of({"left": seen["left"]})
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("size", [(480, 640), (640, 240)])
def test_a_size_in_which_corners_do_not_fit_is_refused(size):
    said = "a: corners .* beyond images of {} x {} px; a size is".format(*size)
    with pytest.raises(CalibrationError, match=said):
        calibrated(views({"a": THREE["a"]}), size=size)


def test_views_that_determine_nothing_are_refused():
    seen = views(THREE)
    empty = grid_of(np.full((6, 9, 2), np.nan))
    with pytest.raises(CalibrationError, match=r"a: 3 different views .* better 10, not 2$"):
        calibrated({"a": [*seen["a"][:2], empty]})
    apart = {"a": [*seen["a"][:6], *[None] * 6], "b": [*[None] * 6, *seen["b"][6:]]}
    with pytest.raises(CalibrationError, match="b: no moment"):
        calibrated(apart)
    other = [grid_of(grid.xy[:, ::-1]) for grid in views({"b": THREE["b"]})["b"]]
    with pytest.raises(CalibrationError, match=r"none is mirrored|no pose between"):
        calibrated({"a": seen["a"], "b": other})
    plain = dataclasses.replace(THREE["a"], distortion=np.zeros(5))
    with pytest.raises(CalibrationError, match=r"tilted.*; or choose the lens pinhole"):
        calibrated(views({"a": plain}, noise=0), lens=Lens.RATIONAL)


def test_the_sigma_of_the_focal_length_is_that_of_its_error_where_neighbours_share_noise():
    deviations = []
    for seed in range(20):
        found = rig_of({"left": rig_views(count=6, seed=seed, tilt=0.3, shared=True)["left"]})
        off = found.cameras["left"].matrix[0, 0] - toed_in_rig().K1[0, 0]
        deviations.append(off / found.focal_sigma["left"])
    # From 20 calibrations, the ratio has a standard error of 16 %.
    assert 0.6 < np.sqrt(np.mean(np.square(deviations))) < 1.5


@pytest.mark.parametrize("printed", [0.0, 0.01])
def test_the_covariance_of_a_rig_is_that_of_its_errors(printed):
    """Points from exact views through rigs that were calibrated on noisy ones, or on views of a
    board whose print is off."""
    rig, truth = toed_in_rig(), gel(5, 5)
    exact = [grid_of(view, 0.05) for view in project(rig, truth)]
    ratios = []
    for seed in range(8):
        found = rig_of(rig_views(count=8, seed=seed, printed=printed)).rig()
        xyz = found.triangulate(*exact).xyz.reshape(-1, 3)
        by_point, by_rig = found.slopes(xyz)
        by_rig = np.linalg.pinv(by_point) @ by_rig
        values, axes = np.linalg.eigh(by_rig @ found.covariance @ by_rig.transpose(0, 2, 1))
        off = np.einsum("nij,ni->nj", axes, xyz - truth.reshape(-1, 3))
        ratios.append((off / np.sqrt(values))[:, 2])
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5


def test_a_bent_board_does_not_bend_the_rig():
    """It is as far from flat as thin cardboard, 0.2 mm of 27."""
    scores = []
    for seed in range(6):
        found = rig_of(rig_views(count=10, seed=seed, bend=0.001))
        rig, truth = found.rig(), toed_in_rig()
        off = np.array([rig.K1[0, 0] - truth.K1[0, 0], *(rig.T - truth.T)])
        scores.append(off / np.sqrt(np.diag(rig.covariance)[[0, 19, 20, 21]]))
        board = flat_board(7, 10) * 3 / 20
        height = 0.001 * (board[..., 0] ** 2 - board[..., 0] * board[..., 1]).ravel()
        plane = np.column_stack([board.reshape(-1, 3)[:, :2], np.ones(len(height))])
        height -= plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
        assert found.flatness == pytest.approx(np.ptp(height), rel=0.1)
    # From 24 numbers, the ratio has a standard error of 15 %.
    assert 0.6 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_few_views_or_rows_or_square_boards_do_not_tell_whether_a_board_is_flat():
    assert math.isnan(rig_of(rig_views(count=9)).flatness)
    two_rows = calibrated(views({"a": THREE["a"]}, board=flat_board(2, 9)))
    assert math.isnan(two_rows.flatness)
    turned = {
        name: [grid.turned(moment % 4) for moment, grid in enumerate(grids)]
        for name, grids in rig_views(bend=0.001, shape=(8, 8)).items()
    }
    assert math.isnan(rig_of(turned).flatness)


def test_opencvs_pairs_measure_a_board_in_a_view_that_calibration_did_not_see():
    seen = opencv_pairs()
    for out in (0, 3):
        others = {side: [*grids[:out], None, *grids[out + 1 :]] for side, grids in seen.items()}
        found = calibrate(others, spacing=25, sizes=dict.fromkeys(seen, SIZE))
        points = found.rig().triangulate(seen["left"][out], seen["right"][out])
        assert found.error < 0.2
        assert points.valid.all()
        assert sides(points.xyz).mean() == pytest.approx(25, abs=0.08)
        assert sides(points.xyz).std() < 0.16
        assert points.error.mean() < 0.1


# advice


def test_advice_names_what_the_views_lack():
    seen = views({"a": THREE["a"]}, count=5, tilt=0.25)["a"]
    half = [grid.xy.copy() for grid in seen]
    for xy in half:
        xy[xy[..., 0] > 300] = np.nan
    said = advice(calibrated({"a": [*map(grid_of, half), grid_of(half[0])]}))
    assert any("top right" in line and "bottom right of the image" in line for line in said), said
    assert "0 and 5 show the same and count as one view; move and tilt the board" in said
    assert any(line.startswith("5 different views") for line in said)


def test_boards_that_are_all_the_same_way_up_are_to_be_turned():
    seen = views({"a": THREE["a"]})["a"]
    assert any("turn it by quarters" in line for line in advice(calibrated({"a": seen})))
    turned = flat_board()[..., [1, 0, 2]] * [-1, 1, 1]
    seen[3] = views({"a": THREE["a"]}, board=turned)["a"][3]
    assert not any("turn it by quarters" in line for line in advice(calibrated({"a": seen})))


def test_advice_names_a_view_that_fits_worse_than_the_others():
    seen = views({"a": THREE["a"], "b": THREE["b"]})
    assert not any("miss by" in line for line in advice(calibrated(seen)))
    seen["b"][4] = grid_of(seen["b"][4].xy + 2, 0.03)  # the board moved before the other image
    assert [line[:13] for line in advice(calibrated(seen)) if "miss by" in line] == [
        "a: 4 miss by ",
        "b: 4 miss by ",
    ]


def test_advice_tells_a_lens_model_that_turns_back_inside_the_image():
    found = calibrated(views({"a": THREE["a"]}))
    assert not any("turns back" in line for line in advice(found))
    bent = dataclasses.replace(found.cameras["a"], distortion=np.array([-0.6, 0, 0, 0, 0]))
    said = advice(dataclasses.replace(found, cameras={"a": bent}))
    assert any("turns back inside the image, so that" in line for line in said), said
    little = dataclasses.replace(found.cameras["a"], distortion=np.array([-0.165, 0, 0, 0, 0]))
    said = advice(dataclasses.replace(found, cameras={"a": little}))
    assert any("so that 0.2% of it give no ray" in line for line in said), said
