"""Calibration of one, two or more cameras from views of a flat board, with a choice of lens.

`cmp_cl.calibrate` makes the rig of two pinhole cameras for triangulation. `calibrate_cameras` takes
any number of cameras and wide lenses, for the formats of `cmp_cl.stereo.exports`.
"""

import dataclasses
import enum
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, check_positive
from cmp_cl.grid.grid import Grid
from cmp_cl.stereo.adjustment import matrix_of
from cmp_cl.stereo.calibration import (
    MAX_FOCAL_SIGMA,
    MIN_NODES,
    MIN_VIEWS,
    focal_sigma,
    on_board,
)
from cmp_cl.stereo.rig import StereoRig
from cmp_cl.stereo.threads import one_thread

Array = NDArray[np.float64]

_COVERAGE = 8  # cells along a side of the image, for the coverage


class Lens(enum.Enum):
    """The lens model of a camera, in OpenCV's terms.

    PINHOLE: k1 k2 p1 p2 k3 with k3 = 0. RATIONAL: k1 k2 p1 p2 k3 k4 k5 k6. FISHEYE: the
    equidistant model of cv2.fisheye, k1 k2 k3 k4.
    """

    PINHOLE = "pinhole"
    RATIONAL = "rational"
    FISHEYE = "fisheye"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A calibrated camera, and its pose relative to the first one.

    lens: the model. size: (width, height), px. matrix: (3, 3), px. distortion: 5, 8 or 4
    coefficients. R: (3, 3), T: (3,): X = R X_first + T, T in `unit`.
    """

    lens: Lens
    size: tuple[int, int]
    matrix: Array
    distortion: Array
    R: Array
    T: Array
    unit: str

    def project(self, points: Array) -> Array:
        """Project points (..., 3) in the frame of the first camera to the image, (..., 2) px."""
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3)
        turn = np.asarray(cv2.Rodrigues(self.R)[0], np.float64)
        return _projected(self.lens, flat, turn, self.T, self.matrix, self.distortion).reshape(
            *points.shape[:-1], 2
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CamerasCalibration:
    """Cameras, calibrated on views of a flat board.

    cameras: by name, the first at the origin. error: root mean square reprojection error with
    one board pose a view, px. view_errors: by camera (V,), NaN where a camera does not see it.
    places, residuals: by camera, for each view (R, C, 2) the measured corners, and measured minus
        projected ones, px, NaN where missing; None if the camera does not see the board.
    coverage: by camera, share of the image's 8 x 8 cells that hold a corner.
    focal_sigma: by camera, the larger standard deviation of the two focal lengths, px.
    """

    cameras: Mapping[str, Camera]
    error: float
    view_errors: Mapping[str, Array]
    places: Mapping[str, Sequence[Array | None]]
    residuals: Mapping[str, Sequence[Array | None]]
    coverage: Mapping[str, float]
    focal_sigma: Mapping[str, float]

    def rig(self) -> StereoRig:
        """Return the rig of two cameras; raises CalibrationError for fisheyes or another number."""
        cameras = list(self.cameras.values())
        if len(cameras) != 2 or Lens.FISHEYE in {camera.lens for camera in cameras}:
            raise CalibrationError("a rig has two cameras, neither of them a fisheye")
        one, two = cameras
        return StereoRig(
            one.matrix, one.distortion, two.matrix, two.distortion, two.R, two.T, unit=two.unit
        )


def calibrate_cameras(
    views: Mapping[str, Sequence[Grid | None]],
    *,
    spacing: float,
    sizes: Mapping[str, tuple[int, int]],
    lens: Lens = Lens.PINHOLE,
    unit: str = "mm",
) -> CamerasCalibration:
    """Calibrate cameras on views of one flat board, which all cameras number alike at each moment.

    views: by camera, the grid at every moment, None if the camera does not see the board.
    spacing: side of a square, in `unit`. sizes: (width, height) of each camera's images, px. lens:
        the lens model of all cameras.

    Each camera is calibrated alone. Its pose relative to an earlier camera comes from the moments
    that both see; the pairs with the most common moments come first. Then all poses of cameras and
    boards are fitted together, with the lenses fixed.

    Raises CalibrationError if a camera has too few views or nodes, if its views do not
    determine the focal length, or if it shares no moment with the others.
    """
    check_positive("spacing", spacing, CalibrationError)
    if not views:
        raise CalibrationError("no camera is given")
    moments = {len(grids) for grids in views.values()}
    if len(moments) != 1:
        counts = ", ".join(f"{name} {len(grids)}" for name, grids in views.items())
        raise CalibrationError(f"every camera needs an entry for each moment, here {counts}")
    alone = {name: _one(name, grids, spacing, sizes[name], lens) for name, grids in views.items()}
    boards = {name: _seen(grids, spacing) for name, grids in views.items()}
    poses = _chained(alone)
    poses, board_poses = _together(alone, boards, poses)
    return _result(views, alone, boards, poses, board_poses, sizes, lens, unit)


@dataclasses.dataclass(frozen=True, eq=False)
class _Alone:
    """A camera, calibrated alone; poses: by moment, the (4, 4) from the board to the camera."""

    lens: Lens
    matrix: Array
    distortion: Array
    poses: dict[int, Array]
    focal_sigma: float = math.nan


def _seen(grids: Sequence[Grid | None], spacing: float) -> dict[int, tuple[Array, Array]]:
    """Return, by moment, the nodes on the board (N, 3) and in the image (N, 2), if enough are
    seen."""
    return {
        moment: (on_board(grid.valid, spacing), grid.xy[grid.valid].astype(np.float64))
        for moment, grid in enumerate(grids)
        if grid is not None and np.count_nonzero(grid.valid) >= MIN_NODES
    }


def _one(
    name: str, grids: Sequence[Grid | None], spacing: float, size: tuple[int, int], lens: Lens
) -> _Alone:
    """Calibrate one camera alone."""
    seen = _seen(grids, spacing)
    if len(seen) < MIN_VIEWS:
        raise CalibrationError(
            f"{name}: {MIN_VIEWS} views with at least {MIN_NODES} corners are needed, not "
            f"{len(seen)}"
        )
    boards = [board.reshape(-1, 1, 3).astype(np.float32) for board, _ in seen.values()]
    points = [xy.reshape(-1, 1, 2).astype(np.float32) for _, xy in seen.values()]
    try:
        with one_thread():
            if lens is Lens.FISHEYE:
                error, matrix, distortion, turns, shifts = _fisheye(boards, points, size)
            else:
                flags = cv2.CALIB_RATIONAL_MODEL if lens is Lens.RATIONAL else cv2.CALIB_FIX_K3
                error, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                    boards, points, size, np.eye(3), np.zeros(8 if lens is Lens.RATIONAL else 5),
                    flags=flags,
                )  # fmt: skip
    except cv2.error as failure:
        raise CalibrationError(f"{name}: the views do not determine the camera") from failure
    matrix = np.asarray(matrix, np.float64)
    count = {Lens.PINHOLE: 5, Lens.RATIONAL: 8, Lens.FISHEYE: 4}[lens]
    coefficients = np.asarray(distortion, np.float64).reshape(-1)[:count]
    poses = {m: _pose(t, s) for m, t, s in zip(seen, turns, shifts, strict=True)}
    alone = _Alone(lens, matrix, coefficients, poses)
    sigma = focal_sigma(_slopes_of_views(alone, seen), float(error))
    if not sigma < MAX_FOCAL_SIGMA * matrix[0, 0]:
        raise CalibrationError(
            f"{name}: the views leave the focal length uncertain by {sigma / matrix[0, 0]:.0%}: "
            "show the board tilted, in different directions"
        )
    return dataclasses.replace(alone, focal_sigma=sigma)


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


def _slopes_of_views(
    alone: _Alone, seen: Mapping[int, tuple[Array, Array]]
) -> Iterator[tuple[Array, Array]]:
    """Yield the numeric derivatives of each view by its pose and by the camera."""
    start = np.concatenate([alone.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], alone.distortion])
    steps = np.r_[np.full(4, 1e-2), np.full(len(alone.distortion), 1e-5)]
    varied = [i for i in range(len(start)) if alone.lens is not Lens.PINHOLE or i != 8]
    for moment, (board, _) in seen.items():
        pose = _vector(alone.poses[moment])
        look = functools.partial(_seen_by, alone.lens, board.reshape(-1, 1, 3))
        by_camera = _slopes(functools.partial(look, pose), start, steps)[:, varied]
        turning = np.r_[np.full(3, 1e-6), np.full(3, 1e-6 * float(np.linalg.norm(pose[3:])))]
        yield _slopes(functools.partial(look, camera=start), pose, turning), by_camera


def _seen_by(lens: Lens, points: Array, pose: Array, camera: Array) -> Array:
    """Project points (N, 1, 3) by a camera (fx, fy, cx, cy, distortion) to (2 N,) px."""
    seen = _projected(lens, points, pose[:3], pose[3:], matrix_of(camera), camera[4:])
    return seen.reshape(-1)


def _slopes(function: Any, start: Array, steps: Array) -> Array:
    """Return the derivatives by central differences: (N, parameters)."""
    columns = []
    for number, step in enumerate(steps):
        shift = np.zeros(len(start))
        shift[number] = step
        columns.append((function(start + shift) - function(start - shift)) / (2 * step))
    return np.column_stack(columns)


def _projected(
    lens: Lens, points: Array, turn: Array, shift: Array, matrix: Array, distortion: Array
) -> Array:
    """Project by cv2.projectPoints of either kind: (N, 1, 3) to (N, 1, 2)."""
    project: Any = cv2.fisheye.projectPoints if lens is Lens.FISHEYE else cv2.projectPoints
    pose = (np.ascontiguousarray(part, np.float64).reshape(3, 1) for part in (turn, shift))
    seen = project(points, *pose, matrix, distortion)[0]
    return np.asarray(seen, np.float64)


def _pose(turn: Any, shift: Any) -> Array:
    """Return the (4, 4) of a rotation vector and a translation."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, np.float64).reshape(3, 1))[0]
    pose[:3, 3] = np.asarray(shift, np.float64).reshape(3)
    return pose


