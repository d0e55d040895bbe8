"""Series in every format, read by the programs that they are for, also after kills and full
disks."""

import csv
import importlib
import json
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import time
import tracemalloc
import warnings
import xml.etree.ElementTree
from pathlib import Path

import h5py
import numpy as np
import pytest
from cases import some
from children import ENVIRONMENT, python
from stereo_data import grid_of

from cmp_cl import Grid, SeriesWriter
from cmp_cl.errors import ConfigError, FieldError, GridError
from cmp_cl.series import SERIES_SUFFIXES, complete, read_series

FORMATS = SERIES_SUFFIXES
READABLE = [".npz", ".h5"]
ABOUT = {"settings": {"configuration": "nms = 3"}}
SHAPE = (12, 15)


@pytest.fixture(autouse=True)
def package(request):
    """Skip a test of MCAP if its package, which the tests' extra lacks, is not installed."""
    case = getattr(request.node, "callspec", None)
    if case and case.params.get("suffix") == ".mcap":
        pytest.importorskip("mcap_ros2", reason="mcap is not installed")


def rest():
    row, column = np.indices(SHAPE)
    return np.stack([2.0 * column, 2.0 * row, 40.0 + 0 * row], axis=-1)


def frame(number):
    """Return the arrays of a frame; node (0, 0) is missing, (1, 1) shows the number along x."""
    shift = np.full((*SHAPE, 3), 0.25 * number) + rest() / 100
    shift[0, 0] = np.nan
    shift[1, 1, 0] = number
    return {
        "displacement": shift,
        "sigma": np.full(SHAPE, 0.01 * (number + 1), np.float32),
        "status": np.ones(SHAPE, np.uint8),
        "ambiguous": np.bool_(number % 2),
    }


def write(path, frames=3):
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        for number in range(frames):
            series.append(index=10 + number, time_ms=20.0 * number, **frame(number))
    return path


def clouds(path):
    """Return the points of each message of an MCAP."""
    reading, decoding = (importlib.import_module(n) for n in ("mcap.reader", "mcap_ros2.decoder"))
    with open(path, "rb") as file:
        reader = reading.make_reader(file, decoder_factories=[decoding.DecoderFactory()])
        assert next(reader.iter_metadata()).metadata["unit of rest"] == "mm"
        messages = [cloud for _, _, _, cloud in reader.iter_decoded_messages(["/cmp_cl/nodes"])]
    for cloud in messages:
        assert cloud.header.frame_id == "camera"
        assert (cloud.height, cloud.width, cloud.point_step) == (*SHAPE, 36)
        assert [each.offset for each in cloud.fields] == list(range(0, 36, 4))
    return [np.frombuffer(cloud.data, "<f4").reshape(*SHAPE, 9) for cloud in messages]


def shown_in(path):
    """Return the x-displacement of node (1, 1) in each frame of a series in any format."""
    if path.suffix in (".npz", ".h5") or ".part" in path.suffix:
        found = read_series(path)
        np.testing.assert_array_equal(found["rest"], rest())
        assert len(found["displacement"]) == len(found["sigma"]) == len(found["index"])
        return found["displacement"][:, 1, 1, 0].tolist()
    if path.suffix == ".csv":
        about = json.loads(path.with_name(f"{path.name}-metadata.json").read_text())
        assert about["constants"]["rest"] == rest().tolist()
        rows = list(csv.DictReader(path.read_text().splitlines()))
        assert len(rows) % (SHAPE[0] * SHAPE[1]) == 0
        node = [row for row in rows if (row["row"], row["column"]) == ("1", "1")]
        return [float(row["displacement_x_mm"]) for row in node]
    if path.suffix == ".mcap":
        return [float(points[1, 1, 3]) for points in clouds(path)]
    sets = xml.etree.ElementTree.parse(path).getroot().findall("Collection/DataSet")
    for entry in sets:
        xml.etree.ElementTree.parse(path.parent / entry.get("file"))
    return [float(int(Path(entry.get("file")).stem)) for entry in sets]


