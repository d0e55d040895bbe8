"""Two views: positions in space are right, and nodes without one are flagged."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from stereo_data import gel, grid_of, project, toed_in_rig

from cmp_cl.errors import CalibrationError, ConfigError, FieldError, ImageError
from cmp_cl.grid import NodeStatus
from cmp_cl.space import BinocularSplit, PointStatus, StereoRig, Window

BEHIND_A_WINDOW = dataclasses.replace(
    toed_in_rig(), window=Window((0.02, -0.03, 1.0), 20.0, ((5.0, 1.49),), 1.41)
)
K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def parallel_rig(distortion=()):
    return StereoRig(K, distortion, K, distortion, np.eye(3), [-10.0, 0, 0])


def noisy(xy, sigma, rng):
    return grid_of(xy + rng.normal(0, sigma, xy.shape), sigma)


def test_exact_views_give_the_exact_points():
    """Behind strong lenses too: their distortion is undone to a thousandth of a pixel."""
    strong = parallel_rig(distortion=[-0.36, 0.18, 0.001, 0.001, 0.05])
    few = parallel_rig(distortion=[-0.1, 0.02, 0.001, 0.001])
    wide = gel() * (1.7, 1.7, 1)
    for rig, truth in (
        (toed_in_rig(), gel()),
        (BEHIND_A_WINDOW, gel()),
        (strong, wide),
        (few, gel()),
    ):
        left, right = project(rig, truth)
        points = rig.triangulate(grid_of(left), grid_of(right))
        assert points.valid.all()
        assert points.unit == "mm"
        np.testing.assert_allclose(points.xyz, truth, atol=4e-5)  # float32 pixels
        assert points.error.max() < 1e-4
        assert np.isnan(points.sigma).all()


@pytest.mark.parametrize("rig", [toed_in_rig(), BEHIND_A_WINDOW], ids=["air", "window"])
@pytest.mark.parametrize(("sigma_left", "sigma_right"), [(0.05, 0.05), (0.02, 0.2), (0.3, 0.05)])
def test_the_covariance_is_that_of_the_errors(rig, sigma_left, sigma_right):
    truth = gel(40, 40)
    left, right = project(rig, truth)
    rng = np.random.default_rng(1)
    points = rig.triangulate(noisy(left, sigma_left, rng), noisy(right, sigma_right, rng))
    miss = (points.xyz - truth).reshape(-1, 3)
    covariance = points.covariance.reshape(-1, 3, 3)
    chi2 = np.einsum("ni,nij,nj->n", miss, np.linalg.inv(covariance), miss)
    assert chi2.mean() == pytest.approx(3, rel=0.08)  # 4 standard errors of 1600 nodes
    rmse = math.sqrt(np.square(miss).sum(axis=1).mean())
    assert rmse == pytest.approx(math.sqrt(np.trace(covariance.mean(axis=0))), rel=0.05)
    if sigma_left == sigma_right:  # one of four numbers of a node is left over
        left_over = math.sqrt(2 * np.square(points.error).mean())
        assert left_over == pytest.approx(sigma_left, rel=0.1)
    largest = np.linalg.eigvalsh(covariance)[:, 2]
    np.testing.assert_allclose(points.sigma.ravel(), np.sqrt(largest))


def test_a_node_that_one_side_lacks_is_missing():
    rig = toed_in_rig()
    left, right = project(rig, gel())
    left[3, 4] = right[5, 6] = np.nan
    one, two = grid_of(left), grid_of(right)
    two.status[0, 0] = one.status[1, 1] = NodeStatus.ATTACHED
    points = rig.triangulate(one, two)
    assert points.source[[0, 1, 2], [0, 1, 2]].tolist() == [*[NodeStatus.ATTACHED] * 2, 1]
    assert set(zip(*np.nonzero(~points.valid), strict=True)) == {(3, 4), (5, 6)}
    for node in ((3, 4), (5, 6)):
        assert points.status[node] == PointStatus.MISSING
        assert points.source[node] == NodeStatus.MISSING
        assert np.isnan(points.xyz[node]).all()
        assert np.isnan(points.error[node])
    nothing = grid_of(np.full_like(left, np.nan))
    assert not rig.triangulate(nothing, grid_of(right)).valid.any()


def one_node(rig, left, right):
    return rig.triangulate(grid_of([[left]], 0.1), grid_of([[right]], 0.1))


@pytest.mark.parametrize(
    ("left", "right", "status"),
    [
        ((330, 250), (310, 250), PointStatus.VALID),
        ((330, 250), (330, 250), PointStatus.PARALLEL),
        ((330, 250), (350, 250), PointStatus.BEHIND),
        ((330, 250), (310, 262), PointStatus.INCONSISTENT),
    ],
)
def test_nodes_without_depth_are_flagged(left, right, status):
    points = one_node(parallel_rig(), left, right)
    assert points.status[0, 0] == status
    for values in (points.xyz, points.covariance, points.sigma):
        assert np.isnan(values).all() == (status != PointStatus.VALID)


def test_a_point_behind_the_right_camera_alone_is_flagged():
    ahead = StereoRig(K, [], K, [], np.eye(3), [-10.0, 0, -50])
    left, right = ahead.project(np.array([[2.0, 1.0, 40.0]]))
    assert [len(each) for each in ahead.project(np.empty((0, 3)))] == [0, 0]
    assert one_node(ahead, left[0], right[0]).status[0, 0] == PointStatus.BEHIND


def test_a_pixel_beyond_the_lens_model_is_flagged():
    both = parallel_rig(distortion=[-0.36, 0, 0, 0])
    for rig in (both, dataclasses.replace(both, D1=[]), dataclasses.replace(both, D2=[])):
        points = one_node(rig, (320 + 600, 240), (320 + 560, 240))
        assert points.status[0, 0] == PointStatus.INCONSISTENT
        assert np.isnan(points.xyz).all()


def test_grids_of_different_rows_or_columns_are_refused():
    wide, tall = grid_of(np.ones((2, 3, 2))), grid_of(np.ones((3, 2, 2)))
    with pytest.raises(FieldError, match="rows 0 to 1 and columns 0 to 2, the right one rows 0 to"):
        toed_in_rig().triangulate(wide, tall)
    beside = dataclasses.replace(wide, origin=(0, -1))
    with pytest.raises(FieldError, match=r"columns -1 to 1; cut both .* with Grid.cut_to"):
        toed_in_rig().triangulate(wide, beside)


def write_matrices(path, **matrices):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, matrix in matrices.items():
        storage.write(name, np.asarray(matrix))
    storage.release()


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_the_keys_of_opencvs_stereo_calib_are_read(tmp_path, suffix):
    rig, path = toed_in_rig(), tmp_path / f"rig.{suffix}"
    cameras = {"M1": rig.K1, "D1": rig.D1[None], "M2": rig.K2, "D2": rig.D2[None]}
    write_matrices(path, **cameras, R=rig.R, T=rig.T[:, None], R1=np.eye(3), P1=np.eye(3, 4))
    with pytest.warns(UserWarning, match="no unit"):
        again = StereoRig.load(path)
    np.testing.assert_array_equal(again.K2, rig.K2)
    np.testing.assert_array_equal(again.T, rig.T)
    assert again.unit == "mm"
    write_matrices(path, **cameras)
    with pytest.raises(CalibrationError, match="no R; no T"):
        StereoRig.load(path)


GOOD = {"K1": K, "D1": [], "K2": K, "D2": [], "R": np.eye(3), "T": [-1, 0, 0]}


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("T", [0, 0, 0], "T is zero"),
        ("T", [math.nan, 0, 1], "finite"),
        ("covariance", np.diag(np.linspace(-1, 1, 22)), "variances"),
        ("covariance", np.full((22, 22), np.nan), "finite"),
        ("R", 2 * np.eye(3), "rotation"),
        ("K1", np.zeros((3, 3)), "focal"),
        ("K1", "none", "numbers"),
        ("D2", [0.1, 0.2, 0.3], "coefficients"),
        ("unit", "milli metre", "unit"),
    ],
)
def test_an_impossible_rig_is_refused(name, value, words):
    with pytest.raises(CalibrationError, match=words):
        StereoRig(**{**GOOD, name: value})


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("unit: mm", 'unit: ""', "unit must be a word such as mm"),
        ("unit: mm", "unit: mm\nunit: m", "unit is given twice"),
        ("window_index", "window_distance: 2\nwindow_index", "window_distance is given twice"),
        ("cols: 5\n   dt: d", "cols: 5\n   dt: i", "D1 must have dt: d or f, not 'i'"),
        ("cols: 3", "cmls: 3", "K1 must be a small matrix"),
        ("rows: 3\n   cols: 3", "rows: -3\n   cols: -3", "K1 must be a small matrix, not -3 x -3"),
        ("rows: 3\n   cols: 3", "sizes: [ 3, x ]", "K1 must be a small matrix"),
        ("rows: 3\n   cols: 3", "sizes: [ ]", "K1 must be a small matrix"),
        ("1260.", "x", "K1 has an entry that is no number"),
        ("1260.", "1e308", "K1 must be finite and at most"),
        ("-0.12", ".inf", "D1 must be finite"),
        ("window_distance", "window_off", "a window needs window_normal"),
        ("window_index: 1.4", "window_index: 0.4", "a medium of the window .* index 0.41"),
        ("", "K1: " + 100_000 * "[", "over 4000 lists"),
        ("", "K1: " + 100_000 * "{a:", "over 4000 lists"),
        ("", "K1: " + 100_000 * "a: ", "over 4000 lists"),
        ("", "K1: " + 100_000 * "- ", "over 4000 lists"),
    ],
    ids=lambda value: value[:30],
)
def test_a_rig_file_with_a_wrong_entry_is_refused_in_one_line(tmp_path, old, new, words):
    path = tmp_path / "rig.yaml"
    dataclasses.replace(toed_in_rig(), window=Window((0, 0, 1), 20.0, (), 1.41)).save(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1) if old else f"%YAML:1.0\n---\n{new}")
    with pytest.raises(CalibrationError, match=rf"rig\.yaml: {words}") as refusal:
        StereoRig.load(path)
    assert "\n" not in str(refusal.value)


def test_vectors_are_read_as_opencv_5_writes_them(tmp_path):
    rig = toed_in_rig()
    rig.save(tmp_path / "rig.yaml")
    text = (tmp_path / "rig.yaml").read_text()
    for old, size in (("rows: 1\n   cols: 5", 5), ("rows: 1\n   cols: 3", 3)):
        assert f"!!opencv-matrix\n   {old}" in text
        new = f"!!opencv-nd-matrix\n   sizes: [ {size} ]"
        text = text.replace(f"!!opencv-matrix\n   {old}", new)
    (tmp_path / "rig.yaml").write_text(text)
    again = StereoRig.load(tmp_path / "rig.yaml")
    for name in ("D1", "D2", "T", "K1"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rig, name))


def test_a_rig_is_printed_in_a_few_lines():
    rig = dataclasses.replace(toed_in_rig(), covariance=np.eye(22))
    assert repr(rig).count("\n") < 12


def test_a_frame_is_split_into_views_of_itself():
    frame = np.arange(60, dtype=np.uint8).reshape(6, 10)
    left, right = BinocularSplit.halves(10, 6)(frame)
    assert np.shares_memory(left, frame)
    np.testing.assert_array_equal(np.hstack([left, right]), frame)
    split = BinocularSplit((0, 1, 3, 5), (5, 0, 3, 5), mirror_right=True)
    left, right = split(frame)
    np.testing.assert_array_equal(left, frame[1:6, 0:3])
    np.testing.assert_array_equal(right, frame[0:5, 7:4:-1])
    assert right.flags.c_contiguous


def test_a_split_that_leaves_the_frame_is_refused():
    with pytest.raises(ImageError, match="extends past the frame of 9 x 6"):
        BinocularSplit.halves(10, 6)(np.zeros((6, 9), np.uint8))
    box = tuple(np.array([0, 1, 3, 5]))  # NumPy's integers
    assert BinocularSplit(box, (5, 0, 3, 5)).left == (0, 1, 3, 5)
    with pytest.raises(ConfigError, match="one size, not 4 x 5 and 3 x 5 px"):
        BinocularSplit((0, 1, 4, 5), (5, 0, 3, 5))
