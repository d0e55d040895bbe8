"""From nodes in the views to positions: in space by two cameras, in the plane by one."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.motion.scale import PlaneScale
from cmp_cl.space import StereoRig, Window
from cmp_cl.space.lens import fold_of
from cmp_cl.space.rig import MAX_ERROR, MIN_PARALLAX

_COEFFICIENTS = 12  # of distortion, in kernels/space.cl
Array = NDArray[np.float64]


class InSpace:
    """Two cameras. radii: the edge radius of the left and of the right grid, px, NaN if unknown."""

    views, axes = 2, 3
    file = kernel = "space"
    width = 4  # nodes of a work-item on a CPU
    # Planes (R, C), px, that only this kernel writes
    own_results: Mapping[str, int] = {"misfit": 2}

    def __init__(self, rig: StereoRig, radii: Sequence[float]) -> None:
        self._rig, self._radii = rig, radii

    def defines(self, *, double: bool) -> dict[str, str | int]:
        """Return the macros that only these kernels need."""
        window = self._rig.window
        return {
            "MEDIA": 0 if window is None else len(window.layers) + 1,
            "NEAR": "1e-6" if double else "1e-4f",
            "SMALL": "1e-4" if double else "1e-2f",
            "TINY": "1e-300" if double else "1e-30f",
        }

    def constants(self) -> dict[str, Array]:
        """Return the arrays that the kernel takes, by name."""
        rig = self._rig
        return {
            "left": camera_numbers(rig.K1, rig.D1, np.eye(3), np.zeros(3), window=rig.window),
            "right": camera_numbers(rig.K2, rig.D2, rig.R, rig.T, window=rig.window),
        }

    def numbers(self, real: Any) -> dict[str, Any]:
        """Return the numbers that the kernel takes, by name."""
        focal = np.mean([np.diag(camera)[:2] for camera in (self._rig.K1, self._rig.K2)])
        left, right = map(_radius, self._radii)
        return {
            "least_sine": real(MIN_PARALLAX / focal),
            "largest_error": np.float32(MAX_ERROR),
            "radius_left": left,
            "radius_right": right,
        }


class InPlane:
    """One camera. radius: the edge radius of its grid, px, NaN if unknown."""

    views, axes = 1, 2
    file, kernel, width = "flat", "in_plane", 1
    own_results: Mapping[str, int] = {}

    def __init__(self, scale: PlaneScale, radius: float) -> None:
        self._scale, self._radius = scale, radius

    def defines(self, *, double: bool) -> dict[str, str | int]:
        """Return the macros that only this kernel needs: none."""
        return {}

    def constants(self) -> dict[str, Array]:
        """Return the arrays that the kernel takes, by name."""
        return {"homography": self._scale.matrix.ravel()}

    def numbers(self, real: Any) -> dict[str, Any]:
        """Return the number that the kernel takes, by name."""
        return {"radius": _radius(self._radius)}


def _radius(radius: float) -> np.float32:
    return np.float32(radius if radius >= 0 else 0)


def camera_numbers(
    matrix: Array, distortion: Array, rotation: Array, move: Array, *, window: Window | None = None
) -> Array:
    """Return a camera as kernels/space.cl takes it, (32,), and its window after it.

    rotation, move: from the frame of the left camera. window: before the camera; None is air.
    """
    coefficients = np.zeros(_COEFFICIENTS)
    coefficients[: len(distortion)] = distortion
    focal, middle, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2], -move @ rotation
    fold = np.sqrt([fold_of(coefficients)])
    numbers = [focal, middle, coefficients, rotation.ravel(), move, centre, fold]
    if window is not None:
        first = window.height(centre)
        media = [
            (thickness, index**2) for thickness, index in [*window.layers, (0.0, window.index)]
        ]
        numbers += [window.normal, np.array([first, first + window.thickness]), np.ravel(media)]
    return np.concatenate(numbers)
