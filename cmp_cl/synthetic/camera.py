"""The cameras that look at the gel, and the pose of the gel in front of them."""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from cmp_cl.errors import ConfigError, check_shape
from cmp_cl.space import StereoRig, Window
from cmp_cl.space.rig import between
from cmp_cl.synthetic.raster import Array
from cmp_cl.synthetic.scene import Scene

DISTANCE = 45.0  # mm from the camera to the gel, with one camera
_HALVINGS = 40  # of the range of a sine: below 1e-8 px
FILL = 0.92  # share of the shorter image side that the pattern covers


def default_rig(shape: tuple[int, int] = (1200, 800)) -> StereoRig:
    """Return two cameras 16 mm apart whose axes meet 45 mm away.

    shape: (rows, columns) of each view, px. The pattern of a default scene covers 92 % of the
        shorter side. Raises ConfigError if it is not two whole numbers from 1.
    """
    check_shape(shape, ConfigError)
    rows, columns = shape
    focal = FILL * min(shape) / 32.0 * DISTANCE
    half = math.atan2(8.0, DISTANCE)
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
    rotation = rotation_matrix(0.0, 2 * half, 0.0)
    centre = np.array([0.0, 0.0, math.hypot(8.0, DISTANCE)])
    return StereoRig(
        K1=matrix,
        D1=np.array([-0.06, 0.02, 0.0004, -0.0003, 0.0]),
        K2=matrix + np.array([[3.0, 0, 2.0], [0, 3.0, -1.5], [0, 0, 0]]),
        D2=np.array([-0.05, 0.015, -0.0003, 0.0005, 0.0]),
        R=rotation,
        T=centre - rotation @ centre,
    )


class PinholeCamera:
    """A pinhole camera with OpenCV's distortion k1 k2 p1 p2 k3.

    window: before it; None is air.
    """

    def __init__(
        self,
        matrix: Array,
        distortion: Array,
        R: Array,
        T: Array,
        window: Window | None = None,
    ) -> None:
        if np.any(distortion[5:]):
            raise ConfigError(
                f"rendering knows the distortion k1 k2 p1 p2 k3 only, not {distortion.tolist()}"
            )
        self.matrix, self.distortion, self.R, self.T = matrix, distortion[:5], R, T
        self.window = window

    def project(self, points: Array) -> Array:
        """Project points (..., 3), mm, to (..., 2), px; NaN in front of the window's last face."""
        if self.window is not None:
            points = straightened(self.window, -self.T @ self.R, points)
        seen = points @ self.R.T + self.T
        x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
        if np.any(self.distortion):
            k1, k2, p1, p2, k3 = self.distortion
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            )
        (fx, _, cx), (_, fy, cy), _ = self.matrix
        return np.stack([fx * x + cx, fy * y + cy], axis=-1)


def straightened(window: Window, centre: Array, points: Array) -> Array:
    """Return points (..., 3) on the straight rays by which a camera at `centre` sees points.

    The ray of a point with the sine s in air has the sine s / n in a medium of index n, and moves
    sideways by s / sqrt(n^2 - s^2) per depth there. All media together move it by the lateral
    distance of the point; s is found by bisection.
    """
    across = points - centre
    depth = across @ window.normal
    across = across - depth[..., None] * window.normal
    lateral = np.linalg.norm(across, axis=-1)
    height = window.distance - centre @ window.normal
    behind = depth - height - sum(thickness for thickness, _ in window.layers)
    media: list[tuple[Any, float]] = [*window.layers, (behind, window.index)]
    low, high = np.zeros_like(depth), np.ones_like(depth)
    for _ in range(_HALVINGS):
        s = (low + high) / 2
        reach = height * s / np.sqrt(1 - s * s)
        for thickness, index in media:
            reach += thickness * s / np.sqrt(index**2 - s * s)
        short = reach < lateral
        low, high = np.where(short, s, low), np.where(short, high, s)
    tangent = np.where(behind >= 0, low / np.sqrt(1 - low * low), np.nan)
    stretch = depth * tangent / np.maximum(lateral, 1e-300)
    straight: Array = centre + depth[..., None] * window.normal + stretch[..., None] * across
    return straight


class Pose(NamedTuple):
    """The pose of the gel in the frame of the left camera."""

    axes: Array
    origin: Array

    @classmethod
    def of(cls, scene: Scene, axes: Array, centre: Array, focal: float) -> "Pose":
        """Apply the scene's rotation, tilt and position to a gel that faces the camera."""
        tilt = rotation_matrix(scene.tilt[0], scene.tilt[1], 0.0)
        rotation = rotation_matrix(0.0, 0.0, scene.rotation)
        translation = np.array([scene.position[0], scene.position[1], 0.0]) * centre[2] / focal
        return cls(axes @ tilt @ rotation, centre + axes @ translation)

    def place(self, points: Array) -> Array:
        """Map points (..., 3) from the gel's frame to the left camera's, mm."""
        return points @ self.axes.T + self.origin


def facing_both(R: Array, T: Array) -> tuple[Array, Array]:
    """Return the axes (columns) and the origin of a gel that faces both cameras.

    Both are in the frame of the left camera.
    """
    eye = -R.T @ T
    ahead, other = np.array([0.0, 0.0, 1.0]), R[2]
    normal = ahead + other
    normal /= np.linalg.norm(normal)
    centre = between(ahead[None], other[None], eye)[0]
    if 1 - (ahead @ other) ** 2 < 1e-6 or min(centre[2], (centre - eye) @ other) <= 0:
        centre = eye / 2 + DISTANCE * normal
    across = np.array([1.0, 0.0, 0.0])
    across -= (across @ normal) * normal
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal], axis=1), centre


def rotation_matrix(x: float, y: float, z: float) -> Array:
    """Return the rotation matrix of a rotation vector, rad."""
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0], dtype=np.float64)
