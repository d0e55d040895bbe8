"""demo, run and calibrate as a user has them, on small rendered frames."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from cases import some
from disks import full_after
from lattices import drawn
from messages import fails_in_one_line
from plane_images import moved_board
from stereo_data import bumblebee_rig, grid_of, photographs
from videos import write_deep_video, write_video

from cmp_cl import (
    BinocularSplit,
    ConfigError,
    DetectorConfig,
    DeviceError,
    EdgeLines,
    GridError,
    NodeStatus,
    StereoRig,
    media,
    select_device,
)
from cmp_cl.cli import demo
from cmp_cl.cli.arguments import region_in, split_of
from cmp_cl.grid.align import align
from cmp_cl.measure import TwoViews, find_board, square_sides, trusted
from cmp_cl.media import Frame
from cmp_cl.series import SeriesWriter, read_series
from cmp_cl.synthetic import (
    Indenter,
    Mode,
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    render_stereo,
)

CLOSE = 0.05  # mm, a third of a pixel
VIEW = (240, 216)
RIG = default_rig(VIEW)
GEL = Scene(markers=12, shape=VIEW, indenter=Indenter.TORUS, mode=Mode.TWIST, seed=5)


class Shot(NamedTuple):
    """A rendered frame: its views, both in one image, and its nodes in space, mm."""

    left: Rendered
    right: Rendered
    xyz: np.ndarray

    @property
    def frame(self):
        return binocular_frame(self.left, self.right)


@pytest.fixture(scope="session")
def press():
    """Return frames of a gel at rest and pressed more and more."""
    return [
        Shot(*render_stereo(dataclasses.replace(GEL, severity=severity), RIG))
        for severity in (0.0, 0.4, 0.9)
    ]


@pytest.fixture
def recording(press, tmp_path):
    """Return a folder with these frames, and the rig's file beside it."""
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, shot in enumerate(press):
        cv2.imwrite(str(folder / f"{number}.png"), shot.frame)
    StereoRig(*RIG).save(tmp_path / "rig.yaml")
    return folder


@pytest.fixture
def one_view(press, tmp_path):
    """Return a folder with the left views."""
    folder = tmp_path / "left"
    folder.mkdir()
    for number, shot in enumerate(press):
        cv2.imwrite(str(folder / f"{number}.png"), shot.left.image)
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


# run


def test_a_recording_becomes_its_displacements(run, recording, press):
    status, out, err = run("run", recording, *STEREO)
    assert (status, err) == (0, "")
    assert "wrote press.npz: 3 frames; 144.0 of 144 nodes" in out
    assert str(select_device()) in out
    series = np.load("press.npz")
    assert series["index"].tolist() == [0, 1, 2]
    assert series["displacement"].shape == (3, 12, 12, 3)
    assert str(series["unit"]) == "mm"
    # The kernels compute the field, and NumPy the positions at rest: a nanometre apart.
    np.testing.assert_allclose(series["displacement"][0], 0, rtol=0, atol=1e-6)
    assert max(off_by(series, press, (0, 1, 2))) < CLOSE
    moved = np.linalg.norm(press[2].xyz - press[0].xyz, axis=2).max()
    assert moved > 1
    assert f"moved by up to {np.linalg.norm(series['displacement'][2], axis=2).max():.3g} mm" in out


def test_the_order_of_the_frames_does_not_matter(run, recording, press, tmp_path):
    run("run", recording, *STEREO)
    forward = np.load("press.npz")
    other = tmp_path / "other"
    other.mkdir()
    for place, number in enumerate((2, 0, 1)):
        cv2.imwrite(str(other / f"{place}.png"), press[number].frame)
    status, _, _ = run("run", other, *STEREO, "--rest-frame", 1)
    assert status == 0
    shuffled = np.load("press.npz")
    for name in ("displacement", "sigma", "status", "source", "left", "right"):
        np.testing.assert_array_equal(shuffled[name], forward[name][[2, 0, 1]])


def test_broken_frames_and_frames_without_the_pattern_do_not_end_a_run(run, recording, press):
    (recording / "1a.png").write_bytes(b"broken")
    cv2.imwrite(str(recording / "1b.png"), press[1].frame[:-1])
    cv2.imwrite(str(recording / "1c.png"), np.full_like(press[0].frame, 90))
    status, out, err = run("run", recording, *STEREO)
    assert status == 0
    assert "frame 2 cannot be read and is skipped: " in err
    assert "1a.png' is not an image that OpenCV can read" in err
    assert "frame 3 is 432 x 239 px" in err
    assert "1 without the pattern; 2 left out" in out
    series = np.load("press.npz")
    assert series["index"].tolist() == [0, 1, 4, 5]
    assert np.isnan(series["displacement"][2]).all()
    assert (series["status"][2] == 0).all()
    assert off_by(series, press, (0, 1, 0, 2))[3] < CLOSE


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


def test_one_view_gives_positions_in_the_image(run, recording, press):
    for number, shot in enumerate(press):
        cv2.imwrite(str(recording / f"{number}.png"), shot.left.image)
    status, out, _ = run("run", recording, "--out", "flat.npz")
    assert status == 0
    assert "px (frame 2)" in out
    series = np.load("flat.npz")
    assert series["xy"].shape == (3, 12, 12, 2)
    off = series["xy"][2] - press[2].left.truth
    assert np.sqrt(np.mean(np.square(off).sum(axis=2))) < 0.4
    assert (series["source"] == NodeStatus.DETECTED).all()
    assert np.isfinite(series["sigma"]).mean() > 0.98