def _vector(pose: Array) -> Array:
    """Return the rotation vector and translation of a (4, 4), (6,)."""
    return np.concatenate([cv2.Rodrigues(pose[:3, :3])[0].reshape(3), pose[:3, 3]])


def _chained(alone: Mapping[str, _Alone]) -> dict[str, Array]:
    """Return, by camera, the (4, 4) from the first; pairs with most common moments come first."""
    names = list(alone)
    placed = {names[0]: np.eye(4)}
    while len(placed) < len(names):
        pairs = [
            (len(alone[old].poses.keys() & alone[new].poses.keys()), old, new)
            for old in placed
            for new in names
            if new not in placed
        ]
        common, old, new = max(pairs, key=lambda pair: pair[0])
        if not common:
            left = ", ".join(name for name in names if name not in placed)
            raise CalibrationError(f"{left}: no moment shows the board in another camera as well")
        shared = sorted(alone[old].poses.keys() & alone[new].poses.keys())
        guesses = [
            _vector(alone[new].poses[m] @ np.linalg.inv(alone[old].poses[m])) for m in shared
        ]
        middle = guesses[int(np.argmin([np.sum([np.linalg.norm(a - b) for b in guesses])
                                        for a in guesses]))]  # fmt: skip
        placed[new] = _pose(middle[:3], middle[3:]) @ placed[old]
    return {name: placed[name] for name in names}


