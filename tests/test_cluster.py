"""A recording on two worker processes: every frame is stored once, even if a worker is killed."""

import io
import os
import threading
import time

import numpy as np
import pytest
from comparison import assert_same_bytes
from workers import broken_frame, colour_frame, frame, process, slow_frame

from cmp_cl import Detector, DetectorConfig, EdgeStep, cluster
from cmp_cl.errors import ConfigError, ImageError

distributed = pytest.importorskip("distributed")

COUNT, PART = 46, 5
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as local,
        distributed.Client(local) as connected,
    ):
        yield connected


def expected(config=None):
    with Detector(shape=frame(0).shape, config=config) as detector:
        return [detector(frame(number)) for number in range(COUNT)]


def assert_whole(store, config=None):
    assert len(store) == COUNT
    assert store.missing() == []
    found = list(store)
    assert len(found) == COUNT
    for one, other in zip(found, expected(config), strict=True):
        assert_same_bytes(one, other)
    assert len(found[0]) > 20


def test_every_frame_is_stored_once_as_one_process_finds_it(client, tmp_path):
    config = DetectorConfig(refinement=EdgeStep())
    store = cluster.detect(
        client, tmp_path / "store", count=COUNT, read=frame, config=config, part=PART
    )
    assert_whole(store, config)
    assert store.parts == 10
    reopened = cluster.open_store(tmp_path / "store")
    assert reopened == store
    assert_same_bytes(reopened[COUNT - 1], expected(config)[-1])
    with pytest.raises(IndexError):
        reopened[COUNT]


def test_a_killed_worker_loses_no_frame_and_repeats_none(client, tmp_path):
    before = set(client.run(process).values())
    done = []

    def kill_one():
        """Kill a worker when the first parts are there, in the middle of others."""
        while len(list(tmp_path.glob("store/part-*.npz"))) < 2:
            time.sleep(0.02)
        victim = min(before)
        os.kill(victim, 9)
        done.append(victim)

    killer = threading.Thread(target=kill_one)
    killer.start()
    store = cluster.detect(client, tmp_path / "store", count=COUNT, read=slow_frame, part=PART)
    killer.join()
    assert_whole(store)
    client.wait_for_workers(2, timeout=30)
    assert done[0] not in client.run(process).values()


def test_stored_parts_are_not_computed_again(client, tmp_path):
    with pytest.raises(OSError, match="frame 17"):
        cluster.detect(client, tmp_path, count=COUNT, read=broken_frame, part=PART)
    store = cluster.open_store(tmp_path)
    assert 17 // PART in store.missing()
    with pytest.raises(FileNotFoundError):
        store[17]
    kept = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("part-*.npz")}
    assert_whole(cluster.detect(client, tmp_path, count=COUNT, read=frame, part=PART))
    after = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("part-*.npz")}
    assert kept.items() <= after.items()


@pytest.mark.parametrize(
    "damage",
    ["cut", "bit", "empty", "last part", "next part", "written anew", "directory", "older"],
)
def test_a_damaged_part_is_computed_again(client, tmp_path, damage):
    cluster.detect(client, tmp_path, count=COUNT, read=frame, part=PART)
    part, last = tmp_path / "part-00000002.npz", tmp_path / "part-00000009.npz"
    whole = part.read_bytes()
    bit = bytearray(whole)
    bit[len(whole) // 2] ^= 4
    directory = bytearray(whole)
    directory[-30] ^= 4
    moved = io.BytesIO()
    with np.load(part) as arrays:
        np.savez(moved, **{**arrays, "xy": arrays["xy"] + np.float32(1)})
    older = io.BytesIO()
    with np.load(part) as arrays:
        kept = {
            name: arrays[name] for name in arrays.files if name not in ("digest", "edge_radius")
        }
    np.savez(older, digest=np.array(cluster._digest(kept, 2 * PART)), **kept)
    damaged = {
        "cut": whole[: len(whole) // 2],
        "bit": bytes(bit),
        "empty": b"",
        "last part": last.read_bytes(),  # of one frame
        "next part": (tmp_path / "part-00000003.npz").read_bytes(),  # whole, of as many frames
        "written anew": moved.getvalue(),  # a whole zip file
        "directory": bytes(directory),
        "older": older.getvalue(),  # whole, but written before a field was added
    }
    part.write_bytes(damaged[damage])
    store = cluster.open_store(tmp_path)
    assert store.missing() == [2]
    with pytest.raises(ConfigError, match="damaged"):
        store[2 * PART]
    with pytest.raises(ConfigError, match="damaged"):
        list(store)
    assert_whole(cluster.detect(client, tmp_path, count=COUNT, read=frame, part=PART))


def test_a_folder_is_for_one_recording_and_configuration(client, tmp_path):
    cluster.detect(client, tmp_path, count=3, read=frame, part=2)
    for changes in (
        {"count": 4},
        {"part": 3},
        {"config": DetectorConfig(refinement=None)},
    ):
        with pytest.raises(ConfigError, match="another recording or configuration"):
            cluster.detect(client, tmp_path, **{"count": 3, "part": 2, "read": frame} | changes)
    (tmp_path / "about.json").write_text("{")
    with pytest.raises(ConfigError, match="damaged"):
        cluster.detect(client, tmp_path, count=3, read=frame, part=2)
    with pytest.raises(ConfigError, match="no store of corners"):
        cluster.open_store(tmp_path)
    with pytest.raises(ConfigError, match="no store of corners"):
        cluster.open_store(tmp_path / "elsewhere")


def test_wrong_arguments_and_frames_raise_errors_in_the_client(client, tmp_path):
    with pytest.raises(ConfigError, match="count must be"):
        cluster.detect(client, tmp_path, count=-1, read=frame)
    with pytest.raises(ImageError, match="cvtColor"):
        cluster.detect(client, tmp_path, count=2, read=colour_frame)


def test_an_empty_recording_is_a_store_without_parts(client, tmp_path):
    store = cluster.detect(client, tmp_path, count=0, read=frame)
    assert list(store) == []
