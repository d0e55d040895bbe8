"""demo, run and calibrate as a user has them, on small rendered frames."""

import dataclasses
import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from gels import GEL, RIG, VIEW, board_frame, pressed
from messages import fails_in_one_line
from stereo_data import photographs

from cmp_cl import Method, StereoRig, Window, select_device
from cmp_cl.cli import demo
from cmp_cl.synthetic import Scene, binocular_frame, default_rig, render_stereo
from cmp_cl.synthetic.boards import drawn, homography
from cmp_cl.viz import METHOD_COLOURS

PROJECT = Path(__file__).parents[2]

# demo


def commands_of_readme(extra):
    """Return the commands of the line of README.md that installs with those extras."""
    lines = (PROJECT / "README.md").read_text(encoding="utf-8").splitlines()
    (line,) = [line.strip() for line in lines if f'pip install ".[{extra}]" &&' in line]
    return [shlex.split(part) for part in line.split("&&")]


def test_the_first_commands_of_the_readme_find_a_board_and_measure_what_they_rendered(
    run, monkeypatch
):
    monkeypatch.setattr(demo, "VIEW", VIEW)  # a small one
    monkeypatch.setattr(demo, "SCENE", dataclasses.replace(GEL, severity=0.8))
    *install, detect, show = commands_of_readme("pocl,plot")
    assert [command[0] for command in install] == ["python3", ".", "pip"]
    Path("cmp_cl").symlink_to(PROJECT / "cmp_cl")
    for command in (detect, show):
        assert command[0] == "cmp-cl"
        status, out, err = run(*command[1:])
        assert (status, err) == (0, "")
        assert "wrote" in out
    seen = (cv2.imread("board-corners.png") == METHOD_COLOURS[Method.EDGE_STEP]).all(axis=2)
    assert seen.sum() > 1000
    assert str(select_device()) in out
    assert cv2.imread("demo/sheet.png").std() > 20
    field = np.load("demo/field.npz")
    moved = pressed(0.8).xyz - pressed(0.0).xyz
    off = np.linalg.norm(field["displacement"] - moved, axis=2)
    rms = np.sqrt(np.mean(off**2))
    assert rms < 0.05  # mm, a third of a pixel
    assert f"error of the displacement, RMS  {1e3 * rms:.1f} um" in out
    command = out.splitlines()[-1].partition("cmp-cl ")[2].split()
    assert run(*command)[0] == 0
    np.testing.assert_allclose(
        np.load("press.npz")["displacement"][1], field["displacement"], atol=1e-12
    )


# calibrate


@pytest.fixture(scope="session")
def boards():
    """Return frames that show a tilted board of 12 x 12 corners, 2 mm apart, to both cameras."""
    tilts = (0.4, 0.1), (-0.3, 0.3), (0.1, -0.45), (-0.4, -0.2)
    return [board_frame(number, tilt, RIG) for number, tilt in enumerate(tilts)]


BOARD = "--board", "12x12", "--square", "2", "--out", "rig.yaml"
AT_REST = "--rest", "1.png", "--grid", "20x20", "--pitch", "0.8"


def test_calibrate_finds_the_cameras_again(run, boards):
    for number, frame in enumerate(boards):
        cv2.imwrite(f"{number}.png", frame)
    cv2.imwrite("4.png", np.full((VIEW[0], 2 * VIEW[1]), 90, np.uint8))
    cv2.imwrite("5.png", np.full(VIEW, 90, np.uint8))
    Path("6.png").write_text("no image")
    status, out, err = run("calibrate", "--stereo", *(f"{n}.png" for n in range(7)), *BOARD)
    assert status == 0
    assert err.startswith("cmp-cl: left out: 4.png (left): no pattern of 12 x 12 corners is found")
    assert "left out: 5.png (right): it has 108 x 240 px, earlier views 216 x 240" in err
    assert err.count("left out: '6.png' is not an image") == err.count("6.png") == 1  # both views
    assert "advice: 4 different views" in out
    rig = StereoRig.load("rig.yaml")
    assert rig.K1[0, 0] == pytest.approx(RIG.K1[0, 0], rel=0.02)
    assert np.linalg.norm(rig.T) == pytest.approx(np.linalg.norm(RIG.T), rel=0.02)
    assert np.degrees(np.arccos((np.trace(rig.R @ RIG.R.T) - 1) / 2)) < 0.5
    assert float(out.split("all views: ")[1].split()[0]) < 0.1


