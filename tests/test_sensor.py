"""A sensor for robots: frames from a thread, as a script for PyTac3D takes them."""

import contextlib
import dataclasses
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from children import python
from gels import NODES, RIG, SPLIT, pressed
from videos import camera_of, write_video

from cmp_cl import ConfigError, FieldError, GridError, ImageError
from cmp_cl.measure import Sensor, TwoViews, pytac3d
from cmp_cl.measure.sensor import Frames
from cmp_cl.media import read_frames, write_image
from cmp_cl.media.ahead import Ahead
from cmp_cl.series import SeriesWriter, read_series

SCRIPT = """
got = []
def receive(frame, param):
    got.append((param, frame["SN"], frame["index"], frame["3D_Displacements"]))
sensor = PyTac3D.Sensor(recvCallback=receive, port=9988, maxQSize=5, callbackParam="mine")
sensor.waitForFrame()
frame = sensor.getFrame()
forces = frame.get("3D_Forces")
"""


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Return the path of a video: at rest, pressed twice."""
    path = tmp_path_factory.mktemp("sensor") / "press.mp4"
    write_video(path, [pressed(severity).frame for severity in (0.0, 0.3, 0.6)], "mp4v")
    return str(path)


def fields(video, rest=0):
    frames = [frame.image for frame in read_frames(video)]
    with TwoViews(frames[rest], RIG, SPLIT, shape=NODES) as measure:
        return [measure(frame).field.displacement.reshape(-1, 3) for frame in frames]


def all_frames(sensor):
    """Return the frames until the source ends."""
    found = []
    with contextlib.suppress(ImageError):
        while True:
            sensor.waitForFrame(timeout=60)
            found.append(sensor.getFrame())
    with pytest.raises(ImageError, match="has ended"):
        sensor.waitForFrame()
    return found


def test_a_script_for_pytac3d_runs_with_only_its_import_changed(video, tmp_path):
    RIG.save(tmp_path / "rig.yaml")
    names = {"PyTac3D": pytac3d(video, tmp_path / "rig.yaml", shape=NODES, serial="gel-1")}
    exec(SCRIPT, names)
    with names["sensor"] as sensor:
        all_frames(sensor)
    assert names["forces"] is None
    assert [entry[:3] for entry in names["got"]] == [("mine", "gel-1", k) for k in range(3)]
    for (*_, moved), expected in zip(names["got"], fields(video), strict=True):
        np.testing.assert_allclose(moved, expected, atol=1e-4)


def test_what_was_recorded_is_replayed_at_its_times(video, tmp_path):
    path = tmp_path / "press.npz"
    sensor = Sensor(video, RIG, shape=NODES, maxQSize=9)
    with sensor:
        sensor.record(path)
        live = all_frames(sensor)
    recorded = read_series(path)["index"]
    start = time.monotonic()
    with Sensor.replay(path, serial="again", maxQSize=9) as replayed:
        again = all_frames(replayed)
        took = again[-1]["sendTimestamp"] - again[0]["sendTimestamp"]
        assert time.monotonic() - start > 0.9 * took
    assert [frame["index"] for frame in again] == list(recorded)
    by_index = {frame["index"]: frame for frame in live}
    for frame in again:
        assert frame["SN"] == "again"
        for key in ("3D_Positions", "3D_Displacements", "3D_Normals", "sendTimestamp"):
            np.testing.assert_allclose(frame[key], by_index[frame["index"]][key], atol=1e-6)


def test_a_process_that_ends_without_a_word_completes_its_series(video, tmp_path):
    RIG.save(tmp_path / "rig.yaml")
    script = f"""
