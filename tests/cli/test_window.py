"""calibrate through a window, and run with what it wrote, on small rendered frames."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from gels import board_frame
from messages import fails_in_one_line

from cmp_cl import StereoRig, Window
from cmp_cl.synthetic import Scene, default_rig, render_stereo

VIEW = (320, 270)
AIR = default_rig(VIEW)
BEHIND = dataclasses.replace(AIR, window=Window(AIR.R[2] + (0, 0, 1), 20.0, ((5.0, 1.49),), 1.41))
TILTS = (0.4, 0.1), (-0.3, 0.3), (0.1, -0.45), (-0.4, -0.2), (0.2, 0.3), (-0.2, -0.4)
BOARD = "--stereo", "--board", "12x12", "--square", "2", "--out", "rig.yaml"
THROUGH = "--rest", "rest.png", "--grid", "20x20", "--pitch", "0.8"


def frame(scene, rig):
    left, right, xyz = render_stereo(scene, rig)
    return np.hstack([left.image, right.image]), xyz


@pytest.fixture(scope="module")
def frames():
    """Return frames of a board in air, and of a press at rest and pressed behind a window."""
    found = {f"{n}.png": (board_frame(n, tilt, AIR, VIEW), None) for n, tilt in enumerate(TILTS)}
    press = Scene(markers=20, side=16.8, severity=0.5, seed=3, shape=VIEW, corrosion=0.0, noise=1.0)
    found["rest.png"] = frame(press.at_rest(), BEHIND)
    found["press.png"] = frame(press, BEHIND)
    return found


@pytest.fixture
def written(frames):
    for name, (image, _) in frames.items():
        cv2.imwrite(name, image)
    return [name for name in frames if name[0].isdigit()]


def test_a_press_behind_a_window_is_measured_with_the_rig_that_calibrate_writes(
    run, written, frames
):
    status, out, _ = run("calibrate", *written, *BOARD, *THROUGH, "--window", "5:1.49,20:1.41")
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
    true = frames["press.png"][1] - frames["rest.png"][1]
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
    wrong = run("calibrate", *written, *BOARD, *THROUGH, "--window", "5:1.49,20:1.30")
    assert "advice: the last layer of --window is 20 thick" in wrong[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--window", "5:1.49"], ["--window needs --rest IMAGE, --grid 40x40 and --pitch"]),
        (["--window", "5", *THROUGH], ["'5' is not LENGTH:INDEX of each layer"]),
        ([*THROUGH], ["--rest needs --window"]),
        (["--window", "20:1.4", *THROUGH, "--step", "1"], ["need 1 image each"]),
    ],
)
def test_a_wrong_argument_of_a_window_is_one_line_and_no_file(run, written, arguments, words):
    fails_in_one_line(run("calibrate", *written, *BOARD, *arguments), *words)
