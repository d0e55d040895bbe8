"""`cmp-cl run` as a user has it, on small rendered frames."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading

import cv2
import numpy as np
import pytest
from cases import some
from children import full_after
from gels import RIG, VIEW, numbered_otherwise, pressed
from lattices import drawn
from messages import fails_in_one_line
from videos import camera_of, write_deep_video, write_video

from cmp_cl import Detector, DetectorConfig, DeviceError, EdgeLines, StereoRig, select_device
from cmp_cl.measure.views import View
from cmp_cl.media import Frame
from cmp_cl.series import SeriesWriter, read_series
from cmp_cl.synthetic import boards
from cmp_cl.viz.live import LiveView

CLOSE = 0.05  # mm, a third of a pixel


@pytest.fixture(scope="session")
def press():
    """Return frames of a gel at rest and pressed more and more."""
    return [pressed(severity) for severity in (0.0, 0.4, 0.9)]


@pytest.fixture
def recording(press, tmp_path):
    """Return a folder with these frames, and the rig's file beside it."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, shot in enumerate(press):
        cv2.imwrite(str(folder / f"{number}.png"), shot.frame)
    RIG.save(tmp_path / "rig.yaml")
    return folder


STEREO = "--stereo", "rig.yaml", "--grid", "12x12", "--out", "press.npz"


def off_by(series, press, order):
    """Return the root mean square error of every frame's displacement, mm; order: the shot of each
    frame."""
    truth = [press[number].xyz - press[0].xyz for number in order]
    return [
        np.sqrt(np.mean(np.square(found - true).sum(axis=2)))
        for found, true in zip(series["displacement"], truth, strict=True)
    ]


def test_a_recording_becomes_its_displacements_in_any_order(run, recording, press, tmp_path):
    status, out, err = run("run", recording, *STEREO)
    assert (status, err) == (0, "")
    assert "wrote press.npz: 3 frames; 144.0 of 144 nodes" in out
    assert str(select_device()) in out
    assert "frames a second; measured on" in out
    series = np.load("press.npz")
    assert series["index"].tolist() == [0, 1, 2]
    assert str(series["unit"]) == "mm"
    # The kernels compute the field, and NumPy the positions at rest: a nanometre apart.
    np.testing.assert_allclose(series["displacement"][0], 0, rtol=0, atol=1e-6)
    assert max(off_by(series, press, (0, 1, 2))) < CLOSE
    assert f"moved by up to {np.linalg.norm(series['displacement'][2], axis=2).max():.3g} mm" in out
    assert "depth as in air: calibrate --window" in out
    other = tmp_path / "other"
    other.mkdir()
    for place, number in enumerate((2, 0, 1)):
        cv2.imwrite(str(other / f"{place}.png"), press[number].frame)
    assert run("run", other, *STEREO, "--rest-frame", 1)[0] == 0
    shuffled = np.load("press.npz")
    for name in ("displacement", "sigma", "status", "source", "left", "right"):
        np.testing.assert_array_equal(shuffled[name], series[name][[2, 0, 1]])


def test_broken_frames_and_frames_without_the_pattern_do_not_end_a_run(run, recording, press):
    (recording / "1a.png").write_bytes(b"broken")
    cv2.imwrite(str(recording / "1b.png"), press[1].frame[:-1])
    cv2.imwrite(str(recording / "1c.png"), np.full_like(press[0].frame, 90))
    status, out, err = run("run", recording, *STEREO)
    assert status == 0
    assert "frame 2 is missing, and left out: " in err
    assert "1a.png' is not an image that OpenCV can read" in err
    assert "frame 3 is 432 x 239 px" in err
    assert "1 without the pattern; 2 left out" in out
    series = np.load("press.npz")
    assert series["index"].tolist() == [0, 1, 4, 5]
    assert np.isnan(series["displacement"][2]).all()
    assert (series["status"][2] == 0).all()
    assert off_by(series, press, (0, 1, 0, 2))[3] < CLOSE


def test_an_audit_that_finds_other_numbers_is_told(run, recording, press, monkeypatch):
    cv2.imwrite(str(recording / "0a.png"), press[0].frame)
    monkeypatch.setattr("cmp_cl.measure.measurement.AUDITED", 1)
    monkeypatch.setattr(View, "number", numbered_otherwise)
    status, _, err = run("run", recording, *STEREO)
    assert status == 0
    assert "frame 1: tracking had another corner for 4 nodes than " in err