from cmp_cl.measure import Sensor
sensor = Sensor({video!r}, "rig.yaml", shape={NODES})
sensor.record("press.npz")
sensor.waitForFrame()
"""
    python("-c", script, cwd=tmp_path, check=True)
    assert len(read_series(tmp_path / "press.npz")["index"]) >= 1


def test_a_replay_begins_at_once_and_is_closed_in_a_pause(tmp_path):
    """The series was recorded when its source had run for a day."""
    path = tmp_path / "press.npz"
    with SeriesWriter(path, rest=np.ones((3, 3, 3)), unit="mm") as series:
        for number in range(2):
            time_ms = 86_400e3 + 1e99 * number
            series.append(index=number, time_ms=time_ms, displacement=np.zeros((3, 3, 3)))
    with Sensor.replay(path) as replayed:
        replayed.waitForFrame(timeout=20)
        start = time.monotonic()
    assert time.monotonic() - start < 5


def test_frames_tell_whether_they_may_be_wrong(tmp_path, monkeypatch):
    """The right camera is knocked; the numbers are as if no border were in view."""
    frames = [pressed(0.0).frame, pressed(0.0).frame.copy()]
    width = frames[0].shape[1] // 2
    frames[1][:, width:] = np.roll(frames[1][:, width:], 3, axis=0)
    for number, frame in enumerate(frames):
        write_image(tmp_path / f"{number}.png", frame)
    measured = TwoViews.__call__
    monkeypatch.setattr(
        TwoViews,
        "__call__",
        lambda view, frame: dataclasses.replace(measured(view, frame), ambiguous=True),
    )
    with Sensor(str(tmp_path), RIG, shape=NODES) as sensor:
        sensor.record(tmp_path / "press.npz")
        live = all_frames(sensor)
    with Sensor.replay(tmp_path / "press.npz") as replayed:
        again = all_frames(replayed)
    for frames in (live, again):
        assert [frame["ambiguous"] for frame in frames] == [False, True]  # rest has its own numbers
        assert [frame["misfit"] for frame in frames] == [False, True]


def test_a_camera_that_is_unplugged_is_told_to_those_who_wait_and_those_who_ask(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", camera_of([pressed(0.0).frame]))
    with Sensor(0, RIG, shape=NODES) as sensor:
        sensor.waitForFrame(timeout=60)
        assert sensor.getFrame()["index"] == 0
        for call in (sensor.waitForFrame, sensor.getFrame):
            with pytest.raises(ImageError, match="0 delivers no frames any more: was it unplugged"):
                call()


def test_behind_a_slow_callback_only_the_newest_frames_of_a_camera_wait(monkeypatch):
    called, all_came, got = threading.Event(), threading.Event(), []

    def images():
        yield pressed(0.0).frame
        called.wait(60)
        for _ in range(20):
            yield pressed(0.0).frame
        all_came.set()

    def receive(frame, _):
        called.set()
        all_came.wait(60)
        got.append(frame["index"])

    monkeypatch.setattr(cv2, "VideoCapture", camera_of(images()))
    settings = {"shape": NODES, "recvCallback": receive, "maxQSize": 3}
    with contextlib.suppress(ImageError), Sensor(0, RIG, **settings) as sensor:
        while True:
            sensor.waitForFrame(timeout=60)
            sensor.getFrame()
    assert got == [0, 18, 19, 20]


def test_a_new_rest_is_taken_while_running(video):
    got, made = [], threading.Event()

    def receive(frame, _):
        made.wait(60)
        got.append(frame["3D_Displacements"])
        if frame["index"] == 0:
            sensor.calibrate()

    with Sensor(video, RIG, shape=NODES, recvCallback=receive) as sensor:
        made.set()
        all_frames(sensor)
    np.testing.assert_allclose(got[1], 0, atol=1e-4)
    np.testing.assert_allclose(got[2], fields(video, rest=1)[2], atol=1e-4)


def test_a_series_that_begins_after_calibrate_has_the_new_rest(video, tmp_path, monkeypatch):
    path, measured = tmp_path / "press.npz", TwoViews.__call__
    frames = [frame.image for frame in read_frames(video)]

    def asked_meanwhile(measure, frame):
        if np.array_equal(frame, frames[0]):
            sensor.calibrate()
            sensor.record(path)
        return measured(measure, frame)

    monkeypatch.setattr(TwoViews, "__call__", asked_meanwhile)
    with Sensor(video, RIG, shape=NODES) as sensor:
        all_frames(sensor)
    series = read_series(path)
    assert list(series["index"]) == [1, 2]
    np.testing.assert_allclose(series["displacement"][0], 0, atol=1e-4)


def test_of_frames_that_nobody_takes_the_newest_stay(video):
    last = threading.Event()

    def receive(frame, _):
        if frame["index"] == 2:
            last.set()

    with Sensor(video, RIG, shape=NODES, maxQSize=2, recvCallback=receive) as sensor:
        assert last.wait(60)
        assert [sensor.getFrame()["index"] for _ in range(2)] == [1, 2]
        assert sensor.getFrame() is None


def test_of_two_threads_one_takes_a_frame(monkeypatch):
    both, wait = threading.Barrier(2), Ahead.wait

    def waited(ahead, seconds):
        found = wait(ahead, seconds)
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(0.2)
        return found

    with Frames({"index": number} for number in range(1)) as frames:
        frames.waitForFrame(timeout=60)
        monkeypatch.setattr(Ahead, "wait", waited)
        with ThreadPoolExecutor(2) as threads:
            taken = list(threads.map(lambda _: frames.getFrame(), range(2)))
    assert taken.count(None) == 1


def test_errors_reach_the_caller(video, tmp_path):
    def fail(frame, _):
        raise RuntimeError("the user's")

    with Sensor(video, RIG, recvCallback=fail) as sensor:
        sensor.waitForFrame(timeout=60)
        sensor.getFrame()
        with pytest.raises(RuntimeError, match="user's"):
            sensor.waitForFrame(timeout=60)
    with Sensor(video, RIG, shape=(13, 40)) as sensor, pytest.raises(GridError):
        sensor.waitForFrame(timeout=60)
    with pytest.raises(ConfigError, match="maxQSize must be an integer in"):
        Sensor(video, RIG, maxQSize=0)
    with pytest.raises(FileNotFoundError):
        Sensor(str(tmp_path / "none.mp4"), RIG)
    with Sensor(video, RIG, shape=NODES) as sensor:
        sensor.record(tmp_path / "one.npz")
        with pytest.raises(ConfigError, match="being recorded"):
            sensor.record(tmp_path / "two.npz")
        with pytest.raises(ConfigError, match="stop recording first"):
            sensor.calibrate()
        sensor.record(None)
        for path, error in (("one.txt", ConfigError), ("none/one.npz", FileNotFoundError)):
            with pytest.raises(error):  # here, and no error that ends the loop
                sensor.record(tmp_path / path)
        assert all_frames(sensor)
        with pytest.raises(ImageError, match="has ended"):
            sensor.record(tmp_path / "late.npz")
    plane = tmp_path / "plane.npz"
    np.savez(
        plane,
        index=[0],
        time_ms=[0.0],
        rest=np.zeros((3, 3, 2)),
        displacement=np.zeros((1, 3, 3, 2)),
    )
    nothing = np.zeros((3, 3, 3))
    with SeriesWriter(tmp_path / "bare.npz", rest=nothing) as bare:
        bare.append(index=0, time_ms=0, displacement=nothing)
    for path in (plane, tmp_path / "bare.npz"):
        with pytest.raises(FieldError, match="in space, of two views, with its unit"):
            Sensor.replay(path)
