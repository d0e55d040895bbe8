"""calibrate through a window, and run with what it wrote, on small rendered frames."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from gels import board_frame
from messages import fails_in_one_line

from cmp_cl import StereoRig, Window
from cmp_cl.synthetic import Scene, binocular_frame, default_rig, render_stereo

VIEW = (320, 270)
AIR = default_rig(VIEW)
BEHIND = dataclasses.replace(AIR, window=Window(AIR.R[2] + (0, 0, 1), 20.0, ((5.0, 1.49),), 1.41))
TILTS = (0.4, 0.1), (-0.3, 0.3), (0.1, -0.45), (-0.4, -0.2), (0.2, 0.3), (-0.2, -0.4)
BOARD = "--stereo", "--board", "12x12", "--square", "2", "--out", "rig.yaml"
THROUGH = "--rest", "rest.png", "--grid", "20x20", "--pitch", "0.8"


def test_a_press_behind_a_window_is_measured_with_the_rig_that_calibrate_writes(run):
    views = [f"{number}.png" for number in range(len(TILTS))]
    for number, (name, tilt) in enumerate(zip(views, TILTS, strict=True)):
        cv2.imwrite(name, board_frame(number, tilt, AIR, VIEW))
    press = Scene(markers=20, side=16.8, severity=0.5, seed=3, shape=VIEW, corrosion=0.0, noise=1.0)
    nodes = {}
    for name, scene in (("rest.png", press.at_rest()), ("press.png", press)):
        left, right, nodes[name] = render_stereo(scene, BEHIND)
        cv2.imwrite(name, binocular_frame(left, right))
    status, out, _ = run("calibrate", *views, *BOARD, *THROUGH, "--window", "5:1.49,20:1.41")
    assert status == 0
    assert "window: normal (-0.17" in out
    assert "advice: the last layer" not in out
    rig = StereoRig.load("rig.yaml")
    assert rig.window.distance == pytest.approx(20.0, abs=0.5)
    assert rig.covariance.shape == (26, 26)
    Path("both").mkdir()
    for number, name in enumerate(("rest.png", "press.png")):
        Path(name).rename(f"both/{number}.png")
    measured = run("run", "both", "--stereo", "rig.yaml", "--grid", "20x20", "--out", "press.npz")
    assert measured[0] == 0
    assert "as in air" not in measured[1]
    with np.load("press.npz") as series:
        moved, bias = series["displacement"][1], series["bias_sigma"]
    true = nodes["press.png"] - nodes["rest.png"]
    assert np.nanmax(np.linalg.norm(moved, axis=2)) == pytest.approx(
        np.linalg.norm(true, axis=2).max(), rel=0.02
    )
    assert 0 < bias[1].max() < 0.02
    assert bias[0].max() < 1e-3 * bias[1].max()
    beyond = dataclasses.replace(rig, window=dataclasses.replace(rig.window, distance=60.0))
    beyond.save("beyond.yaml")
    lost = run("run", "both", "--stereo", "beyond.yaml", "--grid", "20x20", "--out", "no.npz")
    fails_in_one_line(lost, "the rig's window lies beyond the pattern")
    Path("both/0.png").rename("rest.png")
    wrong = run("calibrate", *views, *BOARD, *THROUGH, "--window", "5:1.49,20:1.30")
    assert "advice: the last layer of --window is 20 thick" in wrong[1]
