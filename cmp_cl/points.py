"""Points in space from two views."""

import dataclasses
import enum
from typing import Any

import numpy as np
from numpy.typing import NDArray


class PointStatus(enum.IntEnum):
    """Whether a node was triangulated, and if not, why."""

    MISSING = 0  #: a view does not show the node
    VALID = 1  #: the node has a position
    PARALLEL = 2  #: the rays enclose too small an angle: no disparity, or along the baseline
    BEHIND = 3  #: the point lies behind a camera, or in front of the last face of the window
    INCONSISTENT = 4  #: the reprojection error is too large, or the lens cannot be inverted


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Points3D:
    """Triangulated nodes, in the frame of the left camera.

    xyz: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    error: (R, C) float64, reprojection error, px: root mean square over both views.
        INCONSISTENT nodes may keep it.
    covariance: (R, C, 3, 3) float64, of xyz, in `unit` squared. It propagates the corners'
        standard deviations alone; NaN where those are unknown.
    bend_shift: (R, C, 3) float64, in `unit`: the shift of the points by bent edges, see
        `cmp_cl.fits.bend_shift`. `displacement` subtracts it from the points that it
        filters. None if unknown.
    status: (R, C) uint8 of `PointStatus`.
    source: (R, C) uint8 of `NodeStatus`, the less direct one of the two views.
    unit: name of the unit of length.
    """

    xyz: NDArray[np.float64]
    error: NDArray[np.float64]
    covariance: NDArray[np.float64]
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    unit: str
    bend_shift: NDArray[np.float64] | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where a node has a position."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Return the standard deviation along the most uncertain axis, (R, C) float64, in `unit`,
        by the noise of the corners. All nodes share what the rig errs by, and it nearly cancels in
        displacements, see `cmp_cl.space.Bias`."""
        return largest_deviation(self.covariance)


def largest_deviation(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the root of the largest eigenvalue of covariances (..., D, D), D = 2 or 3; NaN stays.

    For D = 3, with C = m I + s B, trace B = 0 and |B|^2 = 6, it is
    m + 2 s cos(acos(det B / 2) / 3).
    """
    size = covariance.shape[-1]
    planes = np.ascontiguousarray(np.moveaxis(covariance, (-2, -1), (0, 1)))
    mean = np.einsum("kk...->...", planes) / size
    if size == 2:
        half = (planes[0, 0] - planes[1, 1]) / 2
        return np.asarray(np.sqrt(mean + np.hypot(half, planes[0, 1])), np.float64)
    a, b, c = (planes[k, k] - mean for k in range(3))
    d, e, f = planes[1, 2], planes[0, 2], planes[0, 1]
    square = (a * a + b * b + c * c) / 6 + (d * d + e * e + f * f) / 3
    spread = np.sqrt(square)
    determinant = a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e)
    cosine = determinant / np.where(spread == 0, 1, 2 * square * spread)
    angle = np.arccos(np.clip(cosine, -1, 1)) / 3
    deviation: NDArray[np.float64] = np.sqrt(mean + 2 * spread * np.cos(angle))
    return deviation


def sides(at: NDArray[Any]) -> NDArray[np.float64]:
    """Return the known distances between neighbouring nodes of a lattice (R, C, D), (N,)."""
    ways = [np.linalg.norm(np.diff(at, axis=axis), axis=2).ravel() for axis in (0, 1)]
    lengths: NDArray[np.float64] = np.concatenate(ways)
    return lengths[np.isfinite(lengths)]


def corners_of_cells(values: NDArray[Any]) -> list[NDArray[Any]]:
    """Return the values (R, C, ...) at the four nodes of each cell, (R - 1, C - 1, ...) each, in
    turn around it."""
    return [values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]]


def of_cells(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the mean of the values (R, C, ...) at the four nodes of each cell, (R - 1, C - 1,
    ...)."""
    mean: NDArray[np.float64] = np.mean(corners_of_cells(values), axis=0)
    return mean
