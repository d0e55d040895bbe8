"""Cameras of each lens, for the tests of calibration and of its files."""

import cv2
import numpy as np

from cmp_cl.space import Camera, Lens

SIZE = (640, 480)
MATRIX = np.array([[420.0, 0, 325], [0, 418.0, 236], [0, 0, 1]])
DISTORTIONS = {
    Lens.PINHOLE: np.array([-0.1, 0.03, 0.001, -0.0005, 0]),
    Lens.RATIONAL: np.array([0.3, 0.05, 0.0005, -0.0005, 0.01, 0.42, 0.08, 0.02]),
    Lens.FISHEYE: np.array([0.05, -0.01, 0.004, -0.001]),
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
