"""Calibrates one camera by OpenCV."""

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.space.calibration.adjustment import Look, State, covariance
from cmp_cl.space.lens import Lens, camera_of

# Share of the focal length; a larger sigma means that the views do not determine it.
_MAX_FOCAL_SIGMA = 0.05
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


def calibrate_alone(
    lens: Lens, looks: Sequence[Look], board: Array, size: tuple[int, int]
) -> Alone:
    """Calibrate one camera.

    looks: of that camera. board: (B, 3). size: (width, height), px. Raises CalibrationError if
    OpenCV finds no camera, or the views do not determine the focal length.
    """
    nodes = [np.ascontiguousarray(board[look.nodes][:, None], np.float32) for look in looks]
    points = [np.ascontiguousarray(look.xy[:, None], np.float32) for look in looks]
    try:
        with _one_thread():
            error, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                nodes, points, size, np.eye(3), np.zeros(lens.coefficients),
                flags=cv2.CALIB_RATIONAL_MODEL if lens is Lens.RATIONAL else cv2.CALIB_FIX_K3,
                criteria=_STOP,
            )  # fmt: skip
    except cv2.error as failure:
        raise CalibrationError(
            "the views do not determine the camera: show the board tilted, in different directions"
        ) from failure
    coefficients = distortion.ravel()[: lens.coefficients]
    camera = camera_of(np.asarray(matrix, "f8"), coefficients.astype("f8"), np.eye(3), np.zeros(3))
    poses = [np.r_[turn.ravel(), shift.ravel()] for turn, shift in zip(turns, shifts, strict=True)]
    numbered = [
        dataclasses.replace(look, camera=0, moment=moment) for moment, look in enumerate(looks)
    ]
    state = State(camera[None], np.array(poses), board)
    spread = covariance(numbered, state)
    sigma = math.inf if spread is None else math.sqrt(float(np.diag(spread)[:2].max()))
    if not sigma < _MAX_FOCAL_SIGMA * camera[0]:
        raise CalibrationError(
            f"the views leave the focal length uncertain by {sigma / camera[0]:.0%}: "
            "show the board tilted, in different directions"
        )
    moments = [look.moment for look in looks]
    return Alone(camera, dict(zip(moments, poses, strict=True)), float(error))


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Run OpenCV on one thread: with several, the last bits of its sums differ from run to run."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
