"""Points in space that two views show."""

import dataclasses
import enum

import numpy as np
from numpy.typing import NDArray


class PointStatus(enum.IntEnum):
    """Why a triangulated node is there or not."""

    MISSING = 0  # a side has no position
    VALID = 1
    PARALLEL = 2  # the rays enclose too small an angle: no disparity, or along the baseline
    BEHIND = 3  # behind a camera
    INCONSISTENT = 4  # the two positions do not belong together, or the lens model ends there


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Points3D:
    """Triangulated nodes, in the frame of the left camera.

    xyz: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    error: (R, C) float64, root mean square over both views of the distance between the
        measured and the reprojected position, px; INCONSISTENT nodes may keep it.
    covariance: (R, C, 3, 3) float64, of xyz, in `unit` squared: the corners' standard
        deviations through the geometry, without the calibration's own error; NaN where
        those are unknown.
    calibration_covariance: (R, C, 3, 3) float64, what the error of the calibration adds, which
        all nodes share and displacements hardly feel; None where the rig knows none.
    status: (R, C) uint8 of `PointStatus`.
    source: (R, C) uint8 of `NodeStatus`, of the two sides the less direct one.
    unit: name of the unit of length.
    """

    xyz: NDArray[np.float64]
    error: NDArray[np.float64]
    covariance: NDArray[np.float64]
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    unit: str
    calibration_covariance: NDArray[np.float64] | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(R, C), where there is a position."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(R, C) float64, standard deviation along the most uncertain axis, in `unit`, with
        that of the calibration where it is known.
        """
        if self.calibration_covariance is None:
            return largest_deviation(self.covariance)
        return largest_deviation(self.covariance + self.calibration_covariance)


def largest_deviation(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Square root of the largest eigenvalue: (..., 3, 3) -> (...), NaN stays NaN."""
    known = np.isfinite(covariance).all(axis=(-2, -1))
    deviation = np.full(known.shape, np.nan)
    deviation[known] = np.sqrt(np.linalg.eigvalsh(covariance[known])[:, -1].clip(0))
    return deviation
