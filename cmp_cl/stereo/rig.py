"""Two views of one pattern: calibration, and from equal grid indices to points in space."""

import dataclasses
import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import CalibrationError, ConfigError, FieldError, ImageError
from cmp_cl.files import write_text
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage
from cmp_cl.stereo.adjustment import CAMERA, POSE, Adjusted, View, adjust
from cmp_cl.stereo.points import Points3D, PointStatus
from cmp_cl.stereo.reading import check_nesting

MIN_PARALLAX = 1.0  # px: under it, depth is noise
_MAX_ROUND_TRIP = 0.01  # px: undistorted and distorted again
_MAX_FILE = 1 << 20  # bytes
_MAX_NUMBERS = 484  # of a matrix in a file: the covariance of 22
_COVARIANCE = "covariance"
_MIN_VIEWS = 3
_MIN_NODES = 8  # of a board in a view
_MAX_FOCAL_SIGMA = 0.05  # of the focal length: above it the views do not determine it
_MAX_MISFIT = 1.0  # px that both cameras together may miss, or
_MAX_MISFIT_RATIO = 3.0  # times what each misses alone
_UNDISTORT = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
_ALIASES = {
    "K1": ("K1", "M1", "cameraMatrix1"),
    "D1": ("D1", "distCoeffs1"),
    "K2": ("K2", "M2", "cameraMatrix2"),
    "D2": ("D2", "distCoeffs2"),
    "R": ("R",),
    "T": ("T",),
}

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class BinocularSplit:
    """Where the two views lie in a frame that shows both, as behind a mirror device.

    left, right: rectangles (x, y, width, height), px.
    mirror_left, mirror_right: turn that view left to right, where an odd number of mirrors
        shows it reversed. A rig must be calibrated on views split in the same way.
    """

    left: tuple[int, int, int, int]
    right: tuple[int, int, int, int]
    mirror_left: bool = False
    mirror_right: bool = False

    def __post_init__(self) -> None:
        for side in ("left", "right"):
            box = getattr(self, side)
            whole = isinstance(box, tuple) and all(type(number) is int for number in box)
            if not whole or len(box) != 4 or min(box[:2]) < 0 or min(box[2:]) < 1:
                raise ConfigError(
                    f"BinocularSplit.{side} must be whole numbers (x, y, width, height) with "
                    f"x, y >= 0 and width, height >= 1, not {box!r}"
                )

    @classmethod
    def halves(cls, width: int, height: int) -> Self:
        """The left and the right half of a frame of that size, px; a middle column is left out.

        Raises ConfigError where the frame is narrower than 2 px or has no row.
        """
        half = width // 2
        return cls((0, 0, half, height), (width - half, 0, half, height))

    def __call__(self, frame: GreyImage) -> tuple[GreyImage, GreyImage]:
        """The two views of a frame (H, W): slices of it, or copies where mirrored.

        Raises ImageError where a rectangle leaves the frame.
        """
        return (
            _cut(frame, self.left, mirror=self.mirror_left),
            _cut(frame, self.right, mirror=self.mirror_right),
        )


def _cut(frame: GreyImage, box: tuple[int, int, int, int], *, mirror: bool) -> GreyImage:
    x, y, width, height = box
    if y + height > frame.shape[0] or x + width > frame.shape[1]:
        raise ImageError(
            f"the view (x, y, width, height) = {box} leaves the frame of "
            f"{frame.shape[1]} x {frame.shape[0]} px"
        )
    view = frame[y : y + height, x : x + width]
    return view[:, ::-1].copy() if mirror else view