def test_a_view_that_is_knocked_is_told(run, recording, press):
    right = np.roll(press[1].right.image, 2, axis=0)
    cv2.imwrite(str(recording / "1.png"), np.hstack([press[1].left.image, right]))
    status, out, err = run("run", recording, *STEREO)
    assert status == 0
    assert "; 1 that the rig does not fit; " in out
    assert "in 1 frame the rig no longer fits as it did at rest: " in err
    assert np.load("press.npz")["misfit"].tolist() == [False, True, False]


def test_a_mirrored_view_is_reversed(run, recording, press):
    run("run", recording, *STEREO)
    straight = np.load("press.npz")["displacement"]
    gap = np.full((VIEW[0], 10), 90, np.uint8)
    for number, shot in enumerate(press):
        other = np.hstack([gap, shot.right.image[:, ::-1], shot.left.image])
        cv2.imwrite(str(recording / f"{number}.png"), other)
    where = "226,0,216,240:10,0,216,240"
    fails_in_one_line(run("run", recording, *STEREO, "--split", where), "the rig fits", "mirror")
    status, _, _ = run("run", recording, *STEREO, "--split", where, "--mirror", "right")
    assert status == 0
    np.testing.assert_array_equal(np.load("press.npz")["displacement"], straight)


def test_run_uses_the_settings_of_a_file(run, recording):
    DetectorConfig.for_cell(15).replace(refinement=EdgeLines()).save("cmp.toml")
    run("run", recording, *STEREO)
    default = np.load("press.npz")["displacement"]
    assert run("run", recording, *STEREO, "--config", "cmp.toml")[0] == 0
    other = np.load("press.npz")["displacement"]
    assert np.nanmax(np.abs(other - default)) > 1e-5


# Stages at the same time


def failing_decoder(press, monkeypatch):
    def frames_of(path, **_):
        for number in range(1 if path.name == "0.png" else 2):
            yield Frame(number, press[number].frame)
        if path.name != "0.png":
            raise OSError(5, "Input/output error", path.name)

    monkeypatch.setattr("cmp_cl.media.cameras.read_frames", frames_of)


def failing_device(press, monkeypatch):
    begin, calls = Detector.begin, []

    def beginning(self, frames, **settings):
        calls.append(frames)
        if len(calls) == 4:  # the first one is the frame at rest
            raise DeviceError("the device is lost")
        return begin(self, frames, **settings)

    monkeypatch.setattr(Detector, "begin", beginning)


def full_disk(press, monkeypatch):
    append = SeriesWriter.append

    def filling(series, **frame):
        with full_after(5000 if len(series) == 2 else 10**9):
            append(series, **frame)

    monkeypatch.setattr(SeriesWriter, "append", filling)


@pytest.mark.skipif(os.name == "nt", reason="sizes of files have no limits on Windows")
@pytest.mark.parametrize(
    ("failing", "frames", "why"),
    [
        (failing_decoder, 3, "1.png: Input/output error"),
        (failing_device, 2, "the device is lost"),
        (full_disk, 2, "press.npz: File too large"),
    ],
)
def test_an_error_of_any_stage_is_one_line_and_keeps_the_frames_before_it(
    run, recording, press, monkeypatch, failing, frames, why
):
    failing(press, monkeypatch)
    status, out, err = run("run", recording, *STEREO)
    fails_in_one_line((status, out, err), why)
    assert out.startswith(f"wrote press.npz: {frames} frames")
    assert np.load("press.npz")["index"].tolist() == list(range(frames))


STOPS = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.mark.usefixtures("without_nohup")
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("name", some(STOPS, ("SIGINT", "SIGTERM")))
def test_a_stopped_run_keeps_what_it_has(run, recording, monkeypatch, name, times):
    append = SeriesWriter.append

    def stopped(series, **frame):
        if len(series) == 1:
            for _ in range(times):
                signal.raise_signal(getattr(signal, name))
        append(series, **frame)

    monkeypatch.setattr(SeriesWriter, "append", stopped)
    before = [signal.getsignal(getattr(signal, stop)) for stop in STOPS]
    status, out, _ = run("run", recording, *STEREO)
    assert status == 130
    assert not out if times == 2 else out.startswith("stopped by")
    # After the first signal all that is measured is written, after the second nothing is.
    found = np.load("press.npz")["index"].tolist()
    assert found == [0] if times == 2 else found[:2] == [0, 1]
    assert [signal.getsignal(getattr(signal, stop)) for stop in STOPS] == before


