"""Where a calibration starts: the nodes of the views, each camera alone, and the poses between."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.grid.grid import Grid
from cmp_cl.space.adjustment import Look, State
from cmp_cl.space.lens import ESTIMATED, POSE, Lens, camera_of, projected
from cmp_cl.space.threads import one_thread

MIN_VIEWS = 3
MIN_NODES = 8  # fewest nodes of a board in a view
# Share of the focal length; a larger sigma means that the views do not determine it.
_MAX_FOCAL_SIGMA = 0.05
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Alone:
    """A camera, calibrated alone.

    camera: its parameters, at the origin. poses: by moment, the pose of the board (6,).
    focal_sigma: the larger standard deviation of the focal lengths, px. error: root mean square
        reprojection error, px.
    """

    camera: Array
    poses: Mapping[int, Array]
    focal_sigma: float
    error: float


def board_of(grids: Sequence[Grid | None], spacing: float) -> Array:
    """Return a flat board (R, C, 3) that holds all nodes of the grids, in the unit of spacing."""
    shapes = [grid.shape for grid in grids if grid is not None]
    row, column = np.indices(np.max(shapes, axis=0) if shapes else (0, 0))
    return np.stack([column, row, np.zeros(row.shape)], axis=-1) * float(spacing)


def look_at(board: Array, grid: Grid, valid: NDArray[np.bool_], camera: int, moment: int) -> Look:
    """Return what a camera sees of a board (R, C, 3): the nodes of a grid at a mask."""
    return Look(
        camera,
        moment,
        np.ravel_multi_index(np.nonzero(valid), board.shape[:2]),
        grid.xy[valid].astype(np.float64),
        grid.sigma[valid].astype(np.float64),
    )


def calibrate_alone(
    lens: Lens, looks: Sequence[Look], board: Array, size: tuple[int, int]
) -> Alone:
    """Calibrate one camera by OpenCV.

    looks: of that camera. board: (R, C, 3). size: (width, height), px. Raises cv2.error if OpenCV
    finds no camera, and CalibrationError if the views do not determine the focal length.
    """
    nodes = [board.reshape(-1, 3)[look.nodes] for look in looks]
    views = [np.ascontiguousarray(each[:, None], np.float32) for each in nodes]
    points = [np.ascontiguousarray(look.xy[:, None], np.float32) for look in looks]
    with one_thread():
        if lens is Lens.FISHEYE:
            error, matrix, distortion, turns, shifts = _fisheye(views, points, size)
        else:
            flags = cv2.CALIB_RATIONAL_MODEL if lens is Lens.RATIONAL else cv2.CALIB_FIX_K3
            none = np.zeros(lens.coefficients)
            error, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                views, points, size, np.eye(3), none, flags=flags
            )
    coefficients = distortion.ravel()[: lens.coefficients]
    camera = camera_of(matrix, coefficients, np.eye(3), np.zeros(3))
    poses = [np.r_[turn.ravel(), shift.ravel()] for turn, shift in zip(turns, shifts, strict=True)]
    slopes = [
        projected(lens, each, np.r_[camera[:-POSE], pose])[1]
        for each, pose in zip(nodes, poses, strict=True)
    ]
    sigma = _focal_sigma(slopes, unknowns(lens, 1)[0, :-POSE], float(error))
    if not sigma < _MAX_FOCAL_SIGMA * camera[0]:
        raise CalibrationError(
            f"the views leave the focal length uncertain by {sigma / camera[0]:.0%}: "
            "show the board tilted, in different directions"
        )
    moments = [look.moment for look in looks]
    return Alone(camera, dict(zip(moments, poses, strict=True)), sigma, float(error))


def unknowns(lens: Lens, cameras: int) -> NDArray[np.bool_]:
    """Return which parameters of cameras are unknown, (C, P): not k3 of a pinhole, and not the pose
    of the first camera."""
    free = np.ones((cameras, 4 + lens.coefficients + POSE), bool)
    if lens is Lens.PINHOLE:
        free[:, ESTIMATED] = False
    free[0, -POSE:] = False
    return free


def _fisheye(boards: Any, points: Any, size: tuple[int, int]) -> Any:
    """Run cv2.fisheye.calibrate, from a focal length that fits the wider side into 180 degrees."""
    focal = max(size) / math.pi
    matrix = np.array([[focal, 0, size[0] / 2 - 0.5], [0, focal, size[1] / 2 - 0.5], [0, 0, 1]])
    names = "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"
    # OpenCV 5 moved these flags out of cv2.fisheye.
    flags = sum(getattr(cv2.fisheye, name, getattr(cv2, name, 0)) for name in names)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    return cv2.fisheye.calibrate(
        [board.astype(np.float64).reshape(1, -1, 3) for board in boards],
        [xy.astype(np.float64).reshape(1, -1, 2) for xy in points],
        size, matrix, np.zeros((4, 1)), flags=flags, criteria=criteria,
    )  # fmt: skip


def _focal_sigma(slopes: Sequence[Array], free: NDArray[np.bool_], error: float) -> float:
    """Return the larger standard deviation of fx and fy, px; infinite where undetermined.

    OpenCV's own estimate drops small singular values: it is 0 where every view faces the camera.
    slopes: for each view the derivatives of its projection, see `projected`. free: the parameters
    of the lens that are estimated. error: RMS reprojection error, px.
    """
    parts = []
    for each in slopes:
        by_camera = each.reshape(-1, each.shape[2])
        basis = np.linalg.qr(by_camera[:, -POSE:])[0]
        by_lens = by_camera[:, :-POSE][:, free]
        parts.append(by_lens - basis @ (basis.T @ by_lens))
    stacked = np.concatenate(parts)
    scale = np.linalg.norm(stacked, axis=0)
    if not (scale > 0).all():
        return math.inf
    _, singular, axes = np.linalg.svd(stacked / scale, full_matrices=False)
    if not singular[-1] > 0:
        return math.inf
    deviation = np.linalg.norm(axes[:, :2] / singular[:, None], axis=0) / scale[:2]
    return float(deviation.max() * error / math.sqrt(2))


def joined(found: Mapping[str, Alone], board: Array) -> State:
    """Return the cameras with the poses between them, and the poses of the board.

    The pose of a camera relative to an earlier one comes from the moments that both see; the pairs
    with the most common moments come first. Raises CalibrationError if a camera shares no moment
    with the others.
    """
    names = list(found)
    placed = {names[0]: np.eye(4)}
    while len(placed) < len(names):
        pairs = [
            (len(found[old].poses.keys() & found[new].poses.keys()), old, new)
            for old in placed
            for new in names
            if new not in placed
        ]
        common, old, new = max(pairs, key=lambda pair: pair[0])
        if not common:
            left = ", ".join(name for name in names if name not in placed)
            raise CalibrationError(f"{left}: no moment shows the board in another camera as well")
        placed[new] = _between(found[old].poses, found[new].poses) @ placed[old]
    poses = np.zeros((1 + max(max(each.poses) for each in found.values()), POSE))
    for name in reversed(names):  # the pose of a moment is that in the first camera that sees it
        for moment, pose in found[name].poses.items():
            poses[moment] = _vector(np.linalg.inv(placed[name]) @ _pose(pose))
    cameras = [np.r_[each.camera[:-POSE], _vector(placed[name])] for name, each in found.items()]
    return State(np.array(cameras), poses, board.reshape(-1, 3))


def _between(old: Mapping[int, Array], new: Mapping[int, Array]) -> Array:
    """Return the (4, 4) from an old camera to a new one: the middle one of their common moments."""
    guesses = np.array(
        [
            _vector(_pose(new[moment]) @ np.linalg.inv(_pose(old[moment])))
            for moment in sorted(old.keys() & new.keys())
        ]
    )
    distances = np.linalg.norm(guesses[:, None] - guesses, axis=2)
    return _pose(guesses[distances.sum(axis=1).argmin()])


def _pose(vector: Array) -> Array:
    """Return the (4, 4) of a rotation vector and a translation (6,)."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(vector[:3])[0]
    pose[:3, 3] = vector[3:]
    return pose


def _vector(pose: Array) -> Array:
    """Return the rotation vector and translation of a (4, 4), (6,)."""
    return np.concatenate([cv2.Rodrigues(pose[:3, :3])[0].ravel(), pose[:3, 3]])