def test_rosbags_reads_an_mcap(tmp_path):
    pytest.importorskip("mcap_ros2", reason="mcap is not installed")
    bags = pytest.importorskip("rosbags.highlevel", reason="rosbags is not installed")
    path = write(tmp_path / "press.mcap")
    found = {}
    with bags.AnyReader([path]) as bag:
        for connection, stamp, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message.data))
    stamps = 0, 20_000_000, 40_000_000  # ns
    assert found.pop("/cmp_cl/ambiguous") == [*zip(stamps, (False, True, False), strict=True)]
    read = [(stamp, data.tobytes()) for stamp, data in found.pop("/cmp_cl/nodes")]
    points = [each.tobytes() for each in clouds(path)]
    assert read == [*zip(stamps, points, strict=True)]
    assert not found


def test_the_points_of_an_mcap_are_positions_displacements_sigma_and_numbers(tmp_path):
    pytest.importorskip("mcap_ros2", reason="mcap is not installed")
    *_, points = clouds(write(tmp_path / "press.mcap"))
    shift = frame(2)["displacement"]
    np.testing.assert_allclose(points[..., :3], rest() + shift, rtol=1e-6)
    np.testing.assert_allclose(points[..., 3:6], shift, rtol=1e-6)
    np.testing.assert_array_equal(points[..., 6], frame(2)["sigma"])
    np.testing.assert_array_equal(np.moveaxis(points[..., 7:], 2, 0), np.indices(SHAPE))


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_series_can_be_read_while_it_is_written_and_has_its_name_at_the_end(tmp_path, suffix):
    path, part = tmp_path / f"a press{suffix}", tmp_path / f"a press{suffix}.part"
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        for number in range(4):
            series.append(index=number, time_ms=np.nan, **frame(number))
            assert shown_in(part) == list(range(number + 1))
            shutil.copy(part / "index.npy", tmp_path / f"index {number}")
        shutil.copy(tmp_path / "index 1", part / "index.npy")  # as if the third were half written
        assert shown_in(part) == [0, 1]
        shutil.copy(tmp_path / "index 3", part / "index.npy")
        assert not path.exists()
        assert len(series) == 4
    assert shown_in(path) == [0, 1, 2, 3]
    assert not [name for name in os.listdir(tmp_path) if ".part" in name]


@pytest.mark.parametrize("suffix", READABLE)
def test_what_is_written_is_read_again(tmp_path, suffix):
    found = read_series(write(tmp_path / f"press{suffix}"))
    assert found["index"].tolist() == [10, 11, 12]
    assert found["time_ms"].tolist() == [0, 20, 40]
    for name, value in frame(2).items():
        np.testing.assert_array_equal(found[name][2], value)
        assert found[name].dtype == value.dtype
    np.testing.assert_array_equal(found["rest"], rest())
    assert str(found["unit"]) == "mm"
    assert json.loads(str(found["about"]))["units"]["sigma"] == "mm"
    assert sorted(read_series(tmp_path / f"press{suffix}", ["rest", "none"])) == ["index", "rest"]


def test_hdf5_holds_units_version_time_and_configuration(tmp_path):
    with h5py.File(write(tmp_path / "press.h5"), "r") as file:
        assert file["displacement"].attrs["unit"] == "mm"
        assert file["time_ms"].attrs["unit"] == "ms"
        assert file.attrs["configuration"] == "nms = 3"
        assert file.attrs["cmp_cl"]
        assert file.attrs["written"].startswith("20")


def test_a_csv_has_a_row_for_each_node_and_metadata_beside_it(tmp_path):
    arrays = frame(2) | {"strain": np.full((*SHAPE, 3), 0.5), "direction": np.full(SHAPE, 0.25)}
    arrays |= {"area": 7.5, "zoom": np.ones(2), "covariance": np.ones((*SHAPE, 3, 3))}
    with SeriesWriter(tmp_path / "press.csv", **ABOUT, rest=rest(), unit="mm") as series:
        series.append(index=12, time_ms=40.0, **arrays)
    rows = list(csv.DictReader((tmp_path / "press.csv").read_text().splitlines()))
    assert len(rows) == SHAPE[0] * SHAPE[1]
    names = "frame time_ms row column direction_rad displacement_x_mm displacement_y_mm"
    names += " displacement_z_mm sigma_mm status strain_11 strain_22 strain_12 ambiguous area"
    assert list(rows[0]) == [*names.split(), "zoom_x", "zoom_y"]
    assert rows[0]["displacement_x_mm"] == "nan"
    last = list(rows[-1].values())
    assert last[:4] == ["12", "40", str(SHAPE[0] - 1), str(SHAPE[1] - 1)]
    np.testing.assert_allclose([float(cell) for cell in last[4:9]], [0.25, 0.78, 0.72, 0.9, 0.03])
    assert last[9:] == ["1", "0.5", "0.5", "0.5", "0", "7.5", "1", "1"]
    about = json.loads((tmp_path / "press.csv-metadata.json").read_text())
    assert (about["units"]["displacement"], about["configuration"]) == ("mm", "nms = 3")