# Cameras and pairs


@pytest.mark.parametrize(
    ("camera", "known_as"), [(["3"], 3), (["/dev/video3", "--set", "fps=50"], "/dev/video3")]
)
def test_a_camera_runs_until_ctrl_c(run, recording, press, monkeypatch, camera, known_as):
    append = SeriesWriter.append

    def press_ctrl_c_after_three(series, **frame):
        append(series, **frame)
        if len(series) == 3:
            signal.raise_signal(signal.SIGINT)

    rest, *others = (shot.frame for shot in press)
    images = [press[2].frame, None, rest, None, *others, *[rest] * 40]
    opened = []
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images, opened))
    monkeypatch.setattr(SeriesWriter, "append", press_ctrl_c_after_three)
    before = signal.getsignal(signal.SIGINT)
    status, out, err = run("run", *camera, *STEREO, "--rest-frame", 2)
    assert status == 0
    assert opened == [known_as, "released"]
    assert out.startswith("stopped by Ctrl-C; wrote press.npz: ")
    assert "; 1 left out" in out
    assert err.startswith("cmp-cl: frame 3 is missing")
    assert err.count("\n") == 1
    series = np.load("press.npz")
    count = len(series["index"])  # those that were measured by then are written
    assert 3 <= count < 40
    assert series["index"].tolist() == [2, *range(4, 3 + count)]
    assert (np.diff(series["time_ms"]) >= 0).all()
    assert max(off_by(series, press, [0, 1, 2, *[0] * 40][:count])) < CLOSE
    assert signal.getsignal(signal.SIGINT) is before


def test_a_frame_of_a_camera_is_written_before_the_next_one_comes(
    run, recording, press, monkeypatch
):
    append, written = SeriesWriter.append, threading.Event()

    def tell(series, **frame):
        append(series, **frame)
        written.set()

    def images():
        yield press[0].frame
        written.wait(30)  # longer than a run waits for a camera
        yield press[1].frame

    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images()))
    monkeypatch.setattr(SeriesWriter, "append", tell)
    assert run("run", "7", *STEREO)[0] == 0
    assert np.load("press.npz")["index"].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("images", "why"), [([], "no camera 7"), ([None], "no frame comes from '7'")]
)
def test_a_camera_without_frames_is_an_error(run, recording, monkeypatch, images, why):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images))
    fails_in_one_line(run("run", "7", *STEREO), why)


def test_two_recordings_are_measured_as_one_of_both_views(run, recording, press):
    write_video("left.avi", [shot.left.image for shot in press])
    write_video("right.avi", [shot.right.image for shot in press])
    pair = "--left", "left.avi", "--right", "right.avi"
    status, out, err = run("run", *pair, *STEREO)
    assert status == 0
    assert "without a partner" not in out
    assert "goes on" not in err
    apart = np.load("press.npz")
    assert apart["time_ms"].tolist() == pytest.approx([0, 40, 80])
    assert run("run", recording, *STEREO)[0] == 0
    np.testing.assert_array_equal(apart["displacement"], np.load("press.npz")["displacement"])

    write_video("right.avi", [shot.right.image for shot in press[:2]])
    status, out, err = run("run", *pair, *STEREO)
    assert status == 0
    assert "2 frames" in out
    assert "1 left and 0 right frames without a partner" in out
    assert "one recording goes on for 1 frame after the other" in err


# What is told


def test_doubts_about_the_frame_at_rest_are_told(run, tmp_path):
    frame = np.full((400, 700), 210, np.uint8)
    for (left, top), (image, _) in zip(
        ((0, 0), (420, 40)), (drawn(12, 12), drawn(4, 5)), strict=True
    ):
        frame[top : top + len(image), left : left + image.shape[1]] = image
    cv2.imwrite(str(tmp_path / "0.png"), frame)
    status, _, told = run("run", tmp_path, "--out", "press.npz")
    assert status == 0
    assert told.startswith("cmp-cl: frame 0, the frame at rest: another pattern of 20 ")
    assert not run("run", tmp_path, "--grid", "12x12", "--out", "press.npz")[2]