def test_run_uses_the_settings_of_a_file(run, recording):
    DetectorConfig.for_cell(15).replace(refinement=EdgeLines()).save("cmp.toml")
    run("run", recording, *STEREO)
    default = np.load("press.npz")["displacement"]
    assert run("run", recording, *STEREO, "--config", "cmp.toml")[0] == 0
    other = np.load("press.npz")["displacement"]
    assert np.nanmax(np.abs(other - default)) > 1e-5


def test_a_video_has_a_clock(run, recording, press):
    write_video("a.avi", [shot.frame for shot in press])
    assert run("run", "a.avi", *STEREO)[0] == 0
    series = np.load("press.npz")
    np.testing.assert_allclose(series["time_ms"], [0, 40, 80])
    assert max(off_by(series, press, (0, 1, 2))) < CLOSE


def camera_of(images, opened):
    """Return a stand-in for cv2.VideoCapture that delivers these images, None for a missed one."""

    class Camera:
        def __init__(self, number):
            opened.append(number)
            self.left = iter(images)

        def isOpened(self):
            return bool(images)

        def set(self, *_):
            return True

        def read(self):
            image = next(self.left, None)
            return image is not None, image

        def release(self):
            opened.append("released")

    return Camera


@pytest.mark.parametrize(
    ("camera", "known_as"), [(["3"], 3), (["/dev/video3", "--camera-fps", "50"], "/dev/video3")]
)
def test_a_camera_runs_until_ctrl_c(run, recording, press, monkeypatch, camera, known_as):
    append = SeriesWriter.append

    def press_ctrl_c_after_three(series, **frame):
        append(series, **frame)
        if len(series) == 3:
            signal.raise_signal(signal.SIGINT)

    rest, *others = (shot.frame for shot in press)
    images = [press[2].frame, None, rest, None, *others, rest, press[1].frame]
    opened = []
    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images, opened))
    monkeypatch.setattr(SeriesWriter, "append", press_ctrl_c_after_three)
    before = signal.getsignal(signal.SIGINT)
    status, out, err = run("run", *camera, *STEREO, "--rest-frame", 2)
    assert status == 0
    assert opened == [known_as, "released"]
    assert out.startswith("stopped by Ctrl-C; wrote press.npz: ")
    assert "; 1 left out" in out
    assert "limited by" in out
    assert err.startswith("cmp-cl: frame 3 is missing")
    assert err.count("\n") == 1
    series = np.load("press.npz")
    count = len(series["index"])  # those that were measured by then are written
    assert 3 <= count <= 5
    assert series["index"].tolist() == [2, 4, 5, 6, 7][:count]
    assert (np.diff(series["time_ms"]) >= 0).all()
    assert max(off_by(series, press, (0, 1, 2, 0, 1)[:count])) < CLOSE
    assert signal.getsignal(signal.SIGINT) is before


def test_a_camera_that_is_not_there_is_an_error(run, recording, monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([], []))
    fails_in_one_line(run("run", "7", *STEREO), "no camera 7")


def test_a_camera_that_delivers_nothing_is_an_error(run, recording, monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([None], []))
    fails_in_one_line(run("run", "7", *STEREO), "no frame comes from '7'")


STOPS = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@pytest.fixture
def without_nohup():
    """Restore SIGHUP in a process that nohup has started."""
    if not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("without_nohup")
@pytest.mark.parametrize("times", [1, 2])
@pytest.mark.parametrize("name", some(STOPS, ("SIGINT", "SIGTERM")))
def test_a_stopped_run_keeps_what_it_has(run, recording, monkeypatch, name, times):
    measure, calls = TwoViews.__call__, []

    def measuring(self, frame):
        calls.append(frame)
        if len(calls) == 2:
            for _ in range(times):
                signal.raise_signal(getattr(signal, name))
        return measure(self, frame)

    monkeypatch.setattr(TwoViews, "__call__", measuring)
    before = [signal.getsignal(getattr(signal, stop)) for stop in STOPS]
    status, out, _ = run("run", recording, *STEREO)
    assert status == 130
    assert not out if times == 2 else out.startswith("stopped by")
    # The first signal lets the frame be finished, the second does not.
    assert np.load("press.npz")["index"].tolist() == ([0, 1] if times == 1 else [0])
    assert [signal.getsignal(getattr(signal, stop)) for stop in STOPS] == before


def test_doubts_about_the_frame_at_rest_are_told(run, tmp_path):
    frame = np.full((400, 700), 210, np.uint8)
    for (left, top), (image, _) in zip(
        ((0, 0), (320, 40)), (drawn(9, 9), drawn(5, 6)), strict=True
    ):
        frame[top : top + len(image), left : left + image.shape[1]] = image
    cv2.imwrite(str(tmp_path / "0.png"), frame)
    status, _, told = run("run", tmp_path, "--out", "press.npz")
    assert status == 0
    assert told.startswith("cmp-cl: frame 0, the frame at rest: another pattern of 30 corners")
    assert not run("run", tmp_path, "--grid", "9x9", "--out", "press.npz")[2]


def test_the_numbers_of_the_frame_at_rest_are_not_ambiguous(run, tmp_path):
    board = np.kron(np.indices((9, 11)).sum(0) % 2, np.full((20, 20), 180)).astype(np.uint8) + 30
    for number in range(2):  # no border of the pattern is in view
        cv2.imwrite(str(tmp_path / f"{number}.png"), board[10:170, 10:210])
    _, out, err = run("run", tmp_path, "--out", "press.npz")
    assert "1 whose numbers may be wrong" in out
    assert "trust none of them" in err
    assert "--track" in err
    assert np.load("press.npz")["ambiguous"].tolist() == [False, True]


