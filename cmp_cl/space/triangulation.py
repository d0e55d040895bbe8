"""Pixels become rays here, and two rays become a point."""

import cv2
import numpy as np
from numpy.typing import NDArray

# Px: largest distance of a pixel from itself after undistortion and distortion.
_MAX_ROUND_TRIP = 0.01
_UNDISTORT = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
Array = NDArray[np.float64]


def undistort(points: Array, matrix: Array, distortion: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Map pixels to the plane at distance 1 in front of the camera.

    points: (N, 2), px. matrix, distortion: of the camera, as in `StereoRig`. Returns (N, 2)
        float64, and a mask (N,), True if distortion of the result leads back to the pixel. If it
        does not, the lens model cannot be inverted there.
    """
    measured = points.reshape(-1, 1, 2)
    if not len(measured):
        return np.empty((0, 2)), np.empty(0, bool)
    straight = cv2.undistortImagePoints(measured, matrix, distortion, None, _UNDISTORT)
    straight = straight.reshape(-1, 2)
    ideal = (straight - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    back, _ = cv2.projectPoints(rays_through(ideal), np.zeros(3), np.zeros(3), matrix, distortion)
    error = np.linalg.norm(back.reshape(-1, 2) - measured.reshape(-1, 2), axis=1)
    return ideal, error < _MAX_ROUND_TRIP


def between(one: Array, two: Array, centre: Array) -> Array:
    """Return the middle of the shortest segment between two rays, (N, 3), NaN where parallel.

    one, two: their directions, (N, 3). The first ray begins at the origin, the second at `centre`,
    (3,) or (N, 3). The middle has nearly the least reprojection error.
    """
    own, both, other, ahead_one, ahead_two = (
        (first * second).sum(axis=1)
        for first, second in ((one, one), (one, two), (two, two), (one, centre), (two, centre))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        shared = own * other - np.square(both)
        depth_one = (ahead_one * other - both * ahead_two) / shared
        depth_two = (both * ahead_one - own * ahead_two) / shared
        points = (depth_one[:, None] * one + depth_two[:, None] * two + centre) / 2
    return np.where(np.isfinite(points), points, np.nan)


def rays_through(points: Array) -> Array:
    """Return the rays (N, 3), with z = 1, through points (N, 2) of the plane at distance 1."""
    return np.column_stack([points, np.ones(len(points))])


def points_by_image(slopes: Array) -> Array:
    """Return the derivatives of points by the pixels of both views, (N, 3, 4), for the least
    squares of the reprojection; slopes: those of the pixels by the points, (N, 4, 3)."""
    turned = slopes.transpose(0, 2, 1)
    by_image: Array = np.linalg.inv(turned @ slopes) @ turned
    return by_image