def write_endless(folder, *shifts):
    """Write frames of a pattern without a border in view, that has moved by so many px; None is a
    frame without it."""
    board = np.kron(np.indices((13, 13)).sum(0) % 2, np.full((12, 12), 180)).astype(np.uint8) + 30
    for number, shift in enumerate(shifts):
        view = np.full_like(board, 90) if shift is None else np.roll(board, shift, axis=1)
        cv2.imwrite(str(folder / f"{number}.png"), view[6:150, 6:150])


def test_the_numbers_of_the_frame_at_rest_alone_are_not_ambiguous(run, tmp_path):
    write_endless(tmp_path, 0, 4)
    _, out, err = run("run", tmp_path, "--out", "press.npz")
    assert "1 whose numbers may be wrong" in out
    assert re.search(r"moved by up to \S+ px \(frame 0\)", out)
    assert "trust none of them" in err
    assert "--track" in err
    assert np.load("press.npz")["ambiguous"].tolist() == [False, True]


def test_files_that_are_missing_from_a_recording_are_told(run, recording):
    os.rename("frames/2.png", "frames/4.png")
    shutil.copy("frames/1.png", "frames/2.png")
    status, _, err = run("run", recording, *STEREO)
    assert status == 0
    assert err.splitlines()[0] == (
        "cmp-cl: 1 number missing between 0.png and 4.png: frames and their `index` count the files"
    )
    for number, name in (0, 1_700_000_123), (1, 1_700_000_124), (2, 1_700_000_190), (4, "b"):
        os.rename(f"frames/{number}.png", f"frames/{name}.png")
    assert not run("run", recording, *STEREO)[2]  # seconds are no count


def test_tracking_that_was_asked_for_is_not_advised(run, tmp_path):
    write_endless(tmp_path, 0, None, None, 0)
    _, out, err = run("run", tmp_path, "--track", "--out", "press.npz")
    assert "1 whose numbers may be wrong" in out
    assert err.splitlines()[-1].endswith("show a border of the pattern in every frame")


def test_a_calibration_that_does_not_fit_or_is_missing_is_noticed_at_rest(run, recording, press):
    swapped = StereoRig(RIG.K2, RIG.D2, RIG.K1, RIG.D1, RIG.R.T, -RIG.R.T @ RIG.T)
    swapped.save("rig.yaml")
    at_rest = "frame 0, the frame at rest"
    fails_in_one_line(run("run", recording, *STEREO), at_rest, "the rig fits", "left")
    cv2.imwrite("blank.png", np.full_like(press[0].frame, 90))
    fails_in_one_line(run("run", "blank.png", "--out", "a.npz"), at_rest, "need --stereo")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["frames", *STEREO, "--rest-frame", "9"], ["no --rest-frame 9", "3 frames"]),
        (["frames", *STEREO, "--out", "press.mat"], ["press.mat", ".npz"]),
        (["frames", "--out", "a.npz", "--mirror", "left"], ["--stereo"]),
        (["frames", *STEREO, "--split", "1,2,3"], ["X,Y,WIDTH,HEIGHT"]),
        (["--left", "frames", *STEREO], ["--right"]),
        (["--left", "frames", "--right", "frames", "--out", "a.npz"], ["--stereo"]),
        (["--left", "frames", "--right", "frames", "--mirror", "left", *STEREO], ["--split"]),
        (["0", "--set", "fps", *STEREO], ["--set: 'fps' is not NAME=VALUE"]),
        (["frames", "--out", "a.npz", "--cell", "2", "--stereo", "rig.yaml"], ["for one view"]),
    ],
)
def test_a_wrong_argument_is_one_line_and_no_file(run, recording, tmp_path, arguments, words):
    fails_in_one_line(run("run", *arguments), *words)
    assert not list(tmp_path.glob("*.npz"))


# What is written