def test_a_run_stopped_before_its_first_frame_keeps_an_older_series(
    run, recording, press, monkeypatch
):
    enter = SeriesWriter.__enter__

    def stopped(series):
        signal.raise_signal(signal.SIGINT)
        return enter(series)

    monkeypatch.setattr(SeriesWriter, "__enter__", stopped)
    older = ["press.npz", "old.mp4", "old.png"]
    options = ["--plot", "old"]
    for name in older:
        Path(name).write_text("old")
    assert run("run", recording, *STEREO, *options) == (130, "", "cmp-cl: interrupted\n")
    assert [Path(name).read_text() for name in older] == ["old"] * len(older)
    assert not [entry for entry in Path().iterdir() if entry.name.startswith(".")]


@pytest.mark.parametrize("frames", [0, 2])
def test_an_error_in_the_middle_of_a_run_keeps_the_frames_before_it(
    run, recording, monkeypatch, frames
):
    Path("press.npz").write_text("old")
    append = SeriesWriter.append

    def failing(series, **frame):
        if len(series) == frames:
            raise DeviceError("the device is lost")
        append(series, **frame)

    monkeypatch.setattr(SeriesWriter, "append", failing)
    status, out, err = run("run", recording, *STEREO)
    assert (status, err) == (2, "cmp-cl: the device is lost\n")
    if frames:
        assert out.startswith("wrote press.npz: 2 frames")
        assert np.load("press.npz")["index"].tolist() == [0, 1]
    else:
        assert Path("press.npz").read_text() == "old"


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="there is no SIGHUP here")
def test_a_run_that_nohup_started_goes_on(run, recording, press, monkeypatch):
    def frames_of(path, **_):
        signal.raise_signal(signal.SIGHUP)
        yield Frame(0, press[int(path.stem)].frame)

    monkeypatch.setattr("cmp_cl.media.read_frames", frames_of)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run("run", recording, *STEREO)[0] == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert len(np.load("press.npz")["index"]) == len(press)


@pytest.mark.skipif(os.name == "nt", reason="sizes of files have no limits on Windows")
def test_a_disk_that_fills_up_ends_a_run_with_what_it_has(run, recording, press, monkeypatch):
    append = SeriesWriter.append

    def filling(series, **frame):
        with full_after(5000 if len(series) == 2 else 10**9):
            append(series, **frame)

    monkeypatch.setattr(SeriesWriter, "append", filling)
    status, out, err = run("run", recording, *STEREO)
    assert status == 2
    assert "wrote press.npz: 2 frames" in out
    assert (err.count("\n"), "press.npz: File too large" in err) == (1, True)
    assert np.load("press.npz")["index"].tolist() == [0, 1]


@pytest.mark.skipif(os.name == "nt", reason="sizes of files have no limits on Windows")
def test_a_sheet_that_a_full_disk_cuts_is_not_written_but_the_series_is(
    run, recording, press, monkeypatch
):
    Path("old.png").write_text("old")
    close = SeriesWriter.close

    def filling(series):
        close(series)
        disk.enter_context(full_after(10_000))

    with contextlib.ExitStack() as disk:
        monkeypatch.setattr(SeriesWriter, "close", filling)
        status, out, err = run("run", recording, *STEREO, "--plot", "old.png")
    assert status == 2
    assert (err.count("\n"), "old.png: File too large" in err) == (1, True)
    assert "old.png" not in out
    assert Path("old.png").read_text() == "old"
    assert len(np.load("press.npz")["index"]) == len(press)


def test_ctrl_c_while_the_series_is_written_loses_nothing(run, recording, press, monkeypatch):
    close = SeriesWriter.close

    def closing(series):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        close(series)

    monkeypatch.setattr(SeriesWriter, "close", closing)
    before = signal.getsignal(signal.SIGINT)
    status, _, _ = run("run", recording, *STEREO)
    assert status == 0
    assert len(np.load("press.npz")["index"]) == len(press)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none", *STEREO], ["none"]),
        (["frames", *STEREO, "--rest-frame", "9"], ["no --rest-frame 9", "3 frames"]),
        (["frames", *STEREO, "--rest-frame", "-1"], ["0 or more"]),
        (["frames", *STEREO, "--rest-frame", "x"], ["'x' is not a whole number"]),
        (["frames", *STEREO, "--split", "thirds"], ["halves", "thirds"]),
        (["frames", *STEREO, "--split", "0,0,9999,9:0,0,9,9"], ["extends past the frame"]),
        (["frames", *STEREO, "--grid", "0x3"], ["0x3"]),
        (["frames", *STEREO, "--device", "abacus"], ["abacus"]),
        (["frames", *STEREO, "--out", "press.mat"], ["press.mat", ".npz"]),
        (["frames", *STEREO, "--out", "no/press.npz"], ["there is no folder", "no'"]),
        (["frames", *STEREO, "--stereo", "frames/0.png"], ["frames/0.png"]),
        (["frames", "--out", "a.npz", "--split", "halves"], ["--stereo"]),
        (["frames", *STEREO, "--region", "1,2,3"], ["X,Y,WIDTH,HEIGHT"]),
        (["frames", *STEREO, "--region", "1,2,0,3:1,1,2,2"], ["X,Y,WIDTH,HEIGHT"]),
        (["frames", *STEREO, "--region", "0,0,99,99"], ["one rectangle per view"]),
        (["frames", "--out", "a.npz", "--region", "9999,0,9,9"], ["9999,0,9,9", "outside"]),
    ],
)
def test_a_wrong_argument_of_run_is_one_line_and_no_file(
    run, recording, tmp_path, arguments, words
):
    fails_in_one_line(run("run", *arguments), *words)
    assert not list(tmp_path.glob("*.npz"))


def test_the_wrong_calibration_is_noticed_at_rest(run, recording):
    swapped = StereoRig(RIG.K2, RIG.D2, RIG.K1, RIG.D1, RIG.R.T, -RIG.R.T @ RIG.T)
    swapped.save("rig.yaml")
    fails_in_one_line(
        run("run", recording, *STEREO), "frame 0, the frame at rest", "the rig fits", "left"
    )