def _together(
    alone: Mapping[str, _Alone],
    boards: Mapping[str, Mapping[int, tuple[Array, Array]]],
    poses: dict[str, Array],
) -> tuple[dict[str, Array], dict[int, Array]]:
    """Fit all poses of cameras and boards together by the method of Levenberg and Marquardt."""
    names = list(alone)
    moments = sorted(set().union(*(camera.poses for camera in alone.values())))
    board_poses = {}
    for moment in moments:
        name = next(name for name in names if moment in alone[name].poses)
        board_poses[moment] = np.linalg.inv(poses[name]) @ alone[name].poses[moment]
    free = names[1:]
    x = np.concatenate(
        [_vector(poses[name]) for name in free] + [_vector(board_poses[m]) for m in moments]
    )

    def unpacked(x: Array) -> tuple[dict[str, Array], dict[int, Array]]:
        parts = [_pose(part[:3], part[3:]) for part in x.reshape(-1, 6)]
        cameras = {names[0]: np.eye(4), **dict(zip(free, parts, strict=False))}
        return cameras, dict(zip(moments, parts[len(free) :], strict=True))

    def missed(x: Array) -> Array:
        cameras, places = unpacked(x)
        return np.concatenate(
            [
                _missed(alone[name], cameras[name] @ places[moment], *nodes).reshape(-1)
                for name in names
                for moment, nodes in boards[name].items()
            ]
        )

    if free:
        x = _least_squares(missed, x)
    return unpacked(x)