def test_the_live_view_is_in_a_browser_at_the_address_that_is_told(run, recording, monkeypatch):
    shown = []
    monkeypatch.setattr(LiveView, "show", lambda view, draw: shown.append(draw()))
    status, _, err = run("run", recording, *STEREO, "--show")
    assert status == 0
    assert re.fullmatch(r"cmp-cl: .* http://127\.0\.0\.1:\d+: open it in a browser\n", err)
    assert len(shown) == 3
    assert shown[0].shape[1] > VIEW[1]


def test_a_pipe_gets_json_lines_alone_and_the_report_goes_to_stderr(press, tmp_path):
    write_video(tmp_path / "left.avi", [shot.left.image for shot in press])
    video = str(tmp_path / "left.avi")
    command = [sys.executable, "-m", "cmp_cl", "run", video, "--grid", "12x12"]
    done = subprocess.run([*command, "--out", "-"], capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[0]["units"]["xy"] == lines[0]["units"]["displacement"] == "px"
    assert lines[0]["device"]
    assert [line["frame"] for line in lines[1:]] == list(range(len(lines) - 1))
    assert "wrote -" in done.stderr


def test_a_sheet_and_one_annotated_video_are_written(run, recording, press):
    status, out, _ = run("run", recording, *STEREO, "--plot", "shown.png")
    assert (status, out.splitlines()[-2:]) == (0, ["wrote shown.png", "wrote shown.mp4"])
    capture = cv2.VideoCapture("shown.mp4")
    pictures = [capture.read()[1] for _ in range(len(press) + 3)]
    assert sum(each is not None for each in pictures) == len(press)
    assert pictures[0][0, -1].any()  # the picture is as wide as the colour bar below it
    sheet = cv2.imread("shown.png")
    assert run("plot", "press.npz", "--out", "same.png")[0] == 0
    np.testing.assert_array_equal(cv2.imread("same.png"), sheet)


def test_cells_of_known_side_give_lengths_and_strain_in_the_plane(run):
    os.mkdir("frames")
    for number, stretch in enumerate((1.0, 1.01)):
        camera = boards.homography(np.array([[12 * stretch, 0, 36], [0, 12, 36], [0, 0, 1]]))
        picture = boards.drawn(camera, (190, 190), (12, 12), noise=0, count=8).image
        cv2.imwrite(f"frames/{number}.png", picture)
    flat = "run", "frames", "--grid", "12x12", "--out", "flat.h5"
    assert run(*flat, "--strain", "--cell", "2.5")[0] == 0
    found = read_series("flat.h5")
    assert str(found["unit"]) == "mm"
    steps = np.linalg.norm(np.diff(found["rest"], axis=1), axis=2)
    np.testing.assert_allclose(steps, 2.5, atol=0.02)
    moved = found["displacement"][1, 3, 6] - found["displacement"][1, 3, 0]
    assert np.abs(moved).max() == pytest.approx(0.01 * 6 * 2.5, rel=0.05)
    assert found["principal"][1, 3, 3] == pytest.approx([(1.01**2 - 1) / 2, 0], abs=1e-3)
    np.testing.assert_array_equal(found["xy_rest"], found["xy"][0])


def test_a_lens_that_bends_a_flat_pattern_is_told(run):
    picture = drawn(12, 12)[0]
    y, x = np.mgrid[-1:1:380j, -1:1:380j].astype(np.float32)
    for bent, told in ((0.06, True), (0.0, False)):
        by = 1 + bent * (x**2 + y**2)
        seen = cv2.remap(picture, 189.5 * (1 + x * by), 189.5 * (1 + y * by), cv2.INTER_CUBIC)
        cv2.imwrite("sheet.png", seen)
        status, _, err = run("run", "sheet.png", "--cell", "1", "--out", "sheet.npz")
        assert status == 0
        assert ("cells are off from squares by" in err) == told


def test_a_video_of_12_bits_is_measured_without_options_and_keeps_its_times(run):
    picture, _ = drawn(12, 12)
    write_deep_video("deep.mkv", picture.astype(np.uint16) << 3)  # in half of the light
    assert run("run", "deep.mkv", "--grid", "12x12", "--out", "deep.npz")[0] == 0
    assert read_series("deep.npz")["time_ms"] == pytest.approx([0, 35, 110])
    status, out, _ = run("detect", "deep.mkv", "--grid", "12x12")
    assert (status, "144.0 of 144 nodes" in out) == (0, True)