def test_two_views_without_a_calibration_are_explained(run, recording, monkeypatch):
    def two(*_, **__):
        raise GridError("two patterns are seen")

    monkeypatch.setattr("cmp_cl.measure.views.find_pattern", two)
    fails_in_one_line(
        run("run", recording, "--out", "a.npz"),
        "frame 0, the frame at rest: two patterns",
        "--stereo",
    )


def test_a_rectangle_in_each_view_selects_one_of_two_patterns(run, recording, press, tmp_path):
    run("run", recording, *STEREO)
    alone = np.load("press.npz")
    doubled = tmp_path / "doubled"
    doubled.mkdir()
    other = press[0].right.image
    for number, shot in enumerate(press):
        frame = np.hstack([other, shot.left.image, other, shot.right.image])
        cv2.imwrite(str(doubled / f"{number}.png"), frame)
    StereoRig(*shifted(RIG, VIEW[1])).save("rig.yaml")
    wide = 2 * VIEW[1]
    fails_in_one_line(run("run", doubled, *STEREO), "the left view", "two patterns", "region")
    boxes = [f"{x},0,{VIEW[1]},{VIEW[0]}" for x in (VIEW[1], wide + VIEW[1])]
    status, _, err = run("run", doubled, *STEREO, "--region", ":".join(boxes))
    assert (status, err) == (0, "")
    series = np.load("press.npz")
    np.testing.assert_array_equal(series["status"], alone["status"])
    for view in ("left", "right"):
        np.testing.assert_allclose(series[view], alone[view] + [VIEW[1], 0], atol=1e-4)
    apart = np.abs(series["displacement"] - alone["displacement"]).max(axis=-1)
    # sigma compares a corner with the median of its whole frame, and weighs the two views
    assert (apart <= 0.1 * alone["sigma"] + 1e-6).all()  # mm: at rest sigma is 0
    status, _, err = run("run", doubled, "--out", "one.npz", "--region", boxes[0])
    assert (status, err) == (0, "")
    one = np.load("one.npz")["rest"]
    assert one.shape == (12, 12, 2)
    assert (one[..., 0] > VIEW[1] - 0.5).all()


def shifted(rig, columns):
    """Return the rig whose views begin that much further to the left."""
    moved = np.array([[0, 0, columns], [0, 0, 0], [0, 0, 0]])
    return rig._replace(K1=rig.K1 + moved, K2=rig.K2 + moved)


@pytest.mark.parametrize("mirror", [False, True])
def test_a_region_follows_its_rectangle_into_the_view(mirror):
    frame = np.zeros((40, 90), np.uint8)
    frame[12:20, 45:70] = 1
    split = BinocularSplit((0, 0, 20, 40), (30, 5, 50, 30), mirror_right=mirror)
    y, x = np.nonzero(split(frame)[1])
    x0, y0, x1, y1 = region_in(split.right, (45, 12, 25, 8), mirror=mirror)
    assert (x.min() - x0, y.min() - y0, x1 - x.max(), y1 - y.max()) == (0.5,) * 4


