"""All commands: their devices, messages, statuses and signals."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pyopencl as cl
import pytest
from messages import fails_in_one_line

import cmp_cl
from cmp_cl import CalibrationError, KernelBuildError, media, synthetic
from cmp_cl.cli import devices

PROJECT = Path(__file__).parents[2]
BOARD = PROJECT / "cmp_cl" / "data" / "board.png"


def of_shell(command, **options):
    """Run `cmp-cl` and what follows in a shell."""
    return subprocess.run(
        ["bash", "-c", f'exec "{sys.executable}" -m cmp_cl {command}'],
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
        capture_output=True,
        text=True,
        timeout=120,
        **options,
    )


# devices


def test_devices_lists_what_there_is_and_why_one_is_the_default(run, monkeypatch):
    status, out, err = run("devices")
    assert (status, err) == (0, "")
    for device in cmp_cl.list_devices():
        assert all(text in out for text in (device.name, device.platform, device.driver))
    assert f"used by default: {cmp_cl.select_device().index}, " in out
    monkeypatch.setenv("CMP_CL_DEVICE", "0:0")
    assert run("devices")[1].endswith(": CMP_CL_DEVICE is '0:0'\n")
    monkeypatch.delenv("CMP_CL_DEVICE")
    assert run("devices")[1].endswith((": the first CPU\n", ": the first GPU\n"))
    monkeypatch.setenv("CMP_CL_DEVICE", "no such device")
    fails_in_one_line(run("devices"), "no such device", "CMP_CL_DEVICE")


def test_without_a_device_devices_says_where_drivers_are_sought(run, monkeypatch, tmp_path):
    def no_platform():
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", no_platform)
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    asked = run("detect", BOARD, "--device", "cpu")
    fails_in_one_line(asked, "no OpenCL device was found", "pip install 'pyopencl[pocl]'")
    status, out, err = run("devices")
    assert (status, out) == (1, "")
    assert f"no driver in {tmp_path} can be loaded and has a device; pip install" in err


def test_each_device_is_timed_and_its_answer_is_checked(run, monkeypatch):
    monkeypatch.setattr(devices, "FRAMES", 2)
    status, out, _ = run("devices", "--time")
    assert status == 0
    head, *rows = out.partition("1936 corners")[2].splitlines()[1:]
    assert head.split()[:2] == ["index", "median"]
    assert [row.split()[0] for row in rows] == [device.index for device in cmp_cl.list_devices()]
    for _, median, late, missed, false, rmse in map(str.split, rows):
        assert 0 < float(median) <= float(late)
        assert (missed, false) == ("0", "0")
        assert float(rmse) < 0.3


# what is refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ["COMMAND"]),
        (("bogus",), ["bogus", "detect"]),
        (("run", BOARD, "--rig", "r.yaml", "--out", "a.npz"), ["--rig r.yaml; cmp-cl run --help"]),
        (("detect", "float.tif"), ["float32", "expected 8 or 16 bits"]),
        (("detect", BOARD, "--out", "-"), ["--out - must end in .csv"]),
        (("detect", BOARD, BOARD, "--overlay", "o.png"), ["--overlay is the picture of one image"]),
        (("detect", BOARD, "--overlay", BOARD), ["would be overwritten"]),
        (("detect", BOARD, "--overlay", "o.gif"), ["must end in .png or .jpg"]),
        (("detect", BOARD, "--grid", "9999x9999"), ["--grid", "'9999x9999'", "nodes"]),
        (("detect", BOARD, "--config", "long.toml"), ["max_corners", "111 ... 111"]),
        (("render", "--out", "g.png", "--markers", "2"), ["markers must", "[3, 100]", "2"]),
        (("render", "--out", "g.jpg", "--bits", "12"), ["uint16", "g.jpg", ".png"]),
        (("pattern", "--grid", "4x4", "--cell", "3", "--out", "a.jpg"), ["suffix"]),
        (("render", "--out", "g.png", "--truth", "t.npz"), ["--truth t.npz must end in .csv"]),
        (("demo", "--out", "text.png"), ["--out text.png is a file", "a folder"]),
        (("demo", "--out", "."), ["--out . holds other files", "a new folder"]),
    ],
    ids=lambda value: " ".join(map(str, value)).replace(str(BOARD), "board.png"),
)
def test_a_wrong_argument_is_one_line_and_status_2(run, arguments, words):
    Path("text.png").write_text("hello")
    Path("long.toml").write_text(f"max_corners = '{'1' * 60_000}'")
    cv2.imwrite("float.tif", np.zeros((9, 9), np.float32))
    board, before = BOARD.read_bytes(), sorted(os.listdir())
    fails_in_one_line(run(*arguments), *words)
    assert BOARD.read_bytes() == board
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["detect", BOARD, "--out", "a.csv", "--config", "a.csv"],
        ["detect", BOARD, "--out", "link.csv", "--config", "e.toml"],
        ["run", "a.png", "--config", "e.toml", "--stereo", "rig.npz", "--out", "rig.npz"],
        ["calibrate", "board.yaml", "--board", "3x3", "--square", "1", "--out", "board.yaml"],
        ["render", "--out", "a.csv", "--truth", "./a.csv"],
    ],
    ids=lambda arguments: " ".join(map(str, arguments)).replace(str(BOARD), "board.png"),
)
def test_no_output_goes_over_an_input_or_another_output(run, arguments):
    cmp_cl.DetectorConfig().save("e.toml")
    cmp_cl.DetectorConfig().save("a.csv")
    cmp_cl.DetectorConfig().save("a.npz")
    media.write_image("a.png", media.read_image(BOARD))
    synthetic.default_rig((300, 300)).save("rig.yaml")
    os.rename("rig.yaml", "rig.npz")
    Path("board.yaml").write_text("an input")
    os.symlink("e.toml", "link.csv")
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    status, _, err = run(*arguments)
    assert status == 2
    assert re.search("is an input and would be overwritten|is given for two outputs", err)
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before


# statuses and streams


FAILURES = {
    "an error of ours": (CalibrationError("no camera"), 2, "cmp-cl: no camera\n"),
    "a kernel": (KernelBuildError("no kernel"), 2, "cmp-cl: no kernel\n"),
    "a file": (FileNotFoundError(2, "No such file", "a"), 2, "cmp-cl: a: No such file\n"),
    "memory": (MemoryError(), 2, "cmp-cl: there is not enough memory for this\n"),
    "Ctrl-C": (KeyboardInterrupt(), 130, "cmp-cl: interrupted\n"),
    "a closed pipe": (BrokenPipeError(), 0, ""),
}


@pytest.mark.parametrize(("error", "status", "line"), FAILURES.values(), ids=FAILURES)
def test_what_a_command_raises_is_a_status_and_one_line(run, monkeypatch, error, status, line):
    def raises():
        raise error

    monkeypatch.setattr(devices, "list_devices", raises)
    assert run("devices") == (status, "", line)


def test_a_terminated_command_leaves_no_temporary_file(run, monkeypatch):
    def frames(*_, **__):
        signal.raise_signal(signal.SIGTERM)
        yield

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(media, "read_frames", frames)
    assert run("detect", BOARD, "--out", "c.csv") == (130, "", "cmp-cl: interrupted\n")
    assert os.listdir() == []
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.skipif(os.name == "nt", reason="a signal to one process alone needs POSIX")
@pytest.mark.usefixtures("without_nohup")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_modules_are_imported_is_130_and_one_line(tmp_path, name):
    (tmp_path / "cv2.py").write_text(
        "import sys, time\nsys.stdout.write('importing\\n')\nsys.stdout.flush()\ntime.sleep(60)\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-m", "cmp_cl", "devices"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(PROJECT)))},
        start_new_session=True,
    )
    assert child.stdout.readline() == "importing\n"
    child.send_signal(getattr(signal, name))
    assert child.communicate(timeout=60) == ("", "cmp-cl: interrupted\n")
    assert child.returncode == 130


@pytest.mark.skipif(os.name == "nt", reason="streams are closed otherwise on Windows")
def test_closed_and_full_streams_are_no_traceback(tmp_path):
    done = of_shell(f"detect missing.png {BOARD} --out c.csv <&- >&- 2>&-", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "")
    if os.path.exists("/dev/full"):
        done = of_shell("devices > /dev/full")
        assert (done.returncode, done.stderr) == (2, "cmp-cl: No space left on device\n")
    done = of_shell(f"run {BOARD} --out - >&-")
    message = "cmp-cl: --out - needs standard output, which is closed\n"
    assert (done.returncode, done.stderr) == (2, message)


@pytest.mark.skipif(os.name == "nt", reason="streams are closed otherwise on Windows")
def test_a_reader_that_leaves_costs_no_file(tmp_path):
    done = of_shell(f"detect {BOARD} {BOARD} --out c.csv | head -0", cwd=tmp_path)
    assert done.stderr == ""
    assert (tmp_path / "c.csv").read_text().count("\n") == 1 + 2 * 54
