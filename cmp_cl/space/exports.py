"""Writes corners and cameras in the formats that other calibration tools read.

Pixel coordinates are OpenCV's, with (0, 0) at the centre of the first pixel.
"""

import json
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, ConfigError
from cmp_cl.files import write_text
from cmp_cl.grid.grid import Grid
from cmp_cl.space.calibration import Camera
from cmp_cl.space.lens import Lens
from cmp_cl.space.storage import last_entries, save_storage
from cmp_cl.space.window import Window

Array = NDArray[np.float64]
Views = Mapping[str, Grid | None]

_ROS_MODELS = {
    Lens.PINHOLE: "plumb_bob",
    Lens.RATIONAL: "rational_polynomial",
    Lens.FISHEYE: "equidistant",
}
_KALIBR_MODELS = {Lens.PINHOLE: "radtan", Lens.FISHEYE: "equidistant"}
# corners


def save_corners(path: str | PathLike[str], views: Views) -> None:
    """Write the corners of a board in many images as mrcal's corners.vnl, whole or not at all.

    views: the grid, by file name of the image; None if the board is not seen. All grids have one
    shape.

    The lines are `# filename x y level`, row by row, with `- - -` for a missing corner and for an
    image without the board. mrcal weights a level of n by 2^-n. The level is
    log2(sigma / smallest sigma of all), rounded, and 0 if sigma is unknown.

    Raises ConfigError without any view, CalibrationError if shapes differ or a name has white
    space, OSError.
    """
    for name in views:
        if not name or any(letter.isspace() for letter in name) or name.startswith("#"):
            raise CalibrationError(f"mrcal's .vnl cannot hold the file name {name!r}")
    grids = [grid for grid in views.values() if grid is not None]
    if not grids:
        raise ConfigError("no view shows the board: there are no corners to write")
    if len({grid.shape for grid in grids}) > 1:
        shapes = sorted({grid.shape for grid in grids})
        raise CalibrationError(f"the views show boards of different shapes: {shapes}")
    known = np.concatenate([grid.sigma[grid.valid & (grid.sigma > 0)] for grid in grids])
    smallest = float(known.min()) if len(known) else 1.0
    lines = ["# filename x y level"]
    for name, grid in views.items():
        if grid is None:
            lines.append(f"{name} - - -")
            continue
        sigma = np.where(grid.sigma > 0, grid.sigma, smallest)
        level = np.rint(np.log2(sigma / smallest)).astype(int)
        for node in np.ndindex(grid.shape):
            x, y = grid.xy[node]
            lines.append(
                f"{name} - - -" if np.isnan(x) else f"{name} {x:.6f} {y:.6f} {level[node]}"
            )
    write_text(path, "\n".join(lines) + "\n")


# cameras

Cameras = Mapping[str, Camera]


def save_cameras(
    path: str | PathLike[str],
    cameras: Cameras,
    *,
    covariance: Array | None = None,
    window: Window | None = None,
) -> list[Path]:
    """Write cameras in the format that the file name determines; return the files.

    A name in .yaml or .yml is OpenCV's FileStorage. The keys are numbered from 1: K1 D1 K2 D2 ...,
    lens1, name1, size1; R2 T2 ... are the poses relative to the first camera. Two pinhole or
    rational cameras also have R and T, and the `covariance` and the `window` of `StereoRig`, which
    reads the file. The other formats have no place for them.

    A name in .camchain.yaml is Kalibr's, with T_cn_cnm1 in m; the topic of each is /NAME/image_raw.

    A name in .camera_info.yaml is for ROS (camera_calibration_parsers), unrectified; several
    cameras get a file each, NAME-CAMERA.camera_info.yaml.

    Raises ConfigError on another name, CalibrationError if Kalibr has no such lens (rational, or k3
    other than 0), and OSError.
    """
    ending, target = check_cameras(path), Path(path)
    if ending in (".yaml", ".yml"):
        save_storage(target, _of_opencv(cameras, covariance, window))
        return [target]
    if ending == ".camchain.yaml":
        files = {target: _of_kalibr(cameras)}
    else:
        stem = target.name[: -len(ending)]
        single = len(cameras) == 1
        files = {
            target if single else target.with_name(f"{stem}-{name}{ending}"): _of_ros(name, camera)
            for name, camera in cameras.items()
        }
    for file, entries in files.items():
        write_text(file, "".join(f"{key}: {_flow(value)}\n" for key, value in entries.items()))
    return list(files)


def check_cameras(path: str | PathLike[str]) -> str:
    """Return the ending that names a format of `save_cameras`; raises ConfigError for any other."""
    name = Path(path).name.lower()
    for ending in (".camchain.yaml", ".camera_info.yaml", ".yaml", ".yml"):
        if name.endswith(ending):
            return ending
    raise ConfigError(
        f"{str(path)!r}: the name must end in .yaml, .yml, .camera_info.yaml (ROS) or "
        ".camchain.yaml (Kalibr)"
    )


def _of_opencv(cameras: Cameras, covariance: Array | None, window: Window | None) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for number, (name, camera) in enumerate(cameras.items(), 1):
        pose = {f"R{number}": camera.R, f"T{number}": camera.T[:, None]}
        entries |= {
            f"name{number}": name,
            f"lens{number}": camera.lens.value,
            f"size{number}": np.array([camera.size], np.int32),
            f"K{number}": camera.matrix,
            f"D{number}": camera.distortion[None],
        } | (pose if number > 1 else {})
    *_, last = cameras.values()
    if len(cameras) == 2 and Lens.FISHEYE not in {camera.lens for camera in cameras.values()}:
        entries |= {"R": last.R, "T": last.T[:, None]}
    return entries | last_entries(covariance, window, "mm")


def _of_ros(name: str, camera: Camera) -> dict[str, Any]:
    matrices = {
        "camera_matrix": camera.matrix,
        "distortion_coefficients": camera.distortion[None],
        "rectification_matrix": np.eye(3),
        "projection_matrix": np.column_stack([camera.matrix, np.zeros(3)]),
    }
    return {
        "image_width": camera.size[0],
        "image_height": camera.size[1],
        "camera_name": name,
        "distortion_model": _ROS_MODELS[camera.lens],
    } | {
        key: {"rows": matrix.shape[0], "cols": matrix.shape[1], "data": matrix.ravel()}
        for key, matrix in matrices.items()
    }


def _of_kalibr(cameras: Cameras) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    before = np.eye(4)
    for number, (name, camera) in enumerate(cameras.items()):
        if camera.lens not in _KALIBR_MODELS or camera.distortion[4:].any():
            raise CalibrationError(
                f"{name}: Kalibr knows k1 k2 p1 p2 and equidistant lenses, this one is "
                f"{camera.lens.value} with {len(camera.distortion)} coefficients; calibrate it as "
                "a pinhole or fisheye"
            )
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.R, camera.T / 1000
        entries[f"cam{number}"] = {
            "camera_model": "pinhole",
            "intrinsics": camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]],
            "distortion_model": _KALIBR_MODELS[camera.lens],
            "distortion_coeffs": camera.distortion[:4],
            "resolution": list(camera.size),
            "rostopic": f"/{name}/image_raw",
        } | ({"T_cn_cnm1": pose @ np.linalg.inv(before)} if number else {})
        before = pose
    return entries


def _flow(value: Any) -> str:
    """Return a value as YAML, in one line; numbers without exponents: YAML 1.1 takes 1e-05 for a
    word."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_flow(each)}' for key, each in value.items())}}}"
    if isinstance(value, list | np.ndarray):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, float):
        return np.format_float_positional(value, trim="0")
    return json.dumps(value)