def _missed(camera: _Alone, pose: Array, board: Array, xy: Array) -> Array:
    vector = _vector(pose)
    points = board.reshape(-1, 1, 3)
    seen = _projected(camera.lens, points, vector[:3], vector[3:], camera.matrix, camera.distortion)
    missed: Array = xy - seen.reshape(-1, 2)
    return missed


def _least_squares(missed: Any, x: Array) -> Array:
    damping, residual = 1e-3, missed(x)
    for _ in range(30):
        steps = np.maximum(1e-7, 1e-7 * np.abs(x))
        jacobian = _slopes(missed, x, steps)
        square, goal = jacobian.T @ jacobian, jacobian.T @ residual
        while damping < 1e9:
            step = np.linalg.solve(square + damping * np.diag(np.diag(square)), -goal)
            trial = missed(x + step)
            if trial @ trial < residual @ residual:
                break
            damping *= 10
        else:
            return x
        gain = 1 - (trial @ trial) / (residual @ residual)
        x, residual, damping = x + step, trial, damping / 10
        if gain < 1e-9:
            break
    return x


def _result(
    views: Mapping[str, Sequence[Grid | None]],
    alone: Mapping[str, _Alone],
    boards: Mapping[str, Mapping[int, tuple[Array, Array]]],
    poses: Mapping[str, Array],
    board_poses: Mapping[int, Array],
    sizes: Mapping[str, tuple[int, int]],
    lens: Lens,
    unit: str,
) -> CamerasCalibration:
    cameras, errors, residuals, coverage = {}, {}, {}, {}
    total, count = 0.0, 0
    for name, grids in views.items():
        camera = alone[name]
        cameras[name] = Camera(
            lens=lens,
            size=sizes[name],
            matrix=camera.matrix,
            distortion=camera.distortion,
            R=poses[name][:3, :3],
            T=poses[name][:3, 3],
            unit=unit,
        )
        errors[name] = np.full(len(grids), np.nan)
        of_views: list[Array | None] = [None] * len(grids)
        filled = np.zeros((_COVERAGE, _COVERAGE), bool)
        for moment, (board, xy) in boards[name].items():
            off = _missed(camera, poses[name] @ board_poses[moment], board, xy)
            grid = grids[moment]
            if grid is None:
                continue
            spread = np.full((*grid.shape, 2), np.nan)
            spread[grid.valid] = off
            of_views[moment] = spread
            errors[name][moment] = math.sqrt(float(np.square(off).sum(axis=1).mean()))
            total += float(np.square(off).sum())
            count += len(off)
            cells = np.floor((xy + 0.5) / np.array(sizes[name]) * _COVERAGE).astype(int)
            filled[tuple(np.clip(cells.T[::-1], 0, _COVERAGE - 1))] = True
        residuals[name], coverage[name] = of_views, float(filled.mean())
    return CamerasCalibration(
        cameras=cameras,
        error=math.sqrt(total / count),
        view_errors=errors,
        places={
            name: [
                None if grid is None or moment not in boards[name] else grid.xy.astype(np.float64)
                for moment, grid in enumerate(grids)
            ]
            for name, grids in views.items()
        },
        residuals=residuals,
        coverage=coverage,
        focal_sigma={name: alone[name].focal_sigma for name in views},
    )