@pytest.mark.parametrize("suffix", [".csv", ".pvd"])
def test_times_since_1970_stay_apart(tmp_path, suffix):
    path = tmp_path / f"press{suffix}"
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        for number in range(2):
            series.append(index=number, time_ms=1.7e12 + 33.25 * number, **frame(number))
    text = path.read_text()
    assert ("1700000000033.25" in text) or ("1700000000.03325" in text)


def test_json_lines_go_through_a_pipe():
    done = python("-c", "from test_series import write; write('-')", check=True)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) == 4
    assert lines[0]["units"]["displacement"] == "mm"
    assert lines[0]["constants"]["rest"] == rest().tolist()
    assert lines[1]["displacement"][0][0] == [None, None, None]
    assert lines[3]["frame"] == 12
    assert lines[3]["displacement"][3][4] == frame(2)["displacement"][3, 4].tolist()


def test_vtk_reads_what_the_pvd_lists(tmp_path):
    path = write(tmp_path / "press.pvd")
    sets = xml.etree.ElementTree.parse(path).getroot().findall("Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in sets] == [0, 0.02, 0.04]
    assert sets[2].get("file") == "press_frames/000012.vtp"
    write(path)  # the frames that an older .pvd names are not touched
    assert len(list(tmp_path.glob("press_frames*/*.vtp"))) == 6
    pytest.importorskip("vtkmodules", reason="vtk is not installed")
    io = importlib.import_module("vtkmodules.vtkIOXML")
    numbers = importlib.import_module("vtkmodules.util.numpy_support")
    reader = io.vtkXMLPolyDataReader()
    for entry, ambiguous in zip(sets, (0, 1, 0), strict=True):
        reader.SetFileName(str(tmp_path / entry.get("file")))
        reader.Update()
        surface = reader.GetOutput()
        whole = surface.GetFieldData().GetArray("ambiguous")
        assert numbers.vtk_to_numpy(whole).tolist() == [ambiguous]
    shift = numbers.vtk_to_numpy(surface.GetPointData().GetArray("displacement"))
    np.testing.assert_array_equal(shift, frame(2)["displacement"].reshape(-1, 3)[1:])
    place = numbers.vtk_to_numpy(surface.GetPoints().GetData())
    np.testing.assert_array_equal(place, rest().reshape(-1, 3)[1:])


# what is refused


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_a_series_cannot_hold_is_named_and_nothing_is_added(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    for wrong in ({"a": object()}, {"a": [[1], [2, 3]]}, {"a/b": 1}):
        with pytest.raises(FieldError, match=r"^(a must be an array|the name of an array must be)"):
            SeriesWriter(path, **wrong)
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        if suffix in (".csv", ".pvd", ".mcap"):
            with pytest.raises(FieldError, match="needs"):
                series.append(index=0, time_ms=0, area=2.5)
        wrong_ones = [("index", 0.5), ("index", 2**63), ("time_ms", "b"), ("time_ms", np.inf)]
        for name, wrong in [*wrong_ones, ("sigma", [[1], [2, 3]])]:
            with pytest.raises(FieldError, match=f"^{name} must be"):
                series.append(**{"index": 0, "time_ms": 0.0, **frame(0), name: wrong})
        with pytest.raises(FieldError, match="constants"):
            series.append(index=0, time_ms=0, **frame(0), unit=np.ones(3))
        series.append(index=0, time_ms=0, **frame(0))
        for other in ({"sigma": np.ones(4)}, {"more": 1}, {"sigma": np.ones(SHAPE)}):
            with pytest.raises(FieldError, match="the first frame had"):
                series.append(index=1, time_ms=1, **(frame(0) | other))
        series.append(index=1, time_ms=1, **frame(1))
    assert shown_in(path) == [0, 1]
    series.close()
    with pytest.raises(FieldError, match="closed"):
        series.append(index=2, time_ms=2, **frame(2))


def test_times_that_mcap_has_no_stamp_for_are_refused_at_once(tmp_path):
    pytest.importorskip("mcap_ros2", reason="mcap is not installed")
    path = tmp_path / "press.mcap"
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        for time_ms in (-40, 2.2e12, 1e300):
            with pytest.raises(FieldError, match=r"^time_ms must be from 0 to .* in \.mcap"):
                series.append(index=0, time_ms=time_ms, **frame(0))
        series.append(index=0, time_ms=np.nan, **frame(0))
        series.append(index=1, time_ms=1.7e12, **frame(1))
    assert shown_in(path) == [0, 1]
    with SeriesWriter(tmp_path / "press.npz", **ABOUT, rest=rest(), unit="mm") as series:
        series.append(index=0, time_ms=-40, **frame(0))
        with pytest.raises(FieldError, match=r"in \.mcap, not -40"):
            complete(tmp_path / "press.npz.part", path)


def test_names_and_packages_that_no_format_has_are_refused(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match=", ".join(map(re.escape, SERIES_SUFFIXES))):
        SeriesWriter("press.mat")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigError, match=r"cmp-cl\[hdf5\]"):
        SeriesWriter(tmp_path / "press.h5")
    with pytest.raises(OSError, match="none"):
        SeriesWriter(tmp_path / "none" / "a.npz")
    assert list(tmp_path.iterdir()) == []
    for name in ("about", "index", "file", "allow_pickle", "a/b"):
        with pytest.raises(FieldError, match=f"none of about.*: '{name}'$"):
            SeriesWriter(tmp_path / "press.npz", **{name: 1})
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "link.npz").symlink_to(tmp_path / "press.bin")
    with pytest.raises(ConfigError, match=r"press\.bin"):  # now, and not when it is complete
        SeriesWriter(tmp_path / "link.npz")