def test_without_rerun_the_extra_is_named(run, recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.setenv("DISPLAY", ":0")
    fails_in_one_line(run("run", recording, *STEREO, "--show"), "pip install 'cmp-cl[view]'")
    assert not list(tmp_path.glob("*.npz"))


def test_without_its_viewer_rerun_shows_nothing_and_says_why(run, recording, tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":0")
    fails_in_one_line(run("run", recording, *STEREO, "--show"), "Viewer")
    assert not list(tmp_path.glob("*.npz"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others always have a display")
def test_without_a_display_nothing_is_measured(run, recording, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    fails_in_one_line(run("run", recording, *STEREO, "--show"), "--show", "display")
    assert not list(tmp_path.glob("*.npz"))


def test_each_frame_is_shown_as_it_is_measured(run, recording, press, monkeypatch):
    shown = []

    class Viewer(contextlib.nullcontext):
        def __init__(self):
            super().__init__(self)

        def close(self):
            pass

        def frame(self, **what):
            shown.append(what)

    monkeypatch.setattr("cmp_cl.cli.display.Viewer", Viewer)
    monkeypatch.setenv("DISPLAY", ":0")
    status, _, err = run("run", recording, *STEREO, "--show")
    assert (status, err) == (0, "")
    assert [what["index"] for what in shown] == list(range(len(press)))
    for what, shot in zip(shown, press, strict=True):
        np.testing.assert_array_equal(what["image"], shot.left.image)
        assert np.abs(what["grid"].xy - shot.left.truth).max() < 1
    assert np.nanmax(np.abs(shown[-1]["field"].displacement)) > 0.1
    assert shown[-1]["rate"] > 0


@pytest.mark.parametrize("suffix", [".h5", ".csv", ".pvd"])
def test_a_series_is_written_in_the_format_of_its_suffix(run, one_view, suffix):
    if suffix == ".h5":
        pytest.importorskip("h5py", reason="h5py is not installed")
    status, out, _ = run("run", one_view, "--grid", "12x12", "--out", f"flat{suffix}")
    assert status == 0
    assert f"wrote flat{suffix}" in out
    if suffix == ".h5":
        found = read_series("flat.h5")
        assert found["xy"].shape[1:] == (12, 12, 2)
        assert str(found["unit"]) == "px"
    elif suffix == ".csv":
        header = "frame,time_ms,row,column,displacement_x_px,"
        assert Path("flat.csv").read_text().startswith(header)
    else:
        assert len(list(Path("flat_frames").iterdir())) == Path("flat.pvd").read_text().count(
            "<DataSet"
        )


def test_a_pipe_gets_json_lines_alone_and_the_report_goes_to_stderr(one_view):
    command = [sys.executable, "-m", "cmp_cl", "run", str(one_view), "--grid", "12x12"]
    done = subprocess.run([*command, "--out", "-"], capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[0]["units"]["xy"] == "px"
    assert lines[0]["device"]
    assert [line["frame"] for line in lines[1:]] == list(range(len(lines) - 1))
    assert "wrote -" in done.stderr


def test_a_sheet_and_one_annotated_video_are_written(run, recording, press):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    status, out, _ = run("run", recording, *STEREO, "--plot", "shown")
    assert (status, out.splitlines()[-2:]) == (0, ["wrote shown.png", "wrote shown.mp4"])
    capture = cv2.VideoCapture("shown.mp4")
    assert sum(capture.read()[0] for _ in range(len(press) + 3)) == len(press)
    sheet = cv2.imread("shown.png")
    assert run("plot", "press.npz", "--out", "same.png")[0] == 0
    np.testing.assert_array_equal(cv2.imread("same.png"), sheet)
    fails_in_one_line(run("run", recording, *STEREO, "--plot", "shown.gif"), "shown.gif", ".mp4")


def test_a_part_of_an_earlier_run_is_told_and_kept(run, one_view):
    Path("flat.csv.part").write_text("of a run that was killed")
    status, _, err = run("run", one_view, "--grid", "12x12", "--out", "flat.csv")
    assert (status, err.count("\n")) == (0, 1)
    assert "flat.csv.part is of a run that was killed" in err
    assert Path("flat.csv.part").read_text() == "of a run that was killed"
    assert not Path("flat.csv.part-2").exists()


def test_the_help_of_run_fits_two_screens_with_the_rare_options_last(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = run("run", "--help")
    assert out.count("\n") <= 100
    groups = ["input:", "pattern:", "output:", "pictures:", "speed:", "rarely needed:"]
    places = [out.index(f"\n{group}") for group in groups]
    assert places == sorted(places)
    assert out.index("--config TOML ") > places[-1]


# demo


@pytest.fixture
def small_demo(monkeypatch):
    monkeypatch.setattr(demo, "VIEW", VIEW)
    monkeypatch.setattr(demo, "SCENE", dataclasses.replace(GEL, severity=0.8))


def test_demo_measures_what_it_rendered(run, small_demo, tmp_path):
    status, out, err = run("demo", "--out", "shown")
    assert (status, err) == (0, "")
    assert str(select_device()) in out
    folder = tmp_path / "shown"
    assert cv2.imread(str(folder / "sheet.png")).std() > 20
    field = np.load(folder / "field.npz")
    _, _, rest = render_stereo(demo.SCENE.at_rest(), RIG)
    _, _, now = render_stereo(demo.SCENE, RIG)
    off = np.linalg.norm(field["displacement"] - (now - rest), axis=2)
    rms = np.sqrt(np.mean(off**2))
    assert rms < CLOSE
    assert f"error of the displacement, RMS  {1e3 * rms:.1f} um" in out
    command = out.splitlines()[-1].partition("cmp-cl ")[2].split()
    assert run(*command)[0] == 0
    np.testing.assert_allclose(
        np.load("press.npz")["displacement"][1], field["displacement"], atol=1e-12
    )


def test_without_matplotlib_demo_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    fails_in_one_line(run("demo"), "pip install 'cmp-cl[plot]'")


def test_demo_does_not_write_into_a_file(run):
    with open("taken", "w") as file:
        file.write("mine")
    fails_in_one_line(run("demo", "--out", "taken"), "taken")
    fails_in_one_line(run("demo", "--device", "abacus"), "abacus")


# calibrate


@pytest.fixture(scope="session")
def boards():
    """Return frames that show a tilted board of 7 x 7 corners, 4 mm apart, to both cameras."""
    tilts = (0.4, 0.1), (-0.3, 0.3), (0.1, -0.45), (-0.4, -0.2)
    frames = []
    for number, tilt in enumerate(tilts):
        scene = Scene(
            markers=7,
            shape=VIEW,
            severity=0.0,
            corrosion=0.0,
            noise=1.0,
            tilt=tilt,
            rotation=0.1 * number,
            seed=number,
        )
        left, right, _ = render_stereo(scene, RIG)
        frames.append((left.image, right.image))
    return frames


BOARD = "--board", "7x7", "--square", "4", "--out", "rig.yaml"


def test_calibrate_finds_the_cameras_again(run, boards):
    for number, views in enumerate(boards):
        cv2.imwrite(f"{number}.png", np.hstack(views))
    cv2.imwrite("4.png", np.full((VIEW[0], 2 * VIEW[1]), 90, np.uint8))
    status, out, err = run("calibrate", "--stereo", *(f"{n}.png" for n in range(5)), *BOARD)
    assert status == 0
    assert err.startswith("cmp-cl: left out 4.png (left): no pattern of 7 x 7 corners is found")
    assert "advice: 4 different views" in out
    rig = StereoRig.load("rig.yaml")
    assert rig.K1[0, 0] == pytest.approx(RIG.K1[0, 0], rel=0.02)
    assert np.linalg.norm(rig.T) == pytest.approx(np.linalg.norm(RIG.T), rel=0.02)
    assert np.degrees(np.arccos((np.trace(rig.R @ RIG.R.T) - 1) / 2)) < 0.5
    assert float(out.split("all views: ")[1].split()[0]) < 0.1


def test_a_rectangle_in_each_view_selects_one_of_two_boards(run, boards):
    left, right = [], []
    for number, views in enumerate(boards):
        other = boards[number - 1][0]
        left.append(f"l{number}.png")
        right.append(f"r{number}.png")
        cv2.imwrite(left[-1], np.hstack([other, views[0]]))
        cv2.imwrite(right[-1], np.hstack([views[1], other]))
        cv2.imwrite(f"{number}.png", np.hstack([other, *views, other]))
    frames = [f"{number}.png" for number in range(4)]
    fails_in_one_line(run("calibrate", "--stereo", *frames, *BOARD), "two patterns")
    wide, high = VIEW[1], VIEW[0]
    boxes = f"{wide},0,{wide},{high}:{2 * wide},0,{wide},{high}"
    assert run("calibrate", "--stereo", *frames, *BOARD, "--region", boxes)[0] == 0
    of_frames = StereoRig.load("rig.yaml")
    assert of_frames.K1[0, 2] == pytest.approx(RIG.K1[0, 2] + wide, abs=3)
    assert of_frames.K2[0, 2] == pytest.approx(RIG.K2[0, 2], abs=3)
    assert np.linalg.norm(of_frames.T) == pytest.approx(np.linalg.norm(RIG.T), rel=0.02)
    files = "--left", *left, "--right", *right
    boxes = f"{wide},0,{wide},{high}:0,0,{wide},{high}"
    assert run("calibrate", *files, *BOARD, "--region", boxes)[0] == 0
    np.testing.assert_allclose(StereoRig.load("rig.yaml").K1, of_frames.K1, atol=1e-9)


def test_two_cameras_with_files_of_their_own_are_calibrated(run, boards):
    for number, (left, right) in enumerate(boards):
        cv2.imwrite(f"l{number}.png", left)
        cv2.imwrite(f"r{number}.png", right)
    left = [f"l{number}.png" for number in range(4)]
    right = [f"r{number}.png" for number in range(4)]
    assert run("calibrate", "--left", *left, "--right", *right, *BOARD, "--unit", "cm")[0] == 0
    assert StereoRig.load("rig.yaml").unit == "cm"
    fails_in_one_line(
        run("calibrate", "--left", *left, "--right", *right[:3], *BOARD), "4 of left and 3"
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["--left IMAGE... --right IMAGE..."]),
        (["0.png", "--left", "0.png", "--right", "1.png"], ["--left IMAGE... --right IMAGE..."]),
        (["--stereo", "0.png", "1.png"], ["3 different views", "not 2"]),
        (["--stereo", "0.png", "--board", "9x6"], ["looks like", "--board counts the inner"]),
        (["plain.png"], ["no view shows a board of 7 x 7 corners", "--stereo"]),
        (["--left", "0.png"], ["--left and --right need each other"]),
        (["--stereo", "--left", "0.png", "--right", "1.png"], ["--stereo is for IMAGE"]),
        (["none.png"], ["none.png"]),
        (["0.png", "--square", "0"], ["--square"]),
        (["0.png", "1.png", "./0.png"], ["0.png", "given twice"]),
        (["--left", "0.png", "--right", "0.png"], ["0.png", "given twice"]),
        (["--camera", "one=0.png", "1.png", "0.png"], ["0.png", "given twice"]),
        (["0.png", "--board", "7"], ["7"]),
        (["0.png", "--out", "rig.txt"], ["yaml"]),
        (["0.png", "--out", "no/rig.yaml"], ["there is no folder", "no'"]),
        (["--left", "0.png", "--right", "1.png", "--split", "halves"], ["--split"]),
        (["0.png", "--free-board"], ["7 x 7", "half a turn"]),
        (["--stereo", "0.png", "--region", "0,0,9,9"], ["one rectangle per camera", "2 here"]),
        (["--stereo", "0.png", "--region", "0,0,9,9:0,0,9,9"], ["0,0,9,9", "outside"]),
    ],
)
def test_a_wrong_argument_of_calibrate_is_one_line_and_no_file(
    run, boards, tmp_path, arguments, words
):
    cv2.imwrite("plain.png", np.full((120, 160), 90, np.uint8))
    for number in range(2):
        cv2.imwrite(f"{number}.png", np.hstack(boards[number]))
    fails_in_one_line(run("calibrate", *BOARD, *arguments), *words)
    assert not list(tmp_path.glob("rig.*"))


def test_uncertain_and_unseen_corners_are_left_out():
    grid = grid_of(np.ones((2, 2, 2)), sigma=0.1)
    grid.sigma[0, 1] = 0.3
    grid.status[1, 0] = NodeStatus.SECOND_LOOK
    kept = trusted(grid, 0.2)
    assert kept.valid.tolist() == [[True, False], [False, True]]
    assert np.isnan(kept.xy[0, 1]).all()
    assert kept.status[1, 0] == NodeStatus.MISSING


def test_opencvs_five_pairs_calibrate(run):
    folder = photographs("stereo_opencv")
    left, right = (sorted(folder.glob(f"{side}0?.jpg")) for side in ("left", "right"))
    status, out, _ = run(
        *("calibrate", "--left", *left, "--right", *right, "--board", "9x6", "--square", 25),
        *("--out", "rig.yaml"),
    )
    assert status == 0
    assert float(out.split("all views: ")[1].split()[0]) < 0.155
    mean, deviation = out.split("squares measure ")[1].split(" mm with a standard deviation of ")
    assert float(mean) == pytest.approx(25, abs=0.03)
    assert float(deviation.split()[0]) < 0.08


def test_a_free_board_halves_the_residuals_of_opencvs_pairs(run):
    folder = photographs("stereo_opencv")
    left, right = (sorted(folder.glob(f"{side}0?.jpg")) for side in ("left", "right"))
    status, out, _ = run(
        *("calibrate", "--left", *left, "--right", *right, "--board", "9x6", "--square", 25),
        *("--out", "rig.yaml", "--free-board"),
    )
    assert status == 0
    assert float(out.split("all views: ")[1].split()[0]) < 0.075
    assert "the board: its nodes lie up to 0." in out
    rig = StereoRig.load("rig.yaml")
    for matrix in (rig.K1, rig.K2):  # the pixels are square
        assert matrix[0, 0] == pytest.approx(matrix[1, 1], rel=5e-4)


def test_our_corners_measure_30_mm_with_the_published_calibration():
    folder = photographs("stereo_bumblebee2")
    rig, device = bumblebee_rig(folder / "stereo.yaml"), select_device()
    found = []
    for pair in range(1, 5):
        views = [
            cv2.imread(str(folder / f"{side}{pair:02}.jpg"), cv2.IMREAD_GRAYSCALE)
            for side in ("left", "right")
        ]
        points = rig.triangulate(
            *align([trusted(find_board(view, (6, 4), device=device)) for view in views])
        )
        assert points.valid.all()
        found.append(square_sides(points))
    sides = np.concatenate(found)
    assert sides.mean() == pytest.approx(30, abs=0.02)
    assert sides.std() < 0.07


# all commands


def test_a_split_is_read_as_it_is_written():
    assert split_of("halves", None, (6, 10)) == BinocularSplit.halves(10, 6)
    assert split_of("1,2,3,4:5,6,7,8", "both", (6, 10)) == BinocularSplit(
        (1, 2, 3, 4), (5, 6, 7, 8), mirror_left=True, mirror_right=True
    )
    assert split_of("halves", "left", (6, 10)).mirror_left
    assert not split_of("halves", "left", (6, 10)).mirror_right
    for text in ("", "1,2,3,4", "1,2,3,4:5,6,7", "-1,2,3,4:5,6,7,8"):
        with pytest.raises(ConfigError, match="halves"):
            split_of(text, None, (6, 10))


@pytest.fixture
def opencv_views():
    """Return the left and the right photographs of OpenCV's stereo pairs."""
    folder = photographs("stereo_opencv")
    return [sorted(folder.glob(f"{side}0?.jpg")) for side in ("left", "right")]


CHESSBOARD = "--board", "9x6", "--square", 25


def test_images_are_those_of_one_camera(run, opencv_views, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
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


def test_files_in_the_wrong_order_are_named(run, opencv_views):
    left, right = opencv_views
    views = "--left", *left, "--right", *right[:2], right[3], right[2], right[4]
    outcome = run("calibrate", *views, *CHESSBOARD, "--out", "rig.yaml")
    fails_in_one_line(outcome, "left03.jpg, right04.jpg, left04.jpg, right03.jpg")
    assert not Path("rig.yaml").exists()


def test_named_cameras_make_a_rig_that_run_takes(run, opencv_views):
    left, right = (views[:4] for views in opencv_views)
    cameras = (
        *("--camera", f"left={left[0]}", *left[1:]),
        *("--camera", f"right={right[0]}", *right[1:]),
    )
    assert run("calibrate", *cameras, *CHESSBOARD, "--out", "rig.yaml")[0] == 0
    rig = StereoRig.load("rig.yaml")
    assert np.linalg.norm(rig.T) == pytest.approx(83.2, abs=1)
    before = Path("rig.yaml").read_bytes()
    for wrong, why in (
        (["--camera", "left=gone.png"], "gone.png"),
        (["--camera", "noname.png"], "NAME=IMAGE"),
        ([*cameras, "--camera", f"third={opencv_views[0][4]}"], "1 of third"),
        ([*cameras, "--camera", f"left={left[0]}"], "twice"),
        ([*cameras, "--split", "halves"], "--split"),
        ([*cameras, "--corners", "c.mat"], "c.mat"),
    ):
        fails_in_one_line(run("calibrate", *wrong, *CHESSBOARD, "--out", "rig.yaml"), why)
        assert Path("rig.yaml").read_bytes() == before


def test_two_recordings_are_measured_as_one_of_both_views(run, recording, press):
    write_video("left.avi", [shot.left.image for shot in press])
    write_video("right.avi", [shot.right.image for shot in press])
    pair = "--left", "left.avi", "--right", "right.avi"
    status, out, _ = run("run", *pair, *STEREO)
    assert status == 0
    assert "without a partner" not in out
    apart = np.load("press.npz")
    assert apart["time_ms"].tolist() == pytest.approx([0, 40, 80])
    assert run("run", recording, *STEREO)[0] == 0
    np.testing.assert_array_equal(apart["displacement"], np.load("press.npz")["displacement"])

    write_video("right.avi", [shot.right.image for shot in press[:2]])
    status, out, _ = run("run", *pair, *STEREO)
    assert status == 0
    assert "2 frames" in out
    assert "1 left and 0 right frames without a partner" in out


def test_folders_of_which_one_has_more_images_are_not_paired_by_guess(run, recording, press):
    os.mkdir("left")
    os.mkdir("right")
    for number, shot in enumerate(press):
        media.write_image(f"left/{number}.png", shot.left.image)
        if number != 1:
            media.write_image(f"right/{number}.png", shot.right.image)
    sides = "--left", "left", "--right", "right"
    fails_in_one_line(run("run", *sides, *STEREO), "--left has 3 files and --right 2")
    assert not Path("press.npz").exists()
    os.remove("left/1.png")
    assert run("run", *sides, *STEREO)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--left", "frames", *STEREO], "--right"),
        (["--left", "frames", "--right", "frames", "--out", "a.npz"], "--stereo"),
        (["frames", "--left", "frames", "--right", "frames", *STEREO], "SOURCE"),
        ([*STEREO], "SOURCE"),
        (["--left", "frames", "--right", "gone.mp4", *STEREO], "gone.mp4"),
        (["--left", "frames", "--right", "0", *STEREO], "both be cameras"),
        (["--left", "frames", "--right", "frames", "--split", "halves", *STEREO], "--split"),
        (["frames", "--pair-within", "3", *STEREO], "--pair-within"),
        (["frames", "--exposure", "3", *STEREO], "not a camera"),
        (["0", "--camera-fps", "-3", *STEREO], "--camera-fps: '-3' is not a positive number"),
        (["0", "--pixel-format", "M", *STEREO], "four letters"),
    ],
)
def test_a_wrong_source_is_one_line_and_no_file(run, recording, tmp_path, arguments, why):
    fails_in_one_line(run("run", *arguments), why)
    assert not list(tmp_path.glob("*.npz"))


def test_two_cameras_are_paired_as_they_come(run, recording, press, monkeypatch):
    class Pair:
        """Two cameras with one clock: the left one starts two frames earlier, the right one misses
        a read."""

        def __init__(self, name):
            self.images = [shot.left.image if name == 0 else shot.right.image for shot in press]
            self.due = start + (0.0 if name == 0 else 0.4)
            if name == 0:
                self.images = self.images[:1] * 2 + self.images
            else:
                self.images.insert(1, None)

        def isOpened(self):
            return True

        def set(self, *_):
            return True

        def read(self):
            if not self.images or self.images[0] is None:
                del self.images[:1]
                return False, None
            time.sleep(max(0.0, self.due - time.monotonic()))
            self.due += 0.2
            return True, self.images.pop(0)

        def release(self):
            pass

    start = time.monotonic() + 0.1
    monkeypatch.setattr("cmp_cl.media.cameras.cv2.VideoCapture", Pair)
    status, out, _ = run("run", "--left", 0, "--right", 1, "--pair-within", 90, *STEREO)
    assert status == 0
    assert "wrote press.npz: 3 frames" in out
    assert out.rstrip().endswith("2 left and 0 right frames without a partner")
    assert max(off_by(np.load("press.npz"), press, (0, 1, 2))) < CLOSE


def test_strain_and_contact_are_in_the_series_if_requested(run, recording, press):
    status, _, err = run(
        "run", recording, *STEREO, "--strain", "--contact", "0.3", "--rest-frame", "0"
    )
    assert (status, err) == (0, "")
    found = read_series("press.npz")
    deep = np.nanmax(found["depth"], axis=(1, 2))
    np.testing.assert_allclose(found["contact_depth"], deep)
    assert (found["contact_area"] > 0).tolist() == (deep > 0.3).tolist()
    assert found["contact_area"].any()
    field = found["displacement"].shape
    assert found["strain"].shape == found["normal"].shape == field
    assert np.nanmax(found["strain_sigma"]) < 0.1


def test_cells_of_known_side_give_lengths_and_strain_in_the_plane(run):
    os.mkdir("frames")
    stretch = np.array([[1.01, 0.0], [0.0, 1.0]])
    for number, by in enumerate((np.eye(2), stretch)):
        picture = moved_board(
            (150, 150), 12, lambda q, by=by: (q - 75) @ (by - np.eye(2)).T, board=(24, 24, 120, 120)
        )
        cv2.imwrite(f"frames/{number}.png", picture)
    flat = ("run", "frames", "--grid", "7x7", "--out", "flat.npz", "--plot", "flat.mp4")
    assert run(*flat, "--strain", "--cell", "2.5", "--unit", "cm")[0] == 0
    found = read_series("flat.npz")
    assert str(found["unit"]) == "cm"
    steps = np.linalg.norm(np.diff(found["rest"], axis=1), axis=2)
    np.testing.assert_allclose(steps, 2.5, atol=0.02)
    moved = found["displacement"][1, 3, 6] - found["displacement"][1, 3, 0]
    assert np.abs(moved).max() == pytest.approx(0.01 * 6 * 2.5, rel=0.05)
    assert found["principal"][1, 3, 3] == pytest.approx([(1.01**2 - 1) / 2, 0], abs=1e-3)
    np.testing.assert_array_equal(found["xy_rest"], found["xy"][0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--cell", "2", "--stereo", "rig.yaml"), "--cell is for one view"),
        (("--contact", "2"), "--contact needs --stereo"),
        (("--unit", "cm"), "--unit needs --cell"),
        (("--cell", "0"), "not a positive number"),
        (("--contact", "nan", "--stereo", "rig.yaml"), "not a positive number"),
    ],
)
def test_lengths_that_a_view_does_not_have_are_refused(run, arguments, message):
    status, out, err = run("run", "none.avi", "--out", "a.npz", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_a_video_of_12_bits_is_measured_without_options_and_keeps_its_times(run):
    picture = moved_board((150, 150), 12, lambda q: 0 * q, board=(24, 24, 120, 120))
    write_deep_video("deep.mkv", picture.astype(np.uint16) << 3)  # in half of the light
    assert run("run", "deep.mkv", "--grid", "7x7", "--out", "deep.npz")[0] == 0
    assert read_series("deep.npz")["time_ms"] == pytest.approx([0, 35, 110])
    status, out, _ = run("detect", "deep.mkv", "--grid", "7x7")
    assert (status, "49 of 49 nodes" in out) == (0, True)


def test_frames_that_change_size_are_named_and_left_out(run):
    picture = moved_board((150, 150), 12, lambda q: 0 * q, board=(24, 24, 120, 120))
    pictures = [picture, picture[:140], picture]
    Path("a.mjpeg").write_bytes(b"".join(cv2.imencode(".jpg", p)[1].tobytes() for p in pictures))
    status, out, err = run("run", "a.mjpeg", "--grid", "7x7", "--out", "a.npz")
    assert status == 0
    assert "1 left out" in out
    assert "frame 1 is 150 x 140 px of uint8, the frame at rest is 150 x 150" in err
    assert read_series("a.npz")["index"].tolist() == [0, 2]