def test_calibrate_says_how_flat_the_board_is(run):
    rng, lens = np.random.default_rng(5), np.array([[500, 0, 160], [0, 500, 120], [0, 0, 1.0]])
    for number in range(10):
        turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        place = [0, 0, 24] - turn @ [3.5, 2, 0]
        camera = homography(lens @ np.column_stack([turn[:, :2], place]))
        cv2.imwrite(f"{number}.png", drawn(camera, (240, 320), (5, 8), seed=number).image)
    settings = "--board", "5x8", "--square", "2", "--out", "camera.yaml"
    status, out, err = run("calibrate", *(f"{number}.png" for number in range(10)), *settings)
    assert (status, err) == (0, "")
    assert float(out.split("the board is flat to ")[1].split(" mm")[0]) < 0.05


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["--left IMAGE... --right IMAGE... for two"]),
        (["--stereo", "0.png", "--board", "9x6"], ["looks like", "--board counts the inner"]),
        (["plain.mp4"], ["plain.mp4' is not an image"]),
        (["plain.png"], ["no view of camera shows a board of 12 x 12", "--stereo"]),
        (["--stereo", "--left", "0.png", "--right", "1.png"], ["with --stereo if each shows"]),
        (["0.png", "--mirror", "left"], ["--split and --mirror need --stereo"]),
        (["0.png", "--corners", "c.mat"], ["--corners c.mat must end in .vnl"]),
        (["--stereo", "0.png", "--corners", "c.vnl"], ["0.png shows two views", "by its file"]),
        (
            ["--left", "0.png", "half0.png", "--right", "plain.png", "plain.png"],
            ["no view of right shows", "plain.png: no pattern"],
        ),
        (["--camera", "noname.png"], ["NAME=IMAGE"]),
        (["--camera", "a=0.png", "1.png", "--camera", "b=0.png"], ["2 of a and 1 of b"]),
        (["--camera", "a=0.png", "--camera", "a=1.png"], ["each NAME once", "a=1.png"]),
        (
            ["--stereo", "0.png", "--window", "5:1.49"],
            ["--window needs --rest IMAGE, --grid 40x40 and --pitch"],
        ),
        (["0.png", "--window", "5"], ["'5' is not LENGTH:INDEX of each layer"]),
        (["--stereo", "0.png", *AT_REST], ["--rest needs --window"]),
        (
            ["--stereo", "0.png", "--window", "20:1.4", *AT_REST, "--step", "1"],
            ["need 1 image each"],
        ),
    ],
)
def test_a_wrong_argument_of_calibrate_is_one_line_and_no_file(
    run, boards, tmp_path, arguments, words
):
    cv2.imwrite("plain.png", np.full(VIEW, 90, np.uint8))
    Path("plain.mp4").touch()
    for number, both in enumerate(boards[:3]):
        cv2.imwrite(f"{number}.png", both)
        cv2.imwrite(f"half{number}.png", both[:, : VIEW[1]])
    fails_in_one_line(run("calibrate", *BOARD, *arguments), *words)
    assert not list(tmp_path.glob("rig.*"))


# all commands


@pytest.fixture
def opencv_views():
    """Return the left and the right photographs of OpenCV's stereo pairs."""
    folder = photographs("stereo_opencv")
    return [sorted(folder.glob(f"{side}0?.jpg")) for side in ("left", "right")]


CHESSBOARD = "--board", "9x6", "--square", 25


def test_images_are_those_of_one_camera(run, opencv_views, tmp_path):
    left = opencv_views[0]
    shutil.copy(left[0], tmp_path / "again.jpg")
    status, out, _ = run("calibrate", *left, "again.jpg", *CHESSBOARD, "--corners", "corners.vnl")
    assert status == 0
    assert "like left01.jpg  again.jpg" in out
    assert "advice: left01.jpg and again.jpg show the same and count as one view" in out
    assert "advice: camera: add views with the board at the top left" in out
    assert "wrote calibration.yaml, corners.vnl, calibration.png" in out
    assert 0.05 < float(out.split("all views: ")[1].split()[0]) < 0.14
    assert 0.1 < float(out.split("px (+- ")[1].split(")")[0]) < 2  # of the focal length
    assert len(Path("corners.vnl").read_text().splitlines()) > 5 * 50
    assert cv2.imread("calibration.png").std() > 10


def test_named_cameras_make_a_rig_that_run_takes(run, opencv_views):
    left, right = (views[:4] for views in opencv_views)
    cameras = (
        *("--camera", f"left={left[0]}", *left[1:]),
        *("--camera", f"right={right[0]}", *right[1:]),
    )
    assert run("calibrate", *cameras, *CHESSBOARD, "--out", "rig.2.yaml")[0] == 0
    assert not Path("rig.png").exists()  # the picture of another calibration
    rig = StereoRig.load("rig.2.yaml")
    assert np.linalg.norm(rig.T) == pytest.approx(83.2, abs=1)


# through a window

WIDER = (320, 270)
AIR = default_rig(WIDER)
BEHIND = dataclasses.replace(AIR, window=Window(AIR.R[2] + (0, 0, 1), 20.0, ((5.0, 1.49),), 1.41))
TILTS = (0.4, 0.1), (-0.3, 0.3), (0.1, -0.45), (-0.4, -0.2), (0.2, 0.3), (-0.2, -0.4)
OF_PAIR = "--stereo", "--board", "12x12", "--square", "2", "--out", "rig.yaml"
THROUGH = "--rest", "rest.png", "--grid", "20x20", "--pitch", "0.8"


def test_a_press_behind_a_window_is_measured_with_the_rig_that_calibrate_writes(run):
    views = [f"{number}.png" for number in range(len(TILTS))]
    for number, (name, tilt) in enumerate(zip(views, TILTS, strict=True)):
        cv2.imwrite(name, board_frame(number, tilt, AIR, WIDER))
    press = Scene(
        markers=20, side=16.8, severity=0.5, seed=3, shape=WIDER, corrosion=0.0, noise=1.0
    )
    nodes = {}
    for name, scene in (("rest.png", press.at_rest()), ("press.png", press)):
        left, right, nodes[name] = render_stereo(scene, BEHIND)
        cv2.imwrite(name, binocular_frame(left, right))
    status, out, _ = run("calibrate", *views, *OF_PAIR, *THROUGH, "--window", "5:1.49,20:1.41")
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
    fails_in_one_line(lost, "its window, beyond which the pattern must lie, and which view")
    Path("both/0.png").rename("rest.png")
    wrong = run("calibrate", *views, *OF_PAIR, *THROUGH, "--window", "5:1.49,20:1.30")
    assert "advice: the last layer of --window is 20 thick" in wrong[1]
