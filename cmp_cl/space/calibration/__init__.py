"""Calibrates one, two or more cameras on views of a board."""

from cmp_cl.space.calibration import advice as advice
from cmp_cl.space.calibration.calibrate import Calibration, Camera, calibrate

__all__ = ["Calibration", "Camera", "calibrate"]
