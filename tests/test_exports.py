"""Cameras of several kinds, and corners and cameras as other tools read them."""

import dataclasses

import cv2
import numpy as np
import pytest
import yaml
from stereo_data import DISTORTIONS, MATRIX, SIZE, camera, grid_of, opencv_pairs

from cmp_cl.errors import CalibrationError, ConfigError
from cmp_cl.space import Lens, StereoRig, calibrate
from cmp_cl.space.exports import save_cameras, save_corners

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


def test_corners_that_a_format_cannot_hold_are_refused(tmp_path):
    path = tmp_path / "corners.vnl"
    path.write_text("old")
    with pytest.raises(CalibrationError, match=r"a b\.png"):
        save_corners(path, {"a b.png": corners()["a.png"]})
    with pytest.raises(ConfigError, match="no view"):
        save_corners(path, {"b.png": None})
    with pytest.raises(CalibrationError, match="shapes"):
        save_corners(path, {**corners(), "c.png": grid_of(np.zeros((3, 3, 2)))})
    assert path.read_text() == "old"


# cameras


def test_opencv_and_the_library_read_a_rig_back(tmp_path):
    grids = opencv_pairs()
    found = calibrate(grids, spacing=25, sizes=dict.fromkeys(grids, SIZE))
    save_cameras(tmp_path / "rig.yaml", found.cameras, covariance=found.covariance)
    again = StereoRig.load(tmp_path / "rig.yaml")
    for name in ("K1", "D1", "K2", "D2", "R", "T", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found.rig(), name))
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    assert storage.getNode("name2").string() == "right"
    assert storage.getNode("size1").mat().tolist() == [[640, 480]]
    three = {**found.cameras, "third": camera(Lens.PINHOLE, translation=(-90, 0, 0))}
    save_cameras(tmp_path / "three.yaml", three)
    storage = cv2.FileStorage(str(tmp_path / "three.yaml"), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("R2").mat(), found.rig().R)
    assert storage.getNode("T3").mat().ravel().tolist() == [-90, 0, 0]
    assert storage.getNode("R1").empty()


def test_a_file_of_one_camera_or_of_fisheyes_is_no_rig(tmp_path):
    save_cameras(tmp_path / "one.yaml", {"a": camera(Lens.PINHOLE)})
    with pytest.raises(CalibrationError, match="a rig has two cameras"):
        StereoRig.load(tmp_path / "one.yaml")
    two = {"a": camera(Lens.FISHEYE), "b": camera(Lens.FISHEYE, (0, 0.1, 0), (-50, 0, 0))}
    save_cameras(tmp_path / "fish.yaml", two)
    with pytest.raises(CalibrationError, match="a fisheye"):
        StereoRig.load(tmp_path / "fish.yaml")


def test_a_camera_has_the_coefficients_of_its_lens():
    """Else four of a pinhole would be taken for those of a fisheye."""
    with pytest.raises(CalibrationError, match=r"pinhole lens has 5 coefficients .* not 4"):
        dataclasses.replace(camera(Lens.PINHOLE), distortion=DISTORTIONS[Lens.PINHOLE][:4])


@pytest.mark.parametrize(
    ("lens", "model"),
    [
        (Lens.PINHOLE, "plumb_bob"),
        (Lens.RATIONAL, "rational_polynomial"),
        (Lens.FISHEYE, "equidistant"),
    ],
)
def test_a_file_for_ros_holds_each_camera(tmp_path, lens, model):
    larger = np.diag([4 / 3, 1.1, 1]) @ MATRIX
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
        info = yaml.safe_load(file.read_text())
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
    found = yaml.safe_load((tmp_path / "rig.camchain.yaml").read_text())
    assert found["cam0"]["intrinsics"] == [420, 418, 325, 236]
    assert found["cam1"]["distortion_model"] == "equidistant"
    step = np.array(found["cam2"]["T_cn_cnm1"])
    np.testing.assert_allclose(step[:3, 3], [-0.04, 0, 0], atol=1e-12)
    np.testing.assert_allclose(step[:3, :3], np.eye(3), atol=1e-12)
    with_k3 = dataclasses.replace(chain["a"], distortion=np.array([0.1, 0, 0, 0, 1e-3]))
    for other in (camera(Lens.RATIONAL), with_k3):
        with pytest.raises(CalibrationError, match="a: Kalibr"):
            save_cameras(tmp_path / "rig.camchain.yaml", {"a": other})
