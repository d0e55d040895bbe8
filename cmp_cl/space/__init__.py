"""Two views of one pattern: calibration, and points in space."""

from cmp_cl.points import Points3D, PointStatus
from cmp_cl.space.calibration import (
    CameraCalibration,
    StereoCalibration,
    calibrate,
    calibrate_camera,
)
from cmp_cl.space.rig import StereoRig
from cmp_cl.space.split import BinocularSplit
from cmp_cl.space.triangulation import triangulate_points, undistort

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
