"""Two views of one pattern: calibration, and points in space."""

from cmp_cl.stereo.points import Points3D, PointStatus
from cmp_cl.stereo.rig import (
    BinocularSplit,
    CameraCalibration,
    StereoCalibration,
    StereoRig,
    calibrate,
    calibrate_camera,
    triangulate_points,
    undistort,
)

__all__ = [
    "BinocularSplit",
    "CameraCalibration",
    "PointStatus",
    "Points3D",
    "StereoCalibration",
    "StereoRig",
    "calibrate",
    "calibrate_camera",
    "triangulate_points",
    "undistort",
]
