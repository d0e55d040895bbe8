"""The command line as a user has it: its files, messages and statuses."""

import csv
import os
import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import zlib
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from cases import some
from messages import OF_PYTHON, fails_in_one_line
from videos import write_video

import cmp_cl
from cmp_cl import Method, media, synthetic
from cmp_cl.cli import devices
from cmp_cl.cli import main as cli
from cmp_cl.viz import METHOD_COLOURS

PROJECT = Path(__file__).parents[2]
BOARD = PROJECT / "cmp_cl" / "data" / "board.png"


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def write_flat_png(path, width, height, *, whole=True):
    """Write a PNG of one grey level, in some kB however large it is; or but for its pixels."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    packer = zlib.compressobj(9)
    rows = b"".join(
        [
            *(packer.compress(bytes(width + 1)) for _ in range(height if whole else 0)),
            packer.flush(),
        ]
    )
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = chunk(b"IHDR", header), chunk(b"IDAT", rows), chunk(b"IEND", b"")
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def test_devices_lists_what_there_is_and_which_is_used(run):
    status, out, err = run("devices")
    assert (status, err) == (0, "")
    for device in cmp_cl.list_devices():
        assert device.name in out
        assert device.platform in out
        assert device.driver in out
    assert "memory MB" in out
    assert f"used by default: {cmp_cl.select_device().index}, " in out


def test_devices_says_why_a_device_is_the_default(run, monkeypatch):
    monkeypatch.setenv("CMP_CL_DEVICE", "0:0")
    assert run("devices")[1].endswith(": CMP_CL_DEVICE is '0:0'\n")
    monkeypatch.delenv("CMP_CL_DEVICE")
    assert run("devices")[1].endswith((": the first CPU\n", ": the first GPU\n"))
    monkeypatch.setenv("CMP_CL_DEVICE", "no such device")
    fails_in_one_line(run("devices"), "no such device", "CMP_CL_DEVICE")


def test_without_a_device_devices_says_what_to_install(run, monkeypatch):
    monkeypatch.setattr(devices, "list_devices", list)
    status, out, err = run("devices")
    assert (status, out) == (1, "")
    places = ("Linux", "Windows", "macOS", "Jetson", "NVIDIA", "Intel", "AMD")
    assert all(place in err for place in places)


def test_devices_says_why_none_was_found(run, monkeypatch, tmp_path):
    monkeypatch.setattr(devices, "list_devices", list)
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    assert f"no driver is registered in {tmp_path};" in run("devices")[2]
    (tmp_path / "broken.icd").write_text("libmissing.so")
    assert f"broken.icd in {tmp_path} cannot be loaded or have no device\n" in run("devices")[2]
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path / "elsewhere"))
    assert "elsewhere', which does not exist" in run("devices")[2]


def test_the_board_is_found_where_opencv_finds_it(run):
    status, out, err = run("detect", BOARD, "--out", "corners.csv", "--overlay", "o.png")
    assert (status, err) == (0, "")
    rows = rows_of("corners.csv")
    assert f"{BOARD}: {len(rows)} corners in " in out
    assert " ms on " in out
    assert f"wrote corners.csv: {len(rows)} corners" in out
    image = cv2.imread(str(BOARD), cv2.IMREAD_GRAYSCALE)
    found, peer = cv2.findChessboardCornersSB(image, (9, 6))
    assert found
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    peer = cv2.cornerSubPix(image, peer.reshape(-1, 1, 2), (5, 5), (-1, -1), stop)
    xy = np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows])
    assert len(xy) == len(peer) == 54
    assert np.linalg.norm(peer - xy, axis=2).min(axis=1).max() < 0.5
    overlay = cv2.imread("o.png")
    assert overlay.shape[1] >= 1000
    assert (overlay == METHOD_COLOURS[Method.EDGE_STEP]).all(axis=2).sum() > 54 * 20


def test_the_table_holds_what_the_library_finds(run):
    run("detect", BOARD, "--out", "corners.csv")
    corners = cmp_cl.detect(media.read_image(BOARD))
    rows = rows_of("corners.csv")
    np.testing.assert_array_equal([np.float32(row["x_px"]) for row in rows], corners.xy[:, 0])
    np.testing.assert_array_equal([np.float32(row["y_px"]) for row in rows], corners.xy[:, 1])
    assert {row["image"] for row in rows} == {str(BOARD)}


def test_a_pattern_of_known_size_is_numbered_and_looked_at_twice(run):
    run("render", "--markers", 30, "--indenter", "torus", "--out", "gel.png", "--truth", "t.csv")
    asked = ("detect", "gel.png", "--grid", "30x30", "--out", "n.csv", "--overlay", "o.png")
    status, out, err = run(*asked)
    assert (status, err) == (0, "")
    assert "; 900 of 900 nodes; wrote o.png" in out
    assert "wrote n.csv: 900 nodes" in out
    nodes, truth = rows_of("n.csv"), rows_of("t.csv")
    found = Counter(row["status"] for row in nodes)
    assert found["DETECTED"] > 850
    assert found["MISSING"] == 0
    for node, true in zip(nodes, truth, strict=True):
        assert (node["row"], node["column"]) == (true["row"], true["column"])
        apart = [float(node[axis]) - float(true[axis]) for axis in ("x_px", "y_px")]
        assert np.hypot(*apart) < 3
    yellow = (cv2.imread("o.png") == (0, 215, 255)).all(axis=2)
    assert yellow.sum() >= 10 * found["SECOND_LOOK"]


def test_two_patterns_are_not_numbered_as_one(run):
    board = media.read_image(BOARD)
    apart = np.full((board.shape[0], 60), 200, np.uint8)
    media.write_image("two.png", np.hstack([board, apart, board]))
    status, out, err = run("detect", "two.png", "--grid", "6x9", "--out", "n.csv")
    assert status == 2
    assert err.startswith("cmp-cl: two.png: frame 0 is not numbered: ")
    assert err.endswith("; n.csv was not written\n")
    assert "wrote" not in out
    assert not Path("n.csv").exists()


def test_a_board_of_another_size_is_not_numbered(run):
    status, out, err = run("detect", BOARD, "--grid", "4x4", "--out", "n.csv")
    assert status == 2
    assert "frame 0 is not numbered: the board looks like 6 x 9 corners; 4 x 4 were asked" in err
    assert "nodes" not in out
    assert not Path("n.csv").exists()


def test_render_writes_an_image_and_its_truth_and_detect_finds_them(run):
    scene = ("render", "--markers", 20, "--indenter", "torus", "--severity", 0.25, "--seed", 3)
    status, out, _ = run(*scene, "--out", "gel.png", "--truth", "truth.csv")
    assert status == 0
    assert "wrote gel.png: 640 x 480 px, 400 corners" in out
    truth = np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows_of("truth.csv")])
    assert run("detect", "gel.png", "--out", "corners.csv")[0] == 0
    xy = np.array([[float(row["x_px"]), float(row["y_px"])] for row in rows_of("corners.csv")])
    distance = np.linalg.norm(truth[:, None] - xy, axis=2).min(axis=1)
    assert (distance < 1).mean() > 0.98
    run(*scene, "--out", "again.png")
    assert Path("again.png").read_bytes() == Path("gel.png").read_bytes()


RENDER = ("render", "--shape", 120, 160, "--markers", 10, "--out")


@pytest.fixture(scope="session")
def usual(tmp_path_factory):
    """Return the image of the options RENDER."""
    path = tmp_path_factory.mktemp("render") / "usual.png"
    cli.main([str(argument) for argument in (*RENDER, path)])
    return path.read_bytes()


OPTIONS = {
    "--markers": (12,),
    "--severity": (0.5,),
    "--indenter": ("wedge",),
    "--mode": ("twist",),
    "--shape": (100, 160),
    "--corrosion": (0,),
    "--noise": (9,),
    "--bits": (12,),
    "--seed": (7,),
}


@pytest.mark.parametrize("option", some(OPTIONS, ("--mode", "--bits")))
def test_each_option_of_render_changes_the_image(run, usual, option):
    assert run(*RENDER, "other.png", option, *OPTIONS[option])[0] == 0
    assert Path("other.png").read_bytes() != usual


def test_images_of_a_12_bit_camera_get_a_hint_about_full_scale(run):
    run("render", "--markers", 20, "--severity", 0, "--bits", 12, "--out", "deep.png")
    media.write_image("deep.png", media.read_image("deep.png") // 4)  # in little light
    status, out, err = run("detect", "deep.png")
    assert status == 0
    assert "deep.png: 0 corners" in out
    assert "--full-scale 4095" in err
    status, out, err = run("detect", "deep.png", "--full-scale", 4095)
    assert "deep.png: 400 corners" in out
    assert err == ""
    _, _, err = run("detect", "deep.png", "--full-scale", 255)
    assert "above the full scale of 255" in err


def test_a_10_bit_camera_gets_one_hint_though_corners_are_found_and_where_none_is(run):
    run("render", "--markers", 20, "--severity", 0, "--noise", 1, "--bits", 12, "--out", "deep.png")
    shutil.copy("deep.png", "again.png")
    status, out, err = run("detect", "deep.png", "again.png")
    assert status == 0
    assert "again.png: 400 corners" in out
    assert err.count("--full-scale 4095") == 1
    media.write_image("deep.png", media.read_image("deep.png") // 4)
    for command in ("run --out x.npz", "detect"):
        _, _, err = run(*command.split(), "deep.png")
        assert "--full-scale 1023 for 10 bits" in err
        assert re.search(OF_PYTHON, err) is None
        assert "\n" not in err.strip()


def test_colour_gives_the_corners_of_its_grey(run):
    grey = media.read_image(BOARD)
    media.write_image("colour.png", np.dstack([grey, grey, grey]))
    run("detect", BOARD, "--out", "grey.csv")
    run("detect", "colour.png", "--out", "colour.csv")
    colour = [list(row.values())[1:] for row in rows_of("colour.csv")]
    assert colour == [list(row.values())[1:] for row in rows_of("grey.csv")]


def test_a_folder_is_searched_and_what_fails_in_it_is_named(run):
    Path("in").mkdir()
    grey = media.read_image(BOARD)
    names = ["a.png", "new\nline.png", "two  spaces.png"]
    for name in names:
        media.write_image(Path("in") / name, grey)
    Path("in/broken.png").write_text("no image")
    Path("in/notes.txt").write_text("nothing to see")
    status, out, err = run("detect", "in", "--out", "all.csv", "--overlay", "seen")
    assert status == 2
    assert err == "cmp-cl: 'in/broken.png' is not an image that OpenCV can read, or is damaged\n"
    assert len(out.splitlines()) == 4
    assert r"'in/new\nline.png': " in out
    assert {row["image"] for row in rows_of("all.csv")} == {f"in/{name}" for name in names}
    overlays = {"a-corners.png", "new\nline-corners.png", "two  spaces-corners.png"}
    assert set(os.listdir("seen")) == overlays


def test_two_inputs_of_one_name_get_two_overlays(run):
    for folder in ("left", "right"):
        Path(folder).mkdir()
        media.write_image(f"{folder}/a.png", media.read_image(BOARD))
    assert run("detect", "left/a.png", "right/a.png", "--overlay", "seen")[0] == 0
    assert set(os.listdir("seen")) == {"a-corners.png", "a-2-corners.png"}


def test_a_video_is_searched_frame_by_frame(run):
    grey = media.read_image(BOARD)
    write_video("press.avi", [np.zeros_like(grey), grey, grey[::-1].copy(), grey])
    status, out, err = run("detect", "press.avi", "--out", "c.csv", "--overlay", "seen")
    assert (status, err) == (0, "")
    assert "press.avi: 4 frames, 0 to " in out
    assert sorted(os.listdir("seen")) == [f"press-corners-{index:06}.png" for index in range(4)]
    rows = rows_of("c.csv")
    frames = [row["frame"] for row in rows]
    count = {frame: frames.count(frame) for frame in "0123"}
    assert count["0"] == 0
    assert count["1"] == count["2"] == count["3"] == 54
    second = list(media.read_frames("press.avi"))[1].image
    xy = [[np.float32(row["x_px"]), np.float32(row["y_px"])] for row in rows if row["frame"] == "1"]
    np.testing.assert_array_equal(xy, cmp_cl.detect(second).xy)  # the black frame set no cell


def test_broken_frames_are_reported_and_skipped(run):
    grey = media.read_image(BOARD)
    write_video("whole.avi", [grey] * 12)
    whole = Path("whole.avi").read_bytes()
    Path("cut.avi").write_bytes(whole[: len(whole) // 2])
    status, out, err = run("detect", "cut.avi")
    assert status == 0
    assert "cut.avi: " in out
    assert err.startswith("cmp-cl: cut.avi: skipped ")
    assert err.count("\n") == 1


def cut_video(path):
    """Write a video of which only the head can be read."""
    write_video("whole.avi", [media.read_image(BOARD)] * 3)
    Path(path).write_bytes(Path("whole.avi").read_bytes()[:6000])


@pytest.mark.parametrize("kind", ["video", "image", "grid"])
def test_a_table_is_kept_where_nothing_could_be_read_or_numbered(run, kind):
    Path("c.csv").write_text("old")
    cut_video("cut.avi")
    Path("cut.png").write_bytes(BOARD.read_bytes()[:2000])
    board = media.read_image(BOARD)
    media.write_image(
        "two.png", np.hstack([board, np.full((len(board), 60), 200, np.uint8), board])
    )
    inputs = {"video": ["cut.avi"], "image": ["cut.png"], "grid": ["two.png", "--grid", "6x9"]}
    fails_in_one_line(run("detect", *inputs[kind], "--out", "c.csv"), "c.csv was not written")
    assert Path("c.csv").read_text() == "old"
    if kind != "grid":
        assert run("detect", *inputs[kind], BOARD, "--out", "c.csv")[0] == 2
        assert len(rows_of("c.csv")) == 54


@pytest.mark.skipif(os.name == "nt", reason="there are no device files on Windows")
@pytest.mark.parametrize("name", ["/dev/zero", "/dev/null", "/dev/full"])
def test_a_path_that_is_no_file_is_not_read(run, name):
    fails_in_one_line(run("detect", name), f"'{name}' is not a file")


@pytest.mark.parametrize(
    "arguments",
    [
        ["detect", BOARD, "--config", "e.toml", "--out", "e.toml"],
        ["detect", BOARD, "--out", "same.png", "--overlay", "same.png"],
        ["detect", BOARD, "--out", "link.csv", "--config", "e.toml"],
        ["run", "a.png", "--config", "e.toml", "--stereo", "rig.npz", "--out", "rig.npz"],
        ["run", "a.png", "--out", "a.npz", "--plot", "a", "--config", "a.npz"],
        ["calibrate", "board.yaml", "--board", "3x3", "--square", "1", "--out", "board.yaml"],
        ["render", "--out", "a.png", "--truth", "./a.png"],
    ],
    ids=lambda arguments: " ".join(map(str, arguments)).replace(str(BOARD), "board.png"),
)
def test_no_output_goes_over_an_input_or_another_output(run, arguments):
    cmp_cl.DetectorConfig().save("e.toml")
    cmp_cl.DetectorConfig().save("a.npz")
    media.write_image("a.png", media.read_image(BOARD))
    cmp_cl.StereoRig(*synthetic.default_rig((300, 300))).save("rig.yaml")
    os.rename("rig.yaml", "rig.npz")
    for name in ("board.yaml", "frame.toml"):
        Path(name).write_text("an input")
    os.symlink("e.toml", "link.csv")
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    status, _, err = run(*arguments)
    assert status == 2
    assert re.search("is an input and would be overwritten|is given for two outputs", err)
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before


def test_a_terminated_command_leaves_no_temporary_file(run, monkeypatch):
    def frames(*_, **__):
        signal.raise_signal(signal.SIGTERM)
        yield

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(media, "read_frames", frames)
    assert run("detect", BOARD, "--out", "c.csv") == (130, "", "cmp-cl: interrupted\n")
    assert os.listdir() == []
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.skipif(os.name == "nt", reason="streams are closed otherwise on Windows")
@pytest.mark.parametrize("closed", some(["2>&-", ">&-", "<&- >&- 2>&-"], ["<&- >&- 2>&-"]))
def test_closed_streams_are_no_traceback_and_no_file_gets_their_number(tmp_path, closed):
    command = f'exec "{sys.executable}" -m cmp_cl detect missing.png {BOARD} --out c.csv {closed}'
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_a_full_disk_behind_standard_output_is_reported(tmp_path):
    done = subprocess.run(
        ["bash", "-c", f'"{sys.executable}" -m cmp_cl devices > /dev/full'],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr == "cmp-cl: No space left on device\n"


PATTERN = "pattern", "--grid", "4x4"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ["COMMAND"]),
        (("bogus",), ["bogus", "detect"]),
        (("detect",), ["IMAGE"]),
        (("detect", "missing.png"), ["there is no file 'missing.png'"]),
        (("detect", "text.png"), ["'text.png' is not an image"]),
        (("detect", "empty"), ["no image and no video in the folder 'empty'"]),
        (("detect", "float.tif"), ["float32", "expected 8 or 16 bits"]),
        (("detect", BOARD, "--out", "missing/c.csv"), ["there is no folder", "missing"]),
        (("detect", BOARD, "--overlay", "missing/o.png"), ["there is no folder", "missing"]),
        (("detect", BOARD, "--overlay", "o.xyz"), ["o.xyz", ".png"]),
        (("detect", BOARD, "--overlay", ""), ["--overlay"]),
        (("detect", BOARD, "--out", ""), ["--out needs"]),
        (("detect", BOARD, "--out", "-"), ["--out needs"]),
        (("detect", ""), ["must be the name of a file, not ''"]),
        (("detect", BOARD, BOARD, "--overlay", "o.png"), ["2 inputs", "name a folder"]),
        (("detect", BOARD, "--overlay", BOARD), ["would be overwritten"]),
        (("detect", "text.png", "--out", "text.png"), ["would be overwritten"]),
        (("detect", "in", "--overlay", "in"), ["contains inputs"]),
        (("detect", BOARD, "--config", "missing.toml"), ["cannot read", "missing.toml"]),
        (("detect", BOARD, "--config", "bad.toml"), ["bad.toml", "unknown key 'windoww'"]),
        (("detect", BOARD, "--config", "text.png"), ["text.png"]),
        (("detect", BOARD, "--device", "no such device"), ["no such device"]),
        (
            ("detect", BOARD, "--full-scale", "0"),
            ["cmp-cl: --full-scale must be an integer in [1, 65535], not 0"],
        ),
        (("detect", BOARD, "--full-scale", "x"), ["--full-scale: 'x' is not a whole number"]),
        (("detect", BOARD, "--grid", "9"), ["--grid", "'9'", "40x40"]),
        (("detect", BOARD, "--grid", "9999x9999"), ["--grid", "'9999x9999'", "nodes"]),
        (("detect", BOARD, "--config", "long.toml"), ["max_corners", "111 ... 111"]),
        (("detect", BOARD, "--config", "large.toml"), ["large.toml", "over 65536 bytes"]),
        (("run", BOARD, "--out", "u.npz", "--cell", "1", "--unit", ""), ["--unit", "mm"]),
        (
            (
                "calibrate",
                BOARD,
                "--board",
                "9x6",
                "--square",
                "1",
                "--unit",
                " ",
                "--out",
                "u.yaml",
            ),
            ["--unit", "mm"],
        ),
        (("render",), ["--out"]),
        (("render", "--out", "g.png", "--markers", "2"), ["--markers must", "[3, 100]", "2"]),
        (("render", "--out", "g.png", "--severity", "nan"), ["--severity must", "nan"]),
        (("render", "--out", "g.xyz"), ["g.xyz"]),
        (("render", "--out", "g.jpg", "--bits", "12"), ["uint16", "g.jpg", ".png"]),
        (("render", "--out", "missing/g.png"), ["there is no folder", "missing"]),
        (("render", "--out", "g.png", "--severity", "x"), ["--severity: 'x' is not a number"]),
        (("plot", "text.npz", "--out", "a.png"), ["text.npz", "is damaged or no series"]),
        (("demo", "--out", "text.png"), ["--out text.png is a file", "a folder"]),
        ((*PATTERN, "--cell", "3", "--out", "a.jpg"), ["suffix"]),
        ((*PATTERN, "--cell", "0", "--out", "a.png"), ["--cell: '0' is not a positive number"]),
        ((*PATTERN, "--cell", "1e6", "--out", "a.png"), ["cmp-cl: --cell must be a number in"]),
        ((*PATTERN, "--size", "nan", "--out", "a.png"), ["--size: 'nan' is not a positive"]),
        ((*PATTERN, "--cell", "90", "--paper", "a4", "--out", "a.svg"), ["the paper has"]),
        ((*PATTERN, "--cell", "3", "--dpi", "1e9", "--out", "a.png"), ["dpi"]),
        ((*PATTERN, "--cell", "3", "--size", "3", "--out", "a.png"), ["not allowed with"]),
        ((*PATTERN, "--cell", "3", "--out", "nowhere/a.png"), ["there is no folder"]),
    ],
    ids=lambda value: " ".join(map(str, value)).replace(str(BOARD), "board.png"),
)
def test_a_wrong_argument_is_one_line_and_status_2(run, arguments, words):
    Path("text.png").write_text("hello")
    Path("text.npz").write_text("hello")
    Path("bad.toml").write_text("windoww = 3")
    Path("long.toml").write_text(f"max_corners = '{'1' * 60_000}'")
    Path("large.toml").write_text(f"max_corners = '{'1' * 70_000}'")
    Path("empty").mkdir()
    Path("in").mkdir()
    media.write_image("in/a.png", np.zeros((9, 9), np.uint8))
    cv2.imwrite("float.tif", np.zeros((9, 9), np.float32))
    board, before = BOARD.read_bytes(), sorted(os.listdir())
    fails_in_one_line(run(*arguments), *words)
    assert BOARD.read_bytes() == board
    assert sorted(os.listdir()) == before


def test_detect_uses_the_settings_of_a_file(run):
    cmp_cl.DetectorConfig(refinement=None).save("cmp.toml")
    run("detect", BOARD, "--config", "cmp.toml", "--out", "c.csv")
    assert {row["method"] for row in rows_of("c.csv")} == {"CENTROID"}


@pytest.mark.skipif(os.name == "nt", reason="rights are others on Windows")
@pytest.mark.skipif(os.name != "nt" and os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_rights_is_named(run):
    Path("secret.png").touch(mode=0)
    fails_in_one_line(run("detect", "secret.png"), "secret.png", "Permission denied")


def test_the_help_names_the_commands_and_the_version_is_printed(run):
    status, out, err = run("-h")
    assert (status, err) == (0, "")
    assert all(command in out for command in ("devices", "detect", "render"))
    assert run("--version") == (0, f"cmp-cl {cmp_cl.__version__}\n", "")


def command_of_readme(extra):
    """Return the line of README.md that installs with those extras."""
    lines = (PROJECT / "README.md").read_text(encoding="utf-8").splitlines()
    (command,) = [line.strip() for line in lines if f'pip install ".[{extra}]" &&' in line]
    return [shlex.split(part) for part in command.split("&&")]


def test_the_first_command_of_the_readme_ends_in_corners_and_a_sheet(run, monkeypatch):
    commands = command_of_readme("pocl,plot")
    assert [command[0] for command in commands[:3]] == ["python3", ".", "pip"]
    Path("cmp_cl").symlink_to(PROJECT / "cmp_cl")
    for command in commands[3:]:
        assert command[0] == "cmp-cl"
        status, out, err = run(*command[1:])
        assert (status, err) == (0, "")
        assert "wrote" in out
    seen = (cv2.imread("board-corners.png") == METHOD_COLOURS[Method.EDGE_STEP]).all(axis=2)
    assert seen.sum() > 1000
    assert cv2.imread("demo/sheet.png").std() > 20


def test_ci_runs_the_readmes_test_command():
    commands = command_of_readme("pocl,test")
    assert [command[0] for command in commands] == ["python3", ".", "pip", "pytest"]
    script = (PROJECT / ".ci" / "run").read_text(encoding="utf-8")
    assert r"""grep -m 1 'pip install "\.\[pocl,test\]"' README.md""" in script
    assert 'bash -c "$command"' in script


def test_marks_in_the_cells_are_left_out_if_requested(run):
    cells = np.kron(np.indices((9, 12)).sum(axis=0) % 2, np.ones((20, 20)))
    y, x = np.indices(cells.shape) % 20 - 9.5
    board = np.where((cells > 0) ^ (np.hypot(x, y) < 5.6), 40, 200).astype(np.uint8)
    cv2.imwrite("dots.png", cv2.GaussianBlur(board, (0, 0), 0.9))
    run("detect", "dots.png", "--out", "all.csv")
    run("detect", "dots.png", "--drop-marks", "--out", "board.csv")
    there = {
        (round(float(row["x_px"]) / 20), round(float(row["y_px"]) / 20))
        for row in rows_of("board.csv")
    }
    assert len(rows_of("all.csv")) > 2 * len(rows_of("board.csv"))
    assert {(i, j) for i in range(1, 12) for j in range(1, 9)} <= there
