"""Cameras of several kinds, and corners and cameras as other tools read them."""

import dataclasses
import math
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_data import grid_of, photographs, toed_in_rig, truth_grid

from cmp_cl.errors import CalibrationError, ConfigError
from cmp_cl.space import StereoRig
from cmp_cl.space.cameras import Camera, Lens, calibrate_cameras
from cmp_cl.space.exports import cameras_of, save_cameras, save_corners
from cmp_cl.space.joint import MisfitError

SIZE = (640, 480)
MATRIX = np.array([[420.0, 0, 325], [0, 418.0, 236], [0, 0, 1]])
DISTORTIONS = {
    Lens.PINHOLE: np.array([-0.1, 0.03, 0.001, -0.0005, 0]),
    Lens.RATIONAL: np.array([0.3, 0.05, 0.0005, -0.0005, 0.01, 0.42, 0.08, 0.02]),
    Lens.FISHEYE: np.array([0.05, -0.01, 0.004, -0.001]),
}


def camera(lens, rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)):
    return Camera(
        lens=lens,
        size=SIZE,
        matrix=MATRIX,
        distortion=DISTORTIONS[lens],
        R=cv2.Rodrigues(np.array(rotation))[0],
        T=np.array(translation),
        unit="mm",
    )


def views(cameras, count=12):
    """Return grids of a 7 x 9 board of 20 mm squares in random poses, without nodes outside."""
    rng = np.random.default_rng(900001)
    row, column = np.mgrid[:7, :9]
    board = np.stack([column, row, 0 * row], axis=-1) * 20.0 - [80, 60, 0]
    seen = {name: [] for name in cameras}
    for _ in range(count):
        rotation = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        place = board @ rotation.T + [*rng.uniform(-60, 60, 2), rng.uniform(190, 330)]
        for name, each in cameras.items():
            xy = each.project(place) + rng.normal(0, 0.03, (7, 9, 2))
            outside = (xy < 0).any(axis=-1) | (xy > np.array(SIZE) - 1).any(axis=-1)
            xy[outside] = np.nan
            seen[name].append(grid_of(xy, 0.03))
    return seen


@pytest.mark.parametrize("lens", list(Lens))
def test_a_camera_of_each_lens_is_found_again(lens):
    truth = {"front": camera(lens)}
    found = calibrate_cameras(views(truth), spacing=20, sizes={"front": SIZE}, lens=lens)
    assert found.error == pytest.approx(0.03 * math.sqrt(2), rel=0.1)
    assert 0.6 < found.coverage["front"] <= 1
    rms = np.sqrt(np.nanmean(np.square(np.stack(found.residuals["front"])).sum(axis=-1)))
    assert rms == pytest.approx(found.error)
    row, column = np.mgrid[-3:4, -3:4]
    rays = np.stack([column * 0.2, row * 0.15, np.ones((7, 7))], axis=-1)
    off = found.cameras["front"].project(rays) - truth["front"].project(rays)
    assert np.abs(off).max() < 1.0


def test_three_cameras_are_located_though_two_of_them_miss_views():
    truth = {
        "a": camera(Lens.PINHOLE),
        "b": camera(Lens.PINHOLE, (0.01, 0.15, -0.02), (-50, 2, 5)),
        "c": camera(Lens.PINHOLE, (-0.1, -0.2, 0.05), (60, -3, 8)),
    }
    grids = views(truth, count=14)
    grids["b"][:4] = [None] * 4
    grids["c"][10:] = [None] * 4
    found = calibrate_cameras(grids, spacing=20, sizes=dict.fromkeys(truth, SIZE))
    for name, expected in truth.items():
        np.testing.assert_allclose(found.cameras[name].T, expected.T, atol=0.3)
        np.testing.assert_allclose(found.cameras[name].R, expected.R, atol=2e-3)
    assert np.isnan(found.view_errors["b"][:4]).all()
    assert found.error < 0.06
    two = {name: grids[name] for name in ("a", "b")}
    rig = calibrate_cameras(two, spacing=20, sizes=dict.fromkeys(two, SIZE)).rig()
    assert np.linalg.norm(rig.T) == pytest.approx(np.linalg.norm(truth["b"].T), rel=0.01)


def test_swapped_views_of_one_of_three_cameras_are_refused_and_named():
    seen = views(
        {
            "a": camera(Lens.PINHOLE),
            "b": camera(Lens.PINHOLE, (0.01, 0.15, -0.02), (-50, 2, 5)),
            "c": camera(Lens.PINHOLE, (-0.1, -0.2, 0.05), (60, -3, 8)),
        }
    )
    sizes, right = dict.fromkeys(seen, SIZE), list(seen["b"])
    seen["b"][2], seen["b"][7] = right[7], right[2]
    with pytest.raises(MisfitError, match="without view 2 of b and view 7 of b the others") as why:
        calibrate_cameras(seen, spacing=20, sizes=sizes)
    assert why.value.odd == {2: ["b"], 7: ["b"]}
    seen["b"] = [*right[1:], right[0]]  # no view fits: none is named
    with pytest.raises(MisfitError, match="no pose between the cameras fits") as why:
        calibrate_cameras(seen, spacing=20, sizes=sizes)
    assert not why.value.odd
    seen["b"][:9], seen["b"][9:] = [None] * 9, right[9:]
    seen["b"][10], seen["b"][11] = right[11], right[10]  # too few are left to tell
    with pytest.raises(MisfitError) as why:
        calibrate_cameras(seen, spacing=20, sizes=sizes)
    assert not why.value.odd