def test_a_part_that_is_still_written_stays(tmp_path):
    with SeriesWriter(tmp_path / "press.npz", **ABOUT, rest=rest(), unit="mm") as series:
        series.append(index=0, time_ms=0, **frame(0))
        complete(tmp_path / "press.npz.part", tmp_path / "early.npz")
        series.append(index=1, time_ms=1, **frame(1))
    assert shown_in(tmp_path / "early.npz") == [0]
    assert shown_in(tmp_path / "press.npz") == [0, 1]
    assert not (tmp_path / "press.npz.part").exists()


def test_a_part_without_nodes_is_no_table(tmp_path):
    series = SeriesWriter(tmp_path / "press.npz")
    series.append(index=0, time_ms=0, forces=np.zeros(3))
    with pytest.raises(FieldError, match="needs the positions at rest"):
        complete(tmp_path / "press.npz.part", tmp_path / "press.csv")
    series.close()


# what was there before


@pytest.mark.parametrize("suffix", FORMATS)
def test_an_older_file_is_replaced_at_the_end_and_gives_its_mode(tmp_path, suffix):
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    path.chmod(0o600)
    new = {**ABOUT, "rest": rest(), "unit": "mm"}
    with pytest.raises(KeyboardInterrupt), SeriesWriter(path, **new):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ZeroDivisionError), SeriesWriter(path, **new) as series:  # noqa: PT012
        series.append(index=0, time_ms=0.0, **frame(0))
        assert path.read_bytes() == b"old"
        series.append(index=1, time_ms=1 / 0, **frame(1))
    assert shown_in(path) == [0]
    assert os.name == "nt" or path.stat().st_mode & 0o777 == 0o600


