"""Measuring frames against a frame at rest, and finding patterns and boards.

`TwoViews` measures frames that hold two views, for example through mirrors; README.md has a loop.
`OneView` does the same with one camera, in the image or in the plane of a flat pattern. `Sensor` is
a loop in a thread, with the calls that PyTac3D's users know.
`find_board` returns the grids from which `cmp_cl.calibrate` makes the rig.
"""

from cmp_cl.measure.measured import Measured
from cmp_cl.measure.measurement import Measurement, Settings
from cmp_cl.measure.one_view import OneView
from cmp_cl.measure.patterns import align_views, find_board, find_pattern
from cmp_cl.measure.sensor import Sensor, pytac3d
from cmp_cl.measure.two_views import TwoViews

__all__ = [
    "Measured",
    "Measurement",
    "OneView",
    "Sensor",
    "Settings",
    "TwoViews",
    "align_views",
    "find_board",
    "find_pattern",
    "pytac3d",
]