@pytest.mark.parametrize("lens", list(Lens))
def test_views_that_are_as_bad_for_each_camera_alone_are_not_refused(lens):
    rng = np.random.default_rng(900002)
    cameras = {"a": camera(lens), "b": camera(lens, translation=(-20.0, 0, 0))}
    seen = {
        name: [grid_of(grid.xy + rng.normal(0, 1, grid.xy.shape)) for grid in grids]
        for name, grids in views(cameras).items()
    }
    found = calibrate_cameras(seen, spacing=20, sizes=dict.fromkeys(seen, SIZE), lens=lens)
    assert 1.2 < found.error < 1.5


def test_views_that_do_not_determine_a_camera_are_refused():
    row, column = np.mgrid[:7, :9]
    flat = [grid_of(np.stack([column, row], axis=-1) * 30.0 + 20 * n) for n in range(4)]
    with pytest.raises(CalibrationError, match=r"front: .*(focal|determine)") as refusal:
        calibrate_cameras({"front": flat}, spacing=20, sizes={"front": SIZE})
    assert "\n" not in str(refusal.value)
    with pytest.raises(CalibrationError, match=r"3 views .* are needed, not 2"):
        calibrate_cameras({"front": flat[:2]}, spacing=20, sizes={"front": SIZE})
    seen = views({"a": camera(Lens.PINHOLE), "b": camera(Lens.PINHOLE, translation=(-20.0, 0, 0))})
    apart = {"a": [*seen["a"][:6], *[None] * 6], "b": [*[None] * 6, *seen["b"][6:]]}
    with pytest.raises(CalibrationError, match="b: no moment"):
        calibrate_cameras(apart, spacing=20, sizes=dict.fromkeys(apart, SIZE))


def test_a_grid_gives_opencv_its_points():
    xy = np.stack(np.meshgrid([10.0, 20.0, 30.0], [5.0, 6.0]), axis=-1)
    xy[0, 1] = np.nan
    nodes, points = grid_of(xy).to_opencv(2.5)
    assert nodes.shape == (5, 1, 3)
    assert points.dtype == np.float32
    assert nodes[1, 0].tolist() == [5, 0, 0]
    assert points[1, 0].tolist() == [30, 5]
    with pytest.raises(ConfigError, match="spacing"):
        grid_of(xy).to_opencv(0)


# corners


def corners():
    xy = np.stack(np.meshgrid(np.arange(3.0), np.arange(2.0)), axis=-1) * 10 + 5
    xy[1, 2] = np.nan
    one = grid_of(xy, 0.02)
    one.sigma[0, 0] = 0.08
    return {"a.png": one, "b.png": None}


def test_a_vnl_holds_missing_nodes_and_weights(tmp_path):
    save_corners(tmp_path / "corners.vnl", corners())
    lines = (tmp_path / "corners.vnl").read_text().splitlines()
    assert lines[0] == "# filename x y level"
    assert lines[1] == "a.png 5.000000 5.000000 2"  # its sigma is 4 times as large
    assert lines[2] == "a.png 15.000000 5.000000 0"
    assert lines[6] == "a.png - - -"
    assert lines[7] == "b.png - - -"
    assert len(lines) == 8


@pytest.mark.parametrize("suffix", [".yaml", ".yml"])
def test_opencv_reads_the_corners(tmp_path, suffix):
    path = tmp_path / f"corners{suffix}"
    save_corners(path, corners(), spacing=2.5)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert storage.getNode("spacing").real() == 2.5
    assert storage.getNode("columns").real() == 3
    view = storage.getNode("views").at(0)
    assert view.getNode("name").string() == "a.png"
    nodes, points = corners()["a.png"].to_opencv(2.5)
    np.testing.assert_array_equal(view.getNode("object_points").mat(), nodes[:, 0])
    np.testing.assert_array_equal(view.getNode("image_points").mat(), points[:, 0])


def test_corners_that_a_format_cannot_hold_are_refused(tmp_path):
    path = tmp_path / "corners.vnl"
    path.write_text("old")
    with pytest.raises(ConfigError, match=r"\.vnl, \.yaml"):
        save_corners(tmp_path / "corners.mat", corners())
    with pytest.raises(CalibrationError, match=r"a b\.png"):
        save_corners(path, {"a b.png": corners()["a.png"]})
    with pytest.raises(ConfigError, match="no view"):
        save_corners(path, {"b.png": None})
    with pytest.raises(CalibrationError, match="shapes"):
        save_corners(path, {**corners(), "c.png": grid_of(np.zeros((3, 3, 2)))})
    assert path.read_text() == "old"


