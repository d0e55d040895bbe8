"""Cameras, rigs, grids and points for the tests in space: projected lattices and photographs."""

import json
from pathlib import Path

import cv2
import numpy as np

from cmp_cl.grid import Grid, NodeStatus
from cmp_cl.space import Camera, Lens, Points3D, PointStatus, StereoRig

_ABOVE = Path(__file__).resolve().parents[3:]
SHARED = next((at for up in _ABOVE if (at := up / "shared" / "data").is_dir()), Path("shared/data"))
SIZE = (640, 480)
MATRIX = np.array([[420.0, 0, 325], [0, 418.0, 236], [0, 0, 1]])
DISTORTIONS = {
    Lens.PINHOLE: np.array([-0.1, 0.03, 0.001, -0.0005, 0]),
    Lens.RATIONAL: np.array([0.3, 0.05, 0.0005, -0.0005, 0.01, 0.42, 0.08, 0.02]),
    Lens.FISHEYE: np.array([0.05, -0.01, 0.004, -0.001]),
}


def photographs(name: str) -> Path:
    """Return the folder of shared photographs of that name, or skip the test."""
    import pytest

    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the shared photographs {folder} are not here")
    return folder


def grid_of(xy: np.ndarray, sigma: float = np.nan) -> Grid:
    """Return a grid from positions (R, C, 2); NaN where missing."""
    xy = np.asarray(xy, np.float32)
    missing = np.isnan(xy[..., 0])
    rows, columns = np.indices(missing.shape)
    return Grid(
        xy=xy,
        status=np.where(missing, NodeStatus.MISSING, NodeStatus.DETECTED).astype(np.uint8),
        image_sigma=np.where(missing, np.nan, sigma).astype(np.float32),
        index=np.stack([rows[~missing], columns[~missing]], axis=1).astype(np.int32),
    )


def _listed(path: Path) -> Grid:
    """Return the listed corners of a photograph's JSON as a grid [j, i]."""
    corners = json.loads(path.read_text())["corners"]
    shape = max(c["j"] for c in corners) + 1, max(c["i"] for c in corners) + 1
    xy = np.full((*shape, 2), np.nan)
    for corner in corners:
        xy[corner["j"], corner["i"]] = corner["x"], corner["y"]
    return grid_of(xy)


def opencv_pairs() -> dict[str, list[Grid]]:
    """Return the listed corners of OpenCV's five photographs of each camera, 640 x 480 px."""
    folder = photographs("stereo_opencv")
    return {
        side: [_listed(folder / f"{side}{pair:02}.json") for pair in range(1, 6)]
        for side in ("left", "right")
    }


def camera(lens: Lens, rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 0.0)) -> Camera:
    """Return a camera of 640 x 480 px; rotation: vector, rad. translation: mm."""
    return Camera(
        lens=lens,
        size=SIZE,
        matrix=MATRIX,
        distortion=DISTORTIONS[lens],
        R=cv2.Rodrigues(np.array(rotation))[0],
        T=np.array(translation),
    )


def toed_in_rig(unit: str = "mm") -> StereoRig:
    """Return two cameras 16 mm apart that look at a point 46 mm away, with lens distortion."""
    rotation = cv2.Rodrigues(np.array([0.01, 0.35, -0.02]))[0]
    centre = np.array([0.0, 0.0, 46.0])
    return StereoRig(
        [[1260, 0, 401], [0, 1262, 598], [0, 0, 1]],
        [-0.12, 0.05, 0.0006, -0.0004, 0.0],
        [[1255, 0, 397], [0, 1254, 603], [0, 0, 1]],
        [-0.11, 0.04, -0.0005, 0.0007, 0.0],
        rotation,
        centre - rotation @ centre,
        unit=unit,
    )


def project(rig: StereoRig, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the projections of the points (..., 3) in both cameras: two arrays (..., 2), px.

    They are OpenCV's, which knows no window.
    """
    rotation = cv2.Rodrigues(rig.R)[0]
    flat = np.ascontiguousarray(xyz, np.float64).reshape(-1, 3)
    if rig.window is None:
        left, _ = cv2.projectPoints(flat, np.zeros(3), np.zeros(3), rig.K1, rig.D1)
        right, _ = cv2.projectPoints(flat, rotation, rig.T, rig.K2, rig.D2)
    else:
        left, right = rig.project(flat)
    shape = (*xyz.shape[:-1], 2)
    return left.reshape(shape), right.reshape(shape)


def views_of(
    rig: StereoRig,
    xyz: np.ndarray,
    rng: np.random.Generator | None = None,
    noise: float = 0.05,
    *,
    shared: bool = False,
) -> list[Grid]:
    """Return the grids of both views of points (R, C, 3), exact, or with noise, px, that sigma
    knows. shared: neighbours have nearly the same noise."""
    if rng is None:
        return [grid_of(xy) for xy in project(rig, xyz)]
    grids = []
    for xy in project(rig, xyz):
        error = rng.normal(0, noise, xy.shape)
        grids.append(grid_of(xy + (3 * cv2.blur(error, (3, 3)) if shared else error), noise))
    return grids


def gel(rows: int = 20, columns: int = 20, depth: float = 2.0) -> np.ndarray:
    """Return nodes (R, C, 3) of a pressed gel 46 mm away and 30 mm wide, mm."""
    y, x = np.meshgrid(np.linspace(-15, 15, rows), np.linspace(-15, 15, columns), indexing="ij")
    press = depth * np.exp(-((x - 2) ** 2 + (y + 1) ** 2) / 30)
    return np.stack([x, y, 46 - press], axis=-1)


def points(xyz: np.ndarray, sigma: float = 0.01, unit: str = "mm") -> Points3D:
    """Return points as triangulation returns them, from positions (R, C, 3); NaN where missing."""
    xyz = np.asarray(xyz, float)
    missing = np.isnan(xyz[..., 0])
    covariance = np.broadcast_to(np.eye(3) * sigma**2, (*missing.shape, 3, 3)).copy()
    covariance[missing] = np.nan
    return Points3D(
        xyz=xyz,
        error=np.where(missing, np.nan, 0.0),
        covariance=covariance,
        status=np.where(missing, PointStatus.MISSING, PointStatus.VALID).astype(np.uint8),
        source=np.where(missing, NodeStatus.MISSING, NodeStatus.DETECTED).astype(np.uint8),
        unit=unit,
    )


def rms(error: np.ndarray) -> float:
    """Return the root mean square of what is known of an error."""
    return float(np.sqrt(np.nanmean(np.square(error))))
