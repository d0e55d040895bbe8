"""Two views of one pattern: calibration, and points in space."""

from cmp_cl.points import Points3D, PointStatus
from cmp_cl.space import exports as exports
from cmp_cl.space.bias import Bias
from cmp_cl.space.calibration import Calibration, Camera, calibrate
from cmp_cl.space.lens import Lens
from cmp_cl.space.refraction import calibrate_window
from cmp_cl.space.rig import StereoRig
from cmp_cl.space.split import BinocularSplit
from cmp_cl.space.window import Window

__all__ = [
    "Bias",
    "BinocularSplit",
    "Calibration",
    "Camera",
    "Lens",
    "PointStatus",
    "Points3D",
    "StereoRig",
    "Window",
    "calibrate",
    "calibrate_window",
]
