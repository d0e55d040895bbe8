"""Calibrates a pair of cameras by OpenCV."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from cmp_cl.space.calibration.adjustment import Look, State
from cmp_cl.space.calibration.alone import STOP, lens_flags, one_thread
from cmp_cl.space.lens import Lens, camera_of, distortion_of, matrix_of, rotation_of


def adjust_pair(lens: Lens, looks: Sequence[Look], start: State, size: tuple[int, int]) -> State:
    """Adjust two pinhole or rational cameras, which see all moments, by cv2.stereoCalibrate.

    size: (width, height), px.
    """
    sides = [{look.moment: look for look in looks if look.camera == each} for each in (0, 1)]
    nodes, left, right = [], [], []
    for moment in sorted(sides[0]):
        one, two = sides[0][moment], sides[1][moment]
        both, first, second = np.intersect1d(one.nodes, two.nodes, return_indices=True)
        nodes.append(start.board[both].astype(np.float32))
        left.append(one.xy[first].astype(np.float32))
        right.append(two.xy[second].astype(np.float32))
    lenses = [(matrix_of(each), distortion_of(each).copy()) for each in start.cameras]
    pose = rotation_of(start.cameras[1]), start.cameras[1, -3:, None].copy()
    found: Any
    with one_thread():
        _, *found = cv2.stereoCalibrateExtended(
            nodes, left, right, *lenses[0], *lenses[1], size, *pose,
            flags=lens_flags(lens) | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=STOP,
        )  # fmt: skip
    K1, D1, K2, D2, R, T, _, _, turns, shifts, _ = found
    still = np.eye(3), np.zeros(3)
    cameras = [
        camera_of(matrix, distortion.ravel()[: lens.coefficients], turn, np.ravel(shift))
        for matrix, distortion, (turn, shift) in ((K1, D1, still), (K2, D2, (R, T)))
    ]
    poses = [np.r_[turn.ravel(), shift.ravel()] for turn, shift in zip(turns, shifts, strict=True)]
    return State(np.array(cameras), np.array(poses), start.board)
