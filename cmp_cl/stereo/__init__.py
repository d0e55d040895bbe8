"""Two views of one pattern: calibration, and points in space."""

from cmp_cl.stereo.calibration import (
    CameraCalibration,
    StereoCalibration,
    calibrate,
    calibrate_camera,
)
from cmp_cl.stereo.points import Points3D, PointStatus
from cmp_cl.stereo.rig import StereoRig
from cmp_cl.stereo.split import BinocularSplit
from cmp_cl.stereo.triangulation import triangulate_points, undistort

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