def test_mrcal_calibrates_the_pairs_of_opencv(tmp_path):
    if shutil.which("mrcal-calibrate-cameras") is None:
        pytest.skip("mrcal is not installed: apt install mrcal")
    folder = photographs("stereo_opencv")
    found = {path.stem: truth_grid(path) for path in sorted(folder.glob("*[0-9].json"))}
    for name in found:
        shutil.copy(folder / f"{name}.jpg", tmp_path)
    shape = next(iter(found.values())).shape
    save_corners(tmp_path / "corners.vnl", {f"{name}.jpg": g for name, g in found.items()})
    done = subprocess.run(
        [
            *("mrcal-calibrate-cameras", "--corners-cache", "corners.vnl"),
            *("--lensmodel", "LENSMODEL_OPENCV4", "--focal", "530", "--object-spacing", "0.025"),
            *("--object-width-n", str(shape[1]), "--object-height-n", str(shape[0])),
            *("--skip-calobject-warp-solve", "left*.jpg", "right*.jpg"),
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr[-600:]
    assert "RMS reprojection error" in done.stdout + done.stderr
    assert len(list(tmp_path.glob("*.cameramodel"))) == 2


# cameras


def test_opencv_and_the_library_read_a_rig_back(tmp_path):
    rig = toed_in_rig()
    save_cameras(tmp_path / "rig.yaml", cameras_of(rig, (800, 1200)))
    again = StereoRig.load(tmp_path / "rig.yaml")
    for name in ("K1", "D1", "K2", "D2", "R", "T"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rig, name))
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("name2").string() == "right"
    assert storage.getNode("size1").mat().tolist() == [[800, 1200]]


def test_a_file_of_one_camera_or_of_fisheyes_is_reported_as_such(tmp_path):
    save_cameras(tmp_path / "one.yaml", {"a": camera(Lens.PINHOLE)})
    with pytest.raises(CalibrationError, match="a rig has two cameras"):
        StereoRig.load(tmp_path / "one.yaml")
    two = {"a": camera(Lens.FISHEYE), "b": camera(Lens.FISHEYE, (0, 0.1, 0), (-50, 0, 0))}
    save_cameras(tmp_path / "fish.yaml", two)
    with pytest.raises(CalibrationError, match="a fisheye"):
        StereoRig.load(tmp_path / "fish.yaml")


def loaded(path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    return yaml.safe_load(Path(path).read_text())


@pytest.mark.parametrize(
    ("lens", "model"),
    [
        (Lens.PINHOLE, "plumb_bob"),
        (Lens.RATIONAL, "rational_polynomial"),
        (Lens.FISHEYE, "equidistant"),
    ],
)
def test_a_file_for_ros_holds_each_camera(tmp_path, lens, model):
    larger = np.diag([1.25, 1.25, 1]) @ MATRIX
    right = camera(lens, translation=(-50.0, 0, 0))
    pair = {
        "left": camera(lens),
        "right": dataclasses.replace(right, size=(800, 600), matrix=larger),
    }
    files = save_cameras(tmp_path / "rig.camera_info.yaml", pair)
    assert [file.name for file in files] == [
        "rig-left.camera_info.yaml",
        "rig-right.camera_info.yaml",
    ]
    for file, (name, each) in zip(files, pair.items(), strict=True):
        info = loaded(file)
        assert info["camera_name"] == name
        assert (info["image_width"], info["image_height"]) == each.size
        assert info["camera_matrix"]["data"] == each.matrix.ravel().tolist()
        assert info["distortion_coefficients"]["data"] == DISTORTIONS[lens].tolist()
        assert info["distortion_model"] == model
        unrectified = np.column_stack([each.matrix, np.zeros(3)])
        projection = {"rows": 3, "cols": 4, "data": unrectified.ravel().tolist()}
        assert info["projection_matrix"] == projection


def test_a_file_for_kalibr_holds_a_chain_in_metres(tmp_path):
    chain = {
        "a": camera(Lens.PINHOLE),
        "b": camera(Lens.FISHEYE, (0, 0.1, 0), (-50, 0, 0)),
        "c": camera(Lens.PINHOLE, (0, 0.1, 0), (-90, 0, 0)),
    }
    save_cameras(tmp_path / "rig.camchain.yaml", chain)
    found = loaded(tmp_path / "rig.camchain.yaml")
    assert found["cam0"]["intrinsics"] == [420, 418, 325, 236]
    assert found["cam1"]["distortion_model"] == "equidistant"
    step = np.array(found["cam2"]["T_cn_cnm1"])
    np.testing.assert_allclose(step[:3, 3], [-0.04, 0, 0], atol=1e-12)
    np.testing.assert_allclose(step[:3, :3], np.eye(3), atol=1e-12)
    with pytest.raises(CalibrationError, match="a: Kalibr"):
        save_cameras(tmp_path / "rig.camchain.yaml", {"a": camera(Lens.RATIONAL)})


def test_a_file_name_of_no_known_format_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"must end in \.yaml"):
        save_cameras(tmp_path / "rig.xml", {"a": camera(Lens.PINHOLE)})