@dataclasses.dataclass(frozen=True, eq=False)
class StereoRig:
    """Two calibrated cameras in OpenCV's convention: X_right = R X_left + T.

    K1, K2: (3, 3) camera matrices, px, pixel centres at integers. D1, D2: 4, 5, 8, 12 or 14
    distortion coefficients, empty for none. R: (3, 3) rotation. T: (3,), in `unit`.
    covariance: (22, 22) of fx fy cx cy k1 k2 p1 p2 of the left camera, of the right one, and of
    the rotation vector and the translation, as `calibrate` finds it; None where unknown.
    All are kept as read-only float64.

    Raises CalibrationError where a parameter is malformed or the cameras coincide.
    """

    K1: Array
    D1: Array
    K2: Array
    D2: Array
    R: Array
    T: Array
    unit: str = "mm"
    covariance: Array | None = None

    def __post_init__(self) -> None:
        if self.covariance is not None:
            size = 2 * CAMERA + POSE
            self._set("covariance", _numbers("covariance", self.covariance, (size, size)))
        for name, shape in (("K1", (3, 3)), ("K2", (3, 3)), ("R", (3, 3)), ("T", (3,))):
            self._set(name, _numbers(name, getattr(self, name), shape))
        for name in ("D1", "D2"):
            self._set(name, _distortion(name, getattr(self, name)))
        _check_matrix("K1", self.K1)
        _check_matrix("K2", self.K2)
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(self.R) < 0:
            raise CalibrationError(f"R must be a rotation matrix, not {self.R.tolist()}")
        if np.linalg.norm(self.T) < 1e-9:
            raise CalibrationError("T is zero: two cameras in one place see no depth")
        if not (isinstance(self.unit, str) and self.unit.isidentifier()):
            raise CalibrationError(f"unit must be a word such as mm, not {self.unit!r}")

    def _set(self, name: str, value: Array) -> None:
        value.flags.writeable = False
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, *paths: str | PathLike[str], unit: str | None = None) -> Self:
        """Read a rig from one or more files of OpenCV's FileStorage (YAML, XML or JSON).

        Takes K1 D1 K2 D2 R T, also under the names M1, M2, cameraMatrix1, distCoeffs1, ...;
        OpenCV's stereo_calib writes them to two files, intrinsics.yml and extrinsics.yml.
        unit names the unit of T; None means the file's key `unit`, or mm.

        Raises CalibrationError where a file cannot be read, or a parameter is missing,
        malformed or given twice with different values.
        """
        found: dict[str, Array] = {}
        named = unit
        covariance: Array | None = None
        for path in paths:
            storage = _open(path)
            for name, aliases in _ALIASES.items():
                for alias in aliases:
                    value = _matrix(storage, alias, path)
                    if value is None:
                        continue
                    if name in found and not np.array_equal(found[name], value):
                        raise CalibrationError(f"{path}: {alias} contradicts an earlier {name}")
                    found[name] = value
            kept = _matrix(storage, _COVARIANCE, path)
            covariance = covariance if kept is None else kept
            written = storage.getNode("unit")
            if named is None and written.isString():
                named = written.string()
        missing = [" or ".join(_ALIASES[name]) for name in _ALIASES if name not in found]
        if missing:
            files = ", ".join(str(path) for path in paths)
            raise CalibrationError(f"{files}: no {'; no '.join(missing)}")
        try:
            return cls(**found, unit="mm" if named is None else named, covariance=covariance)
        except CalibrationError as error:
            raise CalibrationError(f"{', '.join(map(str, paths))}: {error}") from error

    def save(self, path: str | PathLike[str]) -> None:
        """Write K1 D1 K2 D2 R T and unit as YAML that OpenCV reads, whole or not at all.

        Raises OSError.
        """
        mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML
        storage = cv2.FileStorage(".yml", mode)
        for name in _ALIASES:
            storage.write(name, np.atleast_2d(getattr(self, name)).copy())
        if self.covariance is not None:
            storage.write(_COVARIANCE, self.covariance.copy())
        storage.write("unit", self.unit)
        body = storage.releaseAndGetString().split("\n", 1)[1]
        write_text(path, "%YAML:1.0\n" + body)

    def triangulate(
        self, left: Grid, right: Grid, *, sigma: float = math.nan, max_error: float = 3.0
    ) -> Points3D:
        """The nodes that both grids have, in space, in the frame of the left camera.

        Equal indices are the match. sigma: standard deviation of a position, px, for nodes
        whose own is unknown. max_error: largest reprojection error, px. A node that cannot be
        placed is NaN, and its status says why: the rays must enclose at least MIN_PARALLAX
        px, the point must lie before both cameras.

        Raises FieldError where the grids have different shapes.
        """
        if left.shape != right.shape:
            raise FieldError(f"the grids have different shapes: {left.shape} and {right.shape}")
        both = left.valid & right.valid
        seen = np.hstack([left.xy[both], right.xy[both]]).astype(np.float64)
        deviation = np.column_stack([left.sigma[both], right.sigma[both]]).astype(np.float64)
        deviation[~(deviation > 0)] = sigma if sigma > 0 else np.nan
        xyz, status = self._linear(seen)
        error = np.full(len(seen), np.nan)
        covariance = np.full((len(seen), 3, 3), np.nan)
        good = status == PointStatus.VALID
        xyz[good], error[good], covariance[good] = self._refined(
            xyz[good], seen[good], deviation[good]
        )
        status[good & ~(error <= max_error)] = PointStatus.INCONSISTENT
        good = status == PointStatus.VALID
        xyz[~good] = np.nan
        covariance[~good] = np.nan
        shared = None
        if self.covariance is not None:
            own = np.full((len(seen), 3, 3), np.nan)
            own[good] = self._of_calibration(xyz[good], deviation[good])
            shared = _spread(both, own)
        all_status = np.full(left.shape, PointStatus.MISSING, np.uint8)
        all_status[both] = status
        return Points3D(
            xyz=_spread(both, xyz),
            error=_spread(both, error),
            covariance=_spread(both, covariance),
            status=all_status,
            source=np.where(both, np.maximum(left.status, right.status), NodeStatus.MISSING).astype(
                np.uint8
            ),
            unit=self.unit,
            calibration_covariance=shared,
        )

    def _linear(self, seen: Array) -> tuple[Array, NDArray[np.uint8]]:
        """OpenCV's linear triangulation of (N, 4) px, left and right: (N, 3), (N,) status."""
        left, left_in_model = undistort(seen[:, :2], self.K1, self.D1)
        right, right_in_model = undistort(seen[:, 2:], self.K2, self.D2)
        pose = np.column_stack([self.R, self.T])
        xyz = triangulate_points(np.eye(3, 4), pose, left, right)
        depth = np.minimum(xyz[:, 2], (xyz @ self.R.T + self.T)[:, 2])
        one, two = _rays(left), _rays(right) @ self.R
        sine = np.linalg.norm(np.cross(one, two), axis=1)
        sine /= np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        focal = (self.K1[0, 0] + self.K1[1, 1] + self.K2[0, 0] + self.K2[1, 1]) / 4

        status = np.full(len(seen), PointStatus.VALID, np.uint8)
        status[~(depth > 0)] = PointStatus.BEHIND
        status[~(sine * focal >= MIN_PARALLAX)] = PointStatus.PARALLEL
        status[~(left_in_model & right_in_model)] = PointStatus.INCONSISTENT
        return xyz, status

    def _refined(self, xyz: Array, seen: Array, sigma: Array) -> tuple[Array, Array, Array]:
        """One Gauss-Newton step on the reprojection error, weighted by the positions' sigma.

        xyz: (N, 3). seen: (N, 4) px, left and right. sigma: (N, 2) px; NaN weighs both alike.
        Returns (N, 3) points, (N,) errors in px, (N, 3, 3) covariances.
        """
        if not len(xyz):
            return xyz, np.empty(0), np.empty((0, 3, 3))
        projected, jacobian, _ = self._projected(xyz)
        miss = seen - projected
        known = np.isfinite(sigma.sum(axis=1))
        weight = np.repeat(1 / np.where(known[:, None], sigma, 1), 2, axis=1)
        scaled = jacobian * weight[..., None]
        transposed = scaled.transpose(0, 2, 1)
        inverse = np.linalg.inv(transposed @ scaled)
        step = inverse @ (transposed @ (miss * weight)[..., None])
        rest = miss - (jacobian @ step)[..., 0]
        error = np.sqrt(np.square(rest).sum(axis=1) / 2)
        return xyz + step[..., 0], error, np.where(known[:, None, None], inverse, np.nan)

    def _of_calibration(self, xyz: Array, sigma: Array) -> Array:
        """(N, 3, 3): the covariance of the points that the calibration's error makes."""
        if not len(xyz) or self.covariance is None:
            return np.empty((0, 3, 3))
        _, jacobian, by_rig = self._projected(xyz)
        known = np.isfinite(sigma.sum(axis=1))
        weight = np.repeat(1 / np.where(known[:, None], sigma, 1), 2, axis=1)[..., None]
        answer = -np.linalg.pinv(jacobian * weight) @ (by_rig * weight)
        shared: Array = answer @ self.covariance @ answer.transpose(0, 2, 1)
        return shared

    def _projected(self, xyz: Array) -> tuple[Array, Array, Array]:
        """Where both cameras see points: (N, 4) px, and its slopes by the point, (N, 4, 3), and by
        the 22 numbers of `covariance`, (N, 4, 22).
        """
        turn = cv2.Rodrigues(self.R)[0]
        zero = np.zeros(3)
        left, by_left = cv2.projectPoints(xyz, zero, zero, self.K1, self.D1)
        right, by_right = cv2.projectPoints(xyz, turn, self.T, self.K2, self.D2)
        by_left, by_right = (each.reshape(len(xyz), 2, -1) for each in (by_left, by_right))
        by_shift = slice(3, 6)  # a derivative by the translation is one by the turned point
        jacobian = np.concatenate(
            [by_left[..., by_shift], by_right[..., by_shift] @ self.R], axis=1
        )
        by_rig = np.zeros((len(xyz), 4, 2 * CAMERA + POSE))
        by_rig[:, :2, :CAMERA] = by_left[..., POSE : POSE + CAMERA]
        by_rig[:, 2:, CAMERA : 2 * CAMERA] = by_right[..., POSE : POSE + CAMERA]
        by_rig[:, 2:, 2 * CAMERA :] = by_right[..., :POSE]
        return np.hstack([left.reshape(-1, 2), right.reshape(-1, 2)]), jacobian, by_rig


