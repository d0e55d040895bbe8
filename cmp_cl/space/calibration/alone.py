"""Calibrates one camera by OpenCV."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.space.calibration.adjustment import Look, State, covariance
from cmp_cl.space.lens import Lens, camera_of

# Share of the focal length; a larger sigma means that the views do not determine it.
_MAX_FOCAL_SIGMA = 0.05
# Focal lengths from which a fisheye is sought, in image widths per half turn.
_FISHEYE_STARTS = (1.0, 1.25, 1.6, 0.8, 2.0)
_FOUND = 1.0  # px; a fisheye that misses by less needs no other start
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Alone:
    """A camera, calibrated alone.

    camera: its parameters, at the origin. poses: by moment, the pose of the board (6,).
    error: root mean square reprojection error, px.
    """

    camera: Array
    poses: Mapping[int, Array]
    error: float


def calibrate_alone(name: str, lens: Lens, looks: Sequence[Look], size: tuple[int, int]) -> Alone:
    """Calibrate one camera.

    name: for messages. looks: of that camera. size: (width, height), px. Raises CalibrationError if
    OpenCV finds no camera, or the views do not determine the focal length.
    """
    nodes = [np.ascontiguousarray(look.nodes[:, None], np.float32) for look in looks]
    points = [np.ascontiguousarray(look.xy[:, None], np.float32) for look in looks]
    cure = "show the board tilted, in different directions"
    if lens is Lens.RATIONAL:
        cure += "; or choose the lens pinhole, which suits a lens of little distortion"
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # with several, the last bits of OpenCV's sums differ from run to run
    try:
        if lens is Lens.FISHEYE:
            error, matrix, distortion, turns, shifts = _fisheye(nodes, points, size)
        else:
            error, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                nodes, points, size, np.eye(3), np.zeros(lens.coefficients),
                flags=cv2.CALIB_RATIONAL_MODEL if lens is Lens.RATIONAL else cv2.CALIB_FIX_K3,
                criteria=_STOP,
            )  # fmt: skip
    except cv2.error as failure:
        raise CalibrationError(
            f"{name}: the views do not determine the camera: {cure}"
        ) from failure
    finally:
        cv2.setNumThreads(threads)
    coefficients = distortion.ravel()[: lens.coefficients]
    camera = camera_of(np.asarray(matrix, "f8"), coefficients.astype("f8"), np.eye(3), np.zeros(3))
    poses = [np.r_[turn.ravel(), shift.ravel()] for turn, shift in zip(turns, shifts, strict=True)]
    numbered = [
        dataclasses.replace(look, camera=0, moment=moment) for moment, look in enumerate(looks)
    ]
    spread = covariance(numbered, State(camera[None], np.array(poses), np.zeros(0)))
    if spread is None:
        raise CalibrationError(f"{name}: the views do not determine the camera: {cure}")
    share = math.sqrt(float(np.diag(spread)[:2].max())) / camera[0]
    if not share < _MAX_FOCAL_SIGMA:
        raise CalibrationError(
            f"{name}: the views leave the focal length uncertain by {share:.0%}: {cure}"
        )
    moments = [look.moment for look in looks]
    return Alone(camera, dict(zip(moments, poses, strict=True)), float(error))


def _fisheye(nodes: Sequence[Any], points: Sequence[Any], size: tuple[int, int]) -> Any:
    """Run cv2.fisheye.calibrate from several focal lengths; return the best result.

    A start far from the truth ends in an error or in a wrong minimum.
    """
    best, failure = None, None
    names = "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW", "CALIB_USE_INTRINSIC_GUESS"
    # OpenCV 5 moved these flags out of cv2.fisheye.
    flags = sum(getattr(cv2.fisheye, name, getattr(cv2, name, 0)) for name in names)
    for start in _FISHEYE_STARTS:
        focal = start * max(size) / math.pi
        centre = size[0] / 2 - 0.5, size[1] / 2 - 0.5
        matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        try:
            found = cv2.fisheye.calibrate(
                [each.astype(np.float64).reshape(1, -1, 3) for each in nodes],
                [each.astype(np.float64).reshape(1, -1, 2) for each in points],
                size, matrix, np.zeros((4, 1)), flags=flags, criteria=_STOP,
            )  # fmt: skip
        except cv2.error as error:
            failure = error
            continue
        if best is None or found[0] < best[0]:
            best = found
        if best[0] < _FOUND:
            break
    if best is None:
        assert failure is not None
        raise failure
    return best