def test_a_file_is_on_the_disk_before_its_part_goes(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", lambda number: synced.append(os.fstat(number).st_size))
    write(tmp_path / "press.npz")
    assert synced == [(tmp_path / "press.npz").stat().st_size]


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="only Linux says what is mapped")
@pytest.mark.parametrize("suffix", FORMATS)
def test_a_part_is_closed_before_it_is_removed(tmp_path, monkeypatch, suffix):
    """Windows removes no file that is open or mapped."""
    mapped, remove = [], shutil.rmtree

    def removed(folder, **how):
        open_files = [os.path.realpath(each) for each in Path("/proc/self/fd").iterdir()]
        held = [*Path("/proc/self/maps").read_text().split(), *open_files]
        mapped.extend(name for name in held if name.startswith(str(folder)))
        remove(folder, **how)

    monkeypatch.setattr(shutil, "rmtree", removed)
    with SeriesWriter(tmp_path / f"press{suffix}", **ABOUT, rest=rest(), unit="mm") as series:
        series.append(index=0, time_ms=0, **frame(0))
    assert mapped == []


def test_memory_does_not_grow_with_the_recording(tmp_path):
    values = np.zeros((300, 300, 3))
    tracemalloc.start()
    try:
        with SeriesWriter(tmp_path / "long.npz") as series:
            for index in range(60):
                series.append(index=index, time_ms=index, value=values)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (tmp_path / "long.npz").stat().st_size > 60 * values.nbytes
    assert peak < 20 * values.nbytes


# kills and full disks

WRITING = """
import sys
from test_series import ABOUT, SeriesWriter, frame, rest
try:
    with SeriesWriter(sys.argv[1], **ABOUT, rest=rest(), unit="mm") as series:
        for number in range(int(sys.argv[2])):
            series.append(index=number, time_ms=number, **frame(number))
            print(number + 1, flush=True)
except OSError as error:
    print(error)
"""
FRAMES = 60  # of the series whose writer is killed
KILLS = [(suffix, draw) for suffix in FORMATS for draw in range(50)]


