"""Pixels become rays here, and two rays become a point."""

import cv2
import numpy as np
from numpy.typing import NDArray

# Px: largest distance of a pixel from itself after undistortion and distortion.
_MAX_ROUND_TRIP = 0.01
_TINY = 1e-300
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


def triangulate_points(rotation: Array, translation: Array, left: Array, right: Array) -> Array:
    """Triangulate from two views.

    Sampson's step moves the image points onto each other's epipolar lines. The result is the middle
    of the shortest segment between their rays, which has the least reprojection error to first
    order.

    rotation: (3, 3), translation: (3,): X_right = R X_left + T. left, right: (N, 2) float64, in
    the planes at distance 1. Returns (N, 3) float64 in the frame of the left camera, NaN where the
    rays are parallel.
    """
    essential = np.cross(np.eye(3), translation) @ rotation
    one, two = rays_through(left), rays_through(right)
    line_one, line_two = two @ essential, one @ essential.T
    square = np.square(line_one[:, :2]).sum(axis=1) + np.square(line_two[:, :2]).sum(axis=1)
    step = ((line_one * one).sum(axis=1) / np.maximum(square, _TINY))[:, None]
    one[:, :2] -= step * line_one[:, :2]
    two[:, :2] -= step * line_two[:, :2]
    two = two @ rotation
    centre = -translation @ rotation
    return between(one, two, centre)


def between(one: Array, two: Array, centre: Array) -> Array:
    """Return the middle of the shortest segment between two rays, (N, 3), NaN where parallel.

    one, two: their directions, (N, 3). The first ray begins at the origin, the second at `centre`,
    (3,) or (N, 3).
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


def inverse_symmetric(matrices: Array) -> Array:
    """Return the inverses of symmetric matrices (N, 3, 3), each its adjugate over its determinant.

    np.linalg.inv takes ten times as long for many of them.
    """
    (a, b, c), (_, d, e), (_, _, f) = matrices.transpose(1, 2, 0)
    one, two, three = d * f - e * e, c * e - b * f, b * e - c * d
    adjugate = np.array(
        [
            [one, two, three],
            [two, a * f - c * c, b * c - a * e],
            [three, b * c - a * e, a * d - b * b],
        ]
    )
    inverse: Array = (adjugate / (a * one + b * two + c * three)).transpose(2, 0, 1)
    return inverse


def points_by_image(slopes: Array) -> Array:
    """Return the derivatives of points by the pixels of both views, (N, 3, 4), for the least
    squares of the reprojection; slopes: those of the pixels by the points, (N, 4, 3)."""
    turned = slopes.transpose(0, 2, 1)
    by_image: Array = inverse_symmetric(turned @ slopes) @ turned
    return by_image