def undistort(
    points: NDArray[Any], matrix: Array, distortion: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels to the plane at distance 1 in front of the camera.

    points: (N, 2) px. Returns (N, 2) float64, and (N,) whether distorting the result leads
    back to the pixel: where it does not, the lens model has no answer.
    """
    measured = np.ascontiguousarray(points, np.float64).reshape(-1, 1, 2)
    if not len(measured):
        return np.empty((0, 2)), np.empty(0, bool)
    straight = cv2.undistortImagePoints(measured, matrix, distortion, None, _UNDISTORT)
    straight = straight.reshape(-1, 2)
    ideal = (straight - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    back, _ = cv2.projectPoints(_rays(ideal), np.zeros(3), np.zeros(3), matrix, distortion)
    miss = np.linalg.norm(back.reshape(-1, 2) - measured.reshape(-1, 2), axis=1)
    return ideal, miss < _MAX_ROUND_TRIP


def triangulate_points(
    left_projection: Array, right_projection: Array, left: Array, right: Array
) -> Array:
    """cv2.triangulatePoints with its arguments checked: it takes (N, 2) for N points of 2.

    projections: (3, 4). left, right: (N, 2) float64, in the units of the projections.
    Returns (N, 3) float64, NaN where a point is at infinity.

    Raises FieldError on other shapes.
    """
    if left.ndim != 2 or left.shape[1] != 2 or left.shape != right.shape:
        raise FieldError(f"expected two arrays (N, 2), got {left.shape} and {right.shape}")
    if not len(left):
        return np.empty((0, 3))
    homogeneous = cv2.triangulatePoints(
        np.ascontiguousarray(left_projection, np.float64),
        np.ascontiguousarray(right_projection, np.float64),
        np.ascontiguousarray(left.T, np.float64),
        np.ascontiguousarray(right.T, np.float64),
    )
    if homogeneous.shape != (4, len(left)):
        raise FieldError(f"cv2.triangulatePoints returned {homogeneous.shape}, not (4, N)")
    scale = homogeneous[3]
    scale = np.where(np.abs(scale) < 1e-12, np.nan, scale)
    points: Array = (homogeneous[:3] / scale).T
    return points


def _rays(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def _spread(where: NDArray[np.bool_], values: NDArray[Any]) -> Array:
    """Values of the True places of an (R, C) mask, NaN elsewhere."""
    spread = np.full((*where.shape, *values.shape[1:]), np.nan)
    spread[where] = values
    return spread


def _numbers(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{name} must be numbers of shape {shape}: {error}") from error
    if shape == (3,) and array.shape in ((3, 1), (1, 3)):
        array = array.reshape(3)
    if array.shape != shape:
        raise CalibrationError(f"{name} must have shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        raise CalibrationError(f"{name} must be finite, not {array.tolist()}")
    return array


def _distortion(name: str, value: ArrayLike) -> Array:
    size = np.size(value)
    if size not in (0, 4, 5, 8, 12, 14):
        raise CalibrationError(f"{name} must have 0, 4, 5, 8, 12 or 14 coefficients, not {size}")
    return _numbers(name, np.reshape(value, -1), (size,)) if size else np.zeros(5)


def _check_matrix(name: str, matrix: Array) -> None:
    if min(matrix[0, 0], matrix[1, 1]) <= 0:
        raise CalibrationError(f"{name} must have positive focal lengths, not {matrix.tolist()}")
    if matrix[0, 1] or matrix[1, 0] or (matrix[2] != (0, 0, 1)).any():
        raise CalibrationError(
            f"{name} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {matrix.tolist()}"
        )


def _open(path: str | PathLike[str]) -> cv2.FileStorage:
    """A file of OpenCV's FileStorage, read as a whole; raises CalibrationError."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MAX_FILE + 1)
        if len(data) > _MAX_FILE:
            raise CalibrationError(f"{path}: over {_MAX_FILE} bytes, no calibration file")
        check_nesting(data, path)
        return cv2.FileStorage(
            data.decode("utf-8"), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        )
    except OSError as error:
        why = error.strerror
        raise CalibrationError(f"cannot read the calibration {str(path)!r}: {why}") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(
            f"cannot read the calibration {str(path)!r}: it is no text in UTF-8"
        ) from error
    except (cv2.error, SystemError) as error:
        raise CalibrationError(f"{path}: neither YAML, XML nor JSON as OpenCV writes it") from error


def _matrix(storage: cv2.FileStorage, key: str, path: str | PathLike[str]) -> Array | None:
    """A matrix of at most _MAX_NUMBERS, None where there is no such key."""
    node = storage.getNode(key)
    if node.empty():
        return None
    try:
        size = node.getNode("rows").real() * node.getNode("cols").real() if node.isMap() else np.inf
        if size <= _MAX_NUMBERS:
            return np.array(node.mat(), np.float64)
    except (cv2.error, ValueError) as error:
        raise CalibrationError(f"{path}: {key} is a damaged matrix: {error}") from error
    raise CalibrationError(f"{path}: {key} must be a small matrix (!!opencv-matrix)")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CameraCalibration:
    """One camera from views of a flat board.

    matrix: (3, 3), px. distortion: (5,), k1 k2 p1 p2 k3, k3 = 0: a handful of views does not
    determine it. focal_sigma: standard deviation of the focal lengths, px. error: root mean
    square reprojection error, px. view_errors: (V,) the same by view.
    """

    matrix: Array
    distortion: Array
    focal_sigma: float
    error: float
    view_errors: Array


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StereoCalibration:
    """A rig from views of a flat board.

    error: root mean square reprojection error of both cameras, px. view_errors: (V, 2) the
    same by view, left and right. left, right: each camera by itself.
    """

    rig: StereoRig
    error: float
    view_errors: Array
    left: CameraCalibration
    right: CameraCalibration


def calibrate_camera(
    grids: Sequence[Grid], *, spacing: float, image_size: tuple[int, int]
) -> CameraCalibration:
    """Camera matrix and distortion from at least three views of a flat board.

    Partial views are welcome, their numbering does not matter. Each node weighs 1 / sigma^2.
    spacing: side of a square, any unit. image_size: (width, height), px.

    Raises CalibrationError where there are too few views or nodes, or the views do not
    determine the focal length (all seen from the front).
    """
    _check_spacing(spacing)
    parts = [_board(grid.xy, grid.valid, spacing, view) for view, grid in enumerate(grids)]
    _check_views(len(parts))
    try:
        error, matrix, distortion, turns, shifts, _, _, _ = cv2.calibrateCameraExtended(
            [board for board, _ in parts],
            [points for _, points in parts],
            image_size,
            np.eye(3),
            np.zeros(5),
            flags=cv2.CALIB_FIX_K3,
        )
    except cv2.error as failure:
        raise CalibrationError(f"the views do not determine a camera: {failure}") from failure
    poses = [
        cv2.projectPoints(board, turn, shift, matrix, distortion)[1]
        for (board, _), turn, shift in zip(parts, turns, shifts, strict=True)
    ]
    sigma = _focal_sigma(poses, float(error))
    if not sigma < _MAX_FOCAL_SIGMA * matrix[0, 0]:
        raise CalibrationError(
            f"the views leave the focal length uncertain by {sigma / matrix[0, 0]:.0%}: "
            "show the board tilted, in different directions"
        )
    views = [
        _view(board, turn, shift, grid)
        for (board, _), turn, shift, grid in zip(parts, turns, shifts, grids, strict=True)
    ]
    adjusted = adjust(views, _of_camera(matrix, distortion))
    return CameraCalibration(
        matrix=_matrix_of(adjusted.numbers),
        distortion=_distortion_of(adjusted.numbers),
        focal_sigma=sigma,
        error=_whole_error(adjusted, views),
        view_errors=adjusted.errors[:, 0],
    )


def _view(
    board: NDArray[np.float32],
    turn: ArrayLike,
    shift: ArrayLike,
    *grids: Grid,
    both: NDArray[np.bool_] | None = None,
) -> View:
    """A view of a board in one or two grids, at the nodes `both` or all."""
    chosen = [grid.valid if both is None else both for grid in grids]
    return View(
        board=board,
        seen=tuple(g.xy[v].astype(np.float64) for g, v in zip(grids, chosen, strict=True)),
        sigma=tuple(g.sigma[v].astype(np.float64) for g, v in zip(grids, chosen, strict=True)),
        pose=np.concatenate([_double(turn).reshape(-1), _double(shift).reshape(-1)]),
    )


def _of_camera(matrix: ArrayLike, distortion: ArrayLike) -> Array:
    """fx fy cx cy k1 k2 p1 p2."""
    k = _double(matrix)
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *_double(distortion).reshape(-1)[:4]])