def killed(path, seconds):
    """Kill a process that writes frames; return how many it told as written."""
    command = [sys.executable, "-c", WRITING, str(path), str(FRAMES)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as writer:
        assert writer.stdout.readline() == "1\n"
        time.sleep(seconds)
        writer.kill()
        told = writer.stdout.read().splitlines()
    return int((told or ["1"])[-1])


@pytest.mark.skipif(os.name == "nt", reason="there is no kill -9 on Windows")
@pytest.mark.parametrize(("suffix", "draw"), some(KILLS, [(".npz", 0)], several=True))
def test_a_kill_at_any_moment_loses_no_frame_that_was_told_as_written(tmp_path, suffix, draw):
    path, part = tmp_path / f"press{suffix}", tmp_path / f"press{suffix}.part"
    told = killed(path, random.Random(f"{suffix}{draw}").uniform(0, 0.15))
    if path.exists():  # it was killed at the very end
        assert shown_in(path) == list(range(FRAMES))
        return
    found = shown_in(part)
    assert found == list(range(len(found)))
    assert told <= len(found) <= told + 1
    with SeriesWriter(path, **ABOUT, rest=rest(), unit="mm") as series:
        assert series.earlier == [part]
        series.append(index=0, time_ms=0, **frame(0))
    assert shown_in(path) == [0]
    assert shown_in(part) == found
    complete(part, path)
    assert shown_in(path) == found
    assert not part.exists()


FULL = [(size, 10**5) for size in range(1000, 4600, 360)]  # kB, and the most frames
FULL += [(size, 120) for size in range(760, 1260, 70)]
FULL = [(suffix, *full) for suffix in FORMATS for full in FULL]
FEW = [(".npz", 1360, 10**5), *((suffix, 1250, 120) for suffix in FORMATS)]


@pytest.mark.parametrize(("suffix", "kilobytes", "frames"), some(FULL, FEW, several=True))
def test_a_full_disk_is_reported_and_keeps_all_frames_up_to_then(
    tmp_path, suffix, kilobytes, frames
):
    """Either a frame or, after 120 of them, the file finds no room."""
    disk = tmp_path / "disk"
    disk.mkdir()
    namespace = ["unshare", "-rm", "sh", "-c"]
    inside = f"mount -t tmpfs -o size={kilobytes}k tmpfs {disk} && "
    if not shutil.which("unshare") or subprocess.run([*namespace, f"{inside} true"]).returncode:
        pytest.skip("no file system of its own can be made here")
    words = [sys.executable, "-c", WRITING, str(disk / f"press{suffix}"), str(frames)]
    keep = f" || echo crashed; du -sk {disk}; cp -r {disk} {tmp_path / 'kept'}"
    done = subprocess.run(
        [*namespace, inside + shlex.join(words) + keep],
        capture_output=True,
        text=True,
        env=ENVIRONMENT,
    )
    assert done.returncode == 0, done.stderr
    *told, error, used = done.stdout.splitlines()
    if error == str(frames):  # an MCAP is compressed, and found room
        assert shown_in(tmp_path / "kept" / f"press{suffix}") == list(range(frames))
        return
    assert error.startswith("[Errno 28] No space left on device")
    part = f"press{suffix}.part"
    assert part in error
    assert os.listdir(tmp_path / "kept") == [part]
    found = shown_in(tmp_path / "kept" / part)
    assert found == list(range(int(told[-1])))
    assert frames == 120 or int(used.split()[0]) > kilobytes - 400
    complete(tmp_path / "kept" / part, tmp_path / f"press{suffix}")
    assert shown_in(tmp_path / f"press{suffix}") == found


# damage and lies


def test_a_file_that_is_no_series_is_refused(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    (tmp_path / "picture.npz").write_bytes(b"\x89PNG")
    with open(tmp_path / "array.npz", "wb") as file:
        np.save(file, np.zeros(3))
    np.savez(tmp_path / "other.npz", x=1)
    for name, error, why in (
        ("bad.npz", FieldError, "no series: it is cut off, or not what numpy.savez writes$"),
        ("picture.npz", FieldError, "no series: it is cut off, or not what numpy.savez writes$"),
        ("array.npz", FieldError, "no series: it is cut off, or not what numpy.savez writes$"),
        ("other.npz", FieldError, "index"),
        ("x.txt", ConfigError, "ends in"),
        ("gone.npz.part", FieldError, "no file"),
        ("gone.npz", FieldError, "no file"),
    ):
        with pytest.raises(error, match=why):
            read_series(tmp_path / name)


def test_what_exceeds_the_memory_is_not_read(tmp_path):
    path = tmp_path / "big.h5"
    with h5py.File(path, "w") as file:
        for name in ("index", "time_ms"):
            file.create_dataset(name, (10**13,), np.int64, chunks=(10**6,))  # not written
    with pytest.raises(FieldError, match="need 160000000000000 bytes"):
        read_series(path)
    part = tmp_path / "big.npz.part"
    (part / "constants").mkdir(parents=True)
    np.save(part / "constants" / "about.npy", np.array("{}"))
    for name, shape in (("index", (10**9,)), ("other", (10**9, 500))):  # not written
        np.lib.format.open_memmap(part / f"{name}.npy", "w+", np.int64, shape)
    with pytest.raises(FieldError, match=r"need \d{13} bytes"):
        read_series(part)


def test_arrays_that_do_not_fit_are_refused_before_they_are_read(tmp_path):
    many = np.zeros(1 << 23)
    series, grid = tmp_path / "press.npz", tmp_path / "rest.npz"
    np.savez_compressed(series, index=np.arange(3), time_ms=many)
    grid_of(rest()[..., :2]).save(grid)
    np.savez_compressed(grid, **{**np.load(grid), "xy": many})
    tracemalloc.start()
    with pytest.raises(FieldError, match=r"time_ms must be \(3\) of numbers, not \(8388608,\)"):
        read_series(series)
    with pytest.raises(GridError, match=r"xy must be .*, found \(8388608\)"):
        Grid.load(grid)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < many.nbytes / 10


@pytest.mark.parametrize("suffix", READABLE)
def test_a_flipped_byte_is_refused_or_changes_nothing(tmp_path, suffix):
    path = write(tmp_path / f"press{suffix}")
    whole, right = path.read_bytes(), read_series(path)
    rng, refused = np.random.default_rng(0), 0
    for place in rng.integers(0, len(whole), 100):
        data = bytearray(whole)
        data[place] ^= rng.integers(1, 256)
        path.write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = read_series(path)
        except FieldError:
            refused += 1
        else:
            for name in set(right) - {"about"}:
                np.testing.assert_array_equal(found[name], right[name])
    assert refused > 50
