"""Measuring frames against a frame at rest, and finding patterns and boards.

This gives a field for every frame of a video with two views side by side, for example through
mirrors:

    import cmp_cl

    rig = cmp_cl.StereoRig.load("rig.yaml")
    frames = cmp_cl.media.read_frames("press.mp4")
    rest = next(frames).image
    split = cmp_cl.BinocularSplit.halves(width=rest.shape[1], height=rest.shape[0])
    with cmp_cl.measure.TwoViews(rest, rig, split, shape=(40, 40)) as measure:
        for frame in frames:
            if frame.image is not None:
                measure(frame.image).field.save(f"press-{frame.index:04}.vtp")

`OneView` does the same with one camera, in the image or in the plane of a flat pattern. `Sensor` is
a loop in a thread, with the calls that PyTac3D's users know.
`find_board` returns the grids from which `cmp_cl.calibrate` makes the rig.
"""

from cmp_cl.measure.measured import Measured, Tally
from cmp_cl.measure.measurement import Measurement, Settings
from cmp_cl.measure.one_view import OneView
from cmp_cl.measure.patterns import (
    align_views,
    find_board,
    find_pattern,
)
from cmp_cl.measure.sensor import Sensor, pytac3d
from cmp_cl.measure.two_views import TwoViews

__all__ = [
    "Measured",
    "Measurement",
    "OneView",
    "Sensor",
    "Settings",
    "Tally",
    "TwoViews",
    "align_views",
    "find_board",
    "find_pattern",
    "pytac3d",
]