def _matrix_of(numbers: Array) -> Array:
    fx, fy, cx, cy = numbers[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _distortion_of(numbers: Array) -> Array:
    return np.append(numbers[4:CAMERA], 0.0)


def _whole_error(adjusted: Adjusted, views: Sequence[View]) -> float:
    """The root mean square distance over all views and cameras, px."""
    counts = np.array([len(view.board) for view in views], np.float64)[:, None]
    mean = (np.square(adjusted.errors) * counts).sum() / (counts.sum() * adjusted.errors.shape[1])
    return float(math.sqrt(mean))


def _focal_sigma(jacobians: Sequence[NDArray[Any]], error: float) -> float:
    """Standard deviation of the less certain focal length, px, infinite where undetermined.

    OpenCV's own figure drops small singular values: of views all from the front it says 0.
    jacobians: of every view, as cv2.projectPoints returns them. error: rms distance, px.
    """
    free = []
    for jacobian in jacobians:
        pose, camera = jacobian[:, :6], jacobian[:, 6:14]  # fx fy cx cy k1 k2 p1 p2
        basis = np.linalg.qr(pose)[0]
        free.append(camera - basis @ (basis.T @ camera))
    stacked = np.concatenate(free)
    scale = np.linalg.norm(stacked, axis=0)
    _, singular, axes = np.linalg.svd(stacked / scale, full_matrices=False)
    if not singular[-1] > 0:
        return math.inf
    deviation = np.linalg.norm(axes[:, :2] / singular[:, None], axis=0) / scale[:2]
    return float(deviation.max() * error / math.sqrt(2))


def calibrate(
    views: Sequence[tuple[Grid, Grid]],
    *,
    spacing: float,
    image_size: tuple[int, int],
    unit: str = "mm",
) -> StereoCalibration:
    """A rig from at least three views (left, right) of a flat board, numbered alike in both.

    Each camera is calibrated by itself, then the pose between them, and last everything
    together. spacing: side of a square, in `unit`. image_size: (width, height) of either
    view, px.

    Raises CalibrationError as `calibrate_camera` does and where each camera fits its own
    views but no pose between the two fits all of them, FieldError where the grids of a view
    have different shapes.
    """
    for view, (left, right) in enumerate(views):
        if left.shape != right.shape:
            raise FieldError(
                f"view {view}: the grids have different shapes: {left.shape} and {right.shape}"
            )
    one = calibrate_camera([left for left, _ in views], spacing=spacing, image_size=image_size)
    two = calibrate_camera([right for _, right in views], spacing=spacing, image_size=image_size)
    pairs = [
        (
            _board(left.xy, left.valid & right.valid, spacing, view),
            _board(right.xy, left.valid & right.valid, spacing, view),
        )
        for view, (left, right) in enumerate(views)
    ]
    try:
        error, K1, D1, K2, D2, R, T, _, _, turns, shifts, _ = cv2.stereoCalibrateExtended(
            [left[0] for left, _ in pairs],
            [left[1] for left, _ in pairs],
            [right[1] for _, right in pairs],
            one.matrix.copy(),
            one.distortion.copy(),
            two.matrix.copy(),
            two.distortion.copy(),
            image_size,
            np.eye(3),
            np.zeros(3),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
        )
    except cv2.error as failure:
        raise CalibrationError(f"the views do not determine a rig: {failure}") from failure
    alone = max(one.error, two.error)
    if not error <= max(_MAX_MISFIT, _MAX_MISFIT_RATIO * alone):
        raise CalibrationError(
            f"no pose between the cameras fits the views: both together miss by {error:.1f} px, "
            f"each alone by {alone:.2f} px; check the shape of the board, and that left and "
            "right views are pairs"
        )
    whole = [
        _view(left[0], turn, shift, *grids, both=grids[0].valid & grids[1].valid)
        for (left, _), turn, shift, grids in zip(pairs, turns, shifts, views, strict=True)
    ]
    pose = np.concatenate([cv2.Rodrigues(R)[0].reshape(-1), _double(T).reshape(-1)])
    adjusted = adjust(whole, np.concatenate([_of_camera(K1, D1), _of_camera(K2, D2), pose]))
    cameras = [adjusted.numbers[k : k + CAMERA] for k in (0, CAMERA)]
    turned, shifted = np.split(adjusted.numbers[2 * CAMERA :], 2)
    return StereoCalibration(
        rig=StereoRig(
            _matrix_of(cameras[0]),
            _distortion_of(cameras[0]),
            _matrix_of(cameras[1]),
            _distortion_of(cameras[1]),
            _double(cv2.Rodrigues(turned)[0]),
            shifted,
            unit,
            adjusted.covariance,
        ),
        error=_whole_error(adjusted, whole),
        view_errors=adjusted.errors,
        left=one,
        right=two,
    )


def _double(value: ArrayLike) -> Array:
    return np.asarray(value, np.float64)


def _check_spacing(spacing: float) -> None:
    if not 0 < spacing < math.inf:
        raise CalibrationError(f"spacing must be a positive length, not {spacing!r}")


def _check_views(count: int) -> None:
    if count < _MIN_VIEWS:
        noun = "view" if count == 1 else "views"
        raise CalibrationError(f"{count} {noun} of the board, at least {_MIN_VIEWS} are needed")


def _board(
    xy: NDArray[np.float32], valid: NDArray[np.bool_], spacing: float, view: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Nodes of a view on the board (N, 3), in the unit of spacing, and in the image (N, 2)."""
    row, column = np.nonzero(valid)
    if len(row) < _MIN_NODES or len(set(row)) < 2 or len(set(column)) < 2:
        raise CalibrationError(
            f"view {view} shows {len(row)} nodes, at least {_MIN_NODES} in two rows and two "
            "columns are needed"
        )
    board = np.column_stack([column, row, np.zeros(len(row))]) * spacing
    return board.astype(np.float32), np.ascontiguousarray(xy[valid], np.float32)
