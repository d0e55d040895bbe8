"""The lens models: the projection through them with its derivatives, and the rays of pixels.

The parameters of a camera are one vector: fx, fy, cx, cy, the coefficients of distortion, then its
pose, a rotation vector and a translation: X = R X_first + T.
"""

import enum

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import CalibrationError, as_numbers

Array = NDArray[np.float64]

POSE = 6  # rotation vector, translation
_LARGEST = 1e12  # px, or of a unit of length; the squares of larger numbers may overflow
ESTIMATED = 8  # parameters of a pinhole that are estimated: fx fy cx cy k1 k2 p1 p2
_MAX_ROUND_TRIP = 0.01  # px, of a pixel from itself after undistortion and distortion
_UNDISTORT = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-9)


class Lens(enum.Enum):
    """The lens model of a camera, in OpenCV's terms.

    PINHOLE: k1 k2 p1 p2 k3 with k3 = 0. RATIONAL: k1 k2 p1 p2 k3 k4 k5 k6. FISHEYE: the
    equidistant model of cv2.fisheye, k1 k2 k3 k4.
    """

    PINHOLE = "pinhole"
    RATIONAL = "rational"
    FISHEYE = "fisheye"

    @property
    def coefficients(self) -> int:
        """Return the number of coefficients of distortion; it tells the lenses apart."""
        return {Lens.PINHOLE: 5, Lens.RATIONAL: 8, Lens.FISHEYE: 4}[self]


def camera_of(matrix: Array, distortion: Array, rotation: Array, translation: Array) -> Array:
    """Return the parameters of a camera; rotation: (3, 3)."""
    focal, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    turn = cv2.Rodrigues(rotation)[0].ravel()
    return np.concatenate([focal, centre, distortion, turn, translation])


def matrix_of(camera: Array) -> Array:
    """Return the camera matrix (3, 3) of a camera's parameters."""
    fx, fy, cx, cy = camera[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def distortion_of(camera: Array) -> Array:
    """Return the coefficients of distortion of a camera's parameters."""
    return camera[4:-POSE]


def rotation_of(camera: Array) -> Array:
    """Return the rotation matrix (3, 3) of a camera's pose, or of a pose alone."""
    return np.asarray(cv2.Rodrigues(camera[-POSE:-3])[0], np.float64)


def unknowns(cameras: Array) -> NDArray[np.bool_]:
    """Return which parameters of cameras (C, P) are unknown: not k3 of a pinhole, and not the pose
    of the first camera."""
    free = np.ones(cameras.shape, np.bool_)
    if cameras.shape[1] == 4 + Lens.PINHOLE.coefficients + POSE:
        free[:, ESTIMATED] = False
    free[0, -POSE:] = False
    return free


def projected(points: Array, camera: Array) -> tuple[Array, Array]:
    """Project points by a camera.

    points: (N, 3), in the frame of the first camera. camera: its parameters, (P,). Returns the
    pixels (N, 2), and their derivatives by the parameters, (N, 2, P).
    """
    if not len(points):  # OpenCV gives no derivatives
        return np.empty((0, 2)), np.empty((0, 2, len(camera)))
    pose, model = (camera[-POSE:-3], camera[-3:]), (matrix_of(camera), distortion_of(camera))
    if len(model[1]) == Lens.FISHEYE.coefficients:
        seen, slopes = cv2.fisheye.projectPoints(points[:, None], *pose, *model)
        by_camera = slopes[:, :-1]  # the last one is the skew
    else:
        seen, slopes = cv2.projectPoints(points[:, None], *pose, *model)
        by_camera = np.hstack([slopes[:, POSE:], slopes[:, :POSE]])
    by_camera = np.asarray(by_camera, np.float64).reshape(len(points), 2, -1)
    return np.asarray(seen, np.float64).reshape(-1, 2), by_camera


def rays_of(pixels: Array, matrix: Array, distortion: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the rays of pixels (N, 2), through points of the plane at distance 1: (N, 3), z = 1.

    matrix, distortion: of the camera, as in `cmp_cl.space.StereoRig`. The mask (N,) is True where
    distortion of the result leads back to the pixel, and the result is not beyond `fold_of`. Else
    the lens model cannot be inverted there.
    """
    if not len(pixels):
        return np.empty((0, 3)), np.empty(0, bool)
    straight = cv2.undistortImagePoints(pixels[:, None], matrix, distortion, None, _UNDISTORT)
    ideal = (straight.reshape(-1, 2) - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    rays = np.column_stack([ideal, np.ones(len(ideal))])
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, distortion)
    near = np.linalg.norm(back.reshape(-1, 2) - pixels, axis=1) < _MAX_ROUND_TRIP
    return rays, near & (np.square(ideal).sum(axis=1) < fold_of(distortion))


def fold_of(distortion: Array) -> float:
    """Return the square of the radius, in the plane at distance 1, at which a lens model turns
    back: beyond it, pixels of other rays come again. 1e12 if it does not before 88 degrees.

    The radius of a pixel is r N(r^2) / D(r^2), with 1 k1 k2 k3 the coefficients of N, 1 k4 k5 k6
    those of D. Where both nearly share a root, as in fits of rational lenses, there is a pole of
    less than a degree, beyond which the model is right again: a median of five passes over it.
    """
    k1, k2, _, _, k3, k4, k5, k6 = np.pad(distortion, (0, 8))[:8]

    def seen(angle: Array) -> Array:
        radius = np.tan(np.radians(angle))
        square = radius * radius
        above, below = (np.polyval(each, square) for each in ([k3, k2, k1, 1], [k6, k5, k4, 1]))
        return np.asarray(radius * above / below, np.float64)

    angle = np.arange(0, 88.1, 0.5)
    extended = np.pad(seen(angle), 2, mode="reflect", reflect_type="odd")
    falls = np.diff(np.median(sliding_window_view(extended, 5), axis=1)) < 0
    if not falls.any():
        return _LARGEST
    fine = np.linspace(-1.0, 1.5, 1001) + angle[np.argmax(falls)]
    return float(np.square(np.tan(np.radians(fine[np.argmax(seen(fine))]))))


def checked_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return an argument of that name as a new array; raises CalibrationError unless it has that
    shape and no number is NaN or larger than any camera has."""
    array = as_numbers(name, value, CalibrationError)
    if shape == (3,) and array.shape in ((3, 1), (1, 3)):
        array = array.reshape(3)
    if array.shape != shape:
        raise CalibrationError(f"{name} must have shape {shape}, not {array.shape}")
    if not (np.abs(array) <= _LARGEST).all():
        raise CalibrationError(
            f"{name} must be finite and at most {_LARGEST:g}, not {array.tolist()}"
        )
    return array


def checked_distortion(name: str, value: ArrayLike) -> Array:
    """Return coefficients of distortion, at least 5; raises CalibrationError for another number
    than OpenCV takes, or for those of a tilted sensor, 14."""
    array = as_numbers(name, value, CalibrationError)
    size = array.size
    if size not in (0, 4, 5, 8, 12):
        raise CalibrationError(f"{name} must have 0, 4, 5, 8 or 12 coefficients, not {size}")
    return np.pad(checked_array(name, array.reshape(-1), (size,)), (0, max(5 - size, 0)))


def check_matrix(name: str, matrix: Array) -> None:
    """Raise CalibrationError if a matrix (3, 3) of that name is not that of a camera."""
    others = matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]]
    if min(matrix[0, 0], matrix[1, 1]) <= 0 or (others != (0, 0, 0, 0, 1)).any():
        raise CalibrationError(
            f"{name} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0, not "
            f"{matrix.tolist()}"
        )
