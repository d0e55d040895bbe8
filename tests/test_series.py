"""Series in every format, read by the programs that they are for."""

import csv
import importlib
import json
import os
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import time
import xml.etree.ElementTree
from pathlib import Path

import numpy as np
import pytest
from cases import some
from children import ENVIRONMENT, python

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.series import SERIES_SUFFIXES, Description, open_series, read_series, reading
from cmp_cl.series.tables import CsvSeries

ABOUT = Description(
    units={"displacement": "mm", "sigma": "mm", "rest": "mm"}, settings={"configuration": "nms = 3"}
)


def needs(module):
    """Return the module, or skip the test."""
    pytest.importorskip(module, reason=f"{module} is not installed")
    return importlib.import_module(module)


PACKAGES = {
    "h5": ["h5py"],
    "hdf5": ["h5py"],
    "parquet": ["pyarrow", "pandas"],
    "mcap": ["mcap_ros2"],
}


def rest():
    row, column = np.mgrid[:4, :5]
    return np.stack([2.0 * column, 2.0 * row, 40.0 + 0 * row], axis=-1)


def frame(number):
    """Return the arrays of a frame; node (0, 0) is missing."""
    shift = np.full((4, 5, 3), 0.25 * number) + rest() / 100
    shift[0, 0] = np.nan
    return {
        "displacement": shift,
        "sigma": np.full((4, 5), 0.01 * (number + 1), np.float32),
        "status": np.ones((4, 5), np.uint8),
    }


def write(path, frames=3):
    with open_series(path, ABOUT, {"rest": rest(), "unit": "mm"}) as series:
        for number in range(frames):
            series.append(index=10 + number, time_ms=20.0 * number, **frame(number))
    return path


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_what_is_written_is_read_again(tmp_path, suffix):
    if suffix == ".h5":
        needs("h5py")
    found = read_series(write(tmp_path / f"press{suffix}"))
    assert found["index"].tolist() == [10, 11, 12]
    assert found["time_ms"].tolist() == [0, 20, 40]
    np.testing.assert_array_equal(found["displacement"][2], frame(2)["displacement"])
    np.testing.assert_array_equal(found["rest"], rest())
    assert str(found["unit"]) == "mm"
    assert found["status"].dtype == np.uint8


def test_hdf5_holds_units_version_time_and_configuration(tmp_path):
    h5py = needs("h5py")
    with h5py.File(write(tmp_path / "press.h5"), "r") as file:
        assert file["displacement"].attrs["unit"] == "mm"
        assert file["time_ms"].attrs["unit"] == "ms"
        assert file.attrs["configuration"] == "nms = 3"
        assert file.attrs["cmp_cl"]
        assert file.attrs["written"].startswith("20")


WRITER = """
import sys, time
sys.path.insert(0, {tests!r})
from test_series import ABOUT, frame, rest
from cmp_cl.series import open_series
with open_series({path!r}, ABOUT, {{"rest": rest()}}) as series:
    for number in range(1000):
        series.append(index=number, time_ms=number, **frame(number))
        print(number, flush=True)
        sys.stdin.readline()
"""


def test_a_second_process_reads_hdf5_while_it_grows_and_a_kill_loses_nothing(tmp_path):
    h5py = needs("h5py")
    path = tmp_path / "live.h5"
    code = WRITER.format(tests=str(Path(__file__).parent), path=str(path))
    writer = subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    try:
        assert writer.stdout.readline() == "0\n"
        with h5py.File(path, "r", libver="latest", swmr=True) as file:
            index = file["index"]
            assert index[:].tolist() == [0]
            for number in (1, 2):
                writer.stdin.write("\n")
                writer.stdin.flush()
                assert writer.stdout.readline() == f"{number}\n"
            index.refresh()
            file["displacement"].refresh()
            assert index[:].tolist() == [0, 1, 2]
            np.testing.assert_array_equal(file["displacement"][2], frame(2)["displacement"])
        writer.send_signal(signal.SIGKILL)
        writer.wait(10)
    finally:
        writer.kill()
        writer.communicate()
    found = read_series(path)
    assert found["index"].tolist() == [0, 1, 2]
    np.testing.assert_array_equal(found["displacement"][2], frame(2)["displacement"])


def test_pandas_reads_parquet_with_units(tmp_path):
    needs("pyarrow")
    pandas = needs("pandas")
    table = pandas.read_parquet(write(tmp_path / "press.parquet"))
    assert len(table) == 3 * 20
    last = table[(table.frame == 12) & (table.row == 3) & (table.column == 4)].iloc[0]
    assert last.displacement_z == frame(2)["displacement"][3, 4, 2]
    assert table.sigma.dtype == np.float32
    schema = importlib.import_module("pyarrow.parquet").read_schema(tmp_path / "press.parquet")
    assert schema.field("displacement_x").metadata == {b"unit": b"mm"}
    assert schema.metadata[b"configuration"] == b"nms = 3"
    assert json.loads(schema.metadata[b"constants"])["rest"] == rest().tolist()


def test_a_csv_has_a_row_for_each_node_and_metadata_beside_it(tmp_path):
    with open(write(tmp_path / "press.csv"), newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 20
    assert list(rows[0])[:5] == ["frame", "time_ms", "row", "column", "displacement_x_mm"]
    assert rows[0]["displacement_x_mm"] == "nan"
    last = rows[-1]
    assert (last["frame"], last["time_ms"], last["row"], last["column"]) == ("12", "40", "3", "4")
    assert float(last["displacement_x_mm"]) == pytest.approx(0.58, rel=1e-9)
    assert last["status"] == "1"
    about = json.loads((tmp_path / "press.csv-metadata.json").read_text())
    assert about["units"]["sigma"] == "mm"
    assert about["configuration"] == "nms = 3"
    assert about["constants"]["rest"] == rest().tolist()


def test_a_csv_takes_under_3_ms_for_a_frame_of_1600_nodes(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "xy": rng.random((40, 40, 2), np.float32),
        "sigma": rng.random((40, 40), np.float32),
        "status": np.ones((40, 40), np.uint8),
    }
    spent = []
    with CsvSeries(tmp_path / "many.csv", Description(), {}) as series:
        for number in range(20):
            start = time.process_time()
            series.append(index=number, time_ms=number, **arrays)
            spent.append(time.process_time() - start)
    assert min(spent) < 2e-3 * 1.5, f"{min(spent) * 1e3:.1f} ms"  # 2 ms, and half more


def test_json_lines_go_through_a_pipe(tmp_path):
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_series import write; write('-')"
    )
    done = python("-c", code, check=True)
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
    assert [(tmp_path / entry.get("file")).is_file() for entry in sets] == [True] * 3
    needs("vtk")
    io = importlib.import_module("vtkmodules.vtkIOXML")
    numbers = importlib.import_module("vtkmodules.util.numpy_support")
    reader = io.vtkXMLPolyDataReader()
    reader.SetFileName(str(tmp_path / sets[2].get("file")))
    reader.Update()
    surface = reader.GetOutput()
    assert surface.GetNumberOfPoints() == 19
    assert surface.GetNumberOfPolys() == 11
    shift = numbers.vtk_to_numpy(surface.GetPointData().GetArray("displacement"))
    np.testing.assert_array_equal(shift, frame(2)["displacement"].reshape(-1, 3)[1:])
    place = numbers.vtk_to_numpy(surface.GetPoints().GetData())
    np.testing.assert_array_equal(place, rest().reshape(-1, 3)[1:])


def test_a_pvd_is_whole_after_every_frame(tmp_path):
    with open_series(tmp_path / "live.pvd", None, {"rest": rest()}) as series:
        for number in range(2):
            series.append(index=number, time_ms=np.nan, **frame(number))
            root = xml.etree.ElementTree.parse(tmp_path / "live.pvd").getroot()
            assert len(root.findall("Collection/DataSet")) == number + 1


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".csv", ".jsonl", ".parquet"])
def test_an_older_file_stays_until_the_first_frame_is_written(tmp_path, suffix):
    needs({".h5": "h5py", ".parquet": "pyarrow"}.get(suffix, "json"))
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="nothere"):
        open_series(tmp_path / "nothere" / path.name)
    series = open_series(path, ABOUT, {"rest": rest()})
    assert path.read_bytes() == b"old"
    with pytest.raises(FieldError, match="numbers"):
        series.append(index=0, time_ms=0, what=np.array([["text"]]))
    assert path.read_bytes() == b"old"
    series.append(index=0, time_ms=0, **frame(0))
    with pytest.raises(FieldError, match="first frame"):
        series.append(index=1, time_ms=0, sigma=np.zeros((2, 2)))
    series.close()
    series.close()
    assert path.read_bytes() != b"old"
    leftovers = [entry.name for entry in tmp_path.iterdir() if entry.name.startswith(".")]
    assert leftovers == []
    with pytest.raises(FieldError, match="closed"):
        series.append(index=1, time_ms=0, **frame(0))


@pytest.mark.parametrize("suffix", SERIES_SUFFIXES)
def test_an_older_file_stays_if_an_error_comes_before_the_first_frame(tmp_path, suffix):
    for name in PACKAGES.get(suffix[1:], []):
        needs(name)
    path = tmp_path / f"old{suffix}"
    path.write_bytes(b"old")
    with (
        pytest.raises(KeyboardInterrupt),
        open_series(path, ABOUT, {"rest": rest()}) as series,
    ):
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(FieldError, match="closed"):
        series.append(index=0, time_ms=0.0, **frame(0))


@pytest.mark.skipif(os.name == "nt", reason="modes are others on Windows")
@pytest.mark.parametrize("suffix", SERIES_SUFFIXES)
def test_an_older_file_gives_a_series_its_mode(tmp_path, suffix):
    for name in PACKAGES.get(suffix[1:], []):
        needs(name)
    path = tmp_path / f"private{suffix}"
    path.touch(mode=0o600)
    with open_series(path, None, {"rest": rest()}) as series:
        series.append(index=0, time_ms=0.0, **frame(0))
    assert path.stat().st_size
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".jsonl"])
def test_what_a_series_cannot_hold_is_named_and_nothing_is_added(tmp_path, suffix):
    for wrong in ({"a": object()}, {"a": [[1], [2, 3]]}, {"a/b": 1}, {3: 1}):
        with pytest.raises(FieldError, match=r"^(a must be an array|the name of an array must be)"):
            open_series(tmp_path / f"a{suffix}", None, wrong)
    with open_series(tmp_path / f"a{suffix}", None, {"rest": rest()}) as series:
        for name, wrong in {"index": 0.5, "time_ms": "b", "sigma": [[1], [2, 3]]}.items():
            with pytest.raises(FieldError, match=f"^{name} must be"):
                series.append(**{"index": 0, "time_ms": 0.0, **frame(0), name: wrong})
        assert len(series) == 0


@pytest.mark.skipif(os.name == "nt", reason="there are no named pipes on Windows")
def test_hdf5_replaces_no_pipe(tmp_path):
    needs("h5py")
    os.mkfifo(tmp_path / "pipe.h5")
    with pytest.raises(OSError, match=r"regular.*pipe\.h5"):
        open_series(tmp_path / "pipe.h5")
    assert stat.S_ISFIFO(os.stat(tmp_path / "pipe.h5").st_mode)


def test_an_unknown_suffix_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"\.npz, \.h5") as refusal:
        open_series("press.mat")
    assert all(suffix in str(refusal.value) for suffix in SERIES_SUFFIXES)


def test_a_missing_package_is_named_by_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigError, match=r"cmp-cl\[hdf5\]"):
        open_series(tmp_path / "press.h5")


def test_a_file_that_is_no_series_is_refused(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"nothing")
    np.savez(tmp_path / "other.npz", x=1)
    with pytest.raises(FieldError, match="not a series"):
        read_series(tmp_path / "bad.npz")
    with pytest.raises(FieldError, match="index"):
        read_series(tmp_path / "other.npz")
    with pytest.raises(ConfigError, match="must end"):
        read_series(tmp_path / "x.txt")
    with pytest.raises(FieldError, match="no file"):
        read_series(tmp_path / "gone.npz")


def test_tables_hold_the_numbers_of_a_frame_and_name_the_parts_of_a_strain(tmp_path):
    about = Description(units={"contact_area": "mm2", "translation": "mm"})
    with open_series(tmp_path / "press.csv", about) as series:
        for number in range(2):
            series.append(
                index=number,
                time_ms=np.nan,
                ambiguous=np.bool_(number),
                strain=np.full((1, 2, 3), 0.5),
                principal=np.full((1, 2, 2), 0.25),
                contact_area=7.5 + number,
                translation=np.array([1.0, 2.0]),
            )
    rows = list(csv.reader((tmp_path / "press.csv").read_text().splitlines()))
    names = "strain_xx,strain_yy,strain_xy,principal_1,principal_2,ambiguous,contact_area_mm2"
    assert rows[0][4:] == [*names.split(","), "translation_x_mm", "translation_y_mm"]
    assert rows[4][:4] == ["1", "nan", "0", "1"]
    assert rows[4][4:] == [*["0.5"] * 3, *["0.25"] * 2, "1", "8.5", "1", "2"]


def test_a_series_that_was_cut_off_is_refused_and_not_waited_for(tmp_path):
    needs("h5py")
    path = write(tmp_path / "press.h5", frames=40)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    code = "import sys; from cmp_cl.series import read_series; read_series(sys.argv[1])"
    found = python("-c", code, path, timeout=60)
    assert "FieldError" in found.stderr.splitlines()[-1]


def test_a_growing_series_that_is_damaged_is_refused_in_bounded_time(tmp_path, monkeypatch):
    needs("h5py")
    path = tmp_path / "press.h5"
    code = f"""import os
from cmp_cl.series import open_series
series = open_series({str(path)!r})
for number in range(5):
    series.append(index=number, time_ms=number, xy=[[[1.0, 2.0]]])
os._exit(0)"""
    python("-c", code, check=True)
    assert read_series(path)["xy"].shape == (5, 1, 1, 2)
    data = bytearray(path.read_bytes())
    data[data.index(b"OHDR") + 6] ^= 0x5A
    path.write_bytes(data)
    monkeypatch.setattr(reading, "_LONGEST_READ", 1.0)
    begin = time.monotonic()
    with pytest.raises(FieldError, match="damaged"):
        read_series(path)
    assert time.monotonic() - begin < 30


FULL = """
import sys
import numpy as np
from cmp_cl.series import open_series
from cmp_cl.viz.video import OverlayVideo
path = sys.argv[1]
with open(path, "w") as file:
    file.write("old")
try:
    if not path.endswith((".mp4", ".mkv", ".avi")):
        with open_series(path, None, {"rest": np.zeros((20, 20, 2))}) as series:
            for number in range(10_000):
                added = number
                series.append(index=number, time_ms=number, xy=np.random.rand(20, 20, 2))
    else:
        from stereo_data import grid_of
        rng = np.random.default_rng(0)
        grid = grid_of(np.full((2, 2, 2), 100.0))
        with OverlayVideo(path) as video:
            for number in range(60):
                image = rng.integers(0, 255, (480, 640)).astype(np.uint8)
                video.frame(image, grid, np.ones((2, 2)))
except OSError as error:
    print("OSError", error)
with open(path, "rb") as file:
    print(file.read(3) == b"old")
if path.endswith(".h5"):
    from cmp_cl.series import read_series
    found = read_series(path)
    print(len(found["index"]) > 100, bool(np.isfinite(found["xy"]).all()))
if path.endswith(".parquet"):
    import pandas
    frames = pandas.read_parquet(path)["frame"].value_counts()
    print(added > 100, len(frames) == added and set(frames) == {400})
if path.endswith(".mcap"):
    from mcap_ros2.reader import read_ros2_messages
    print(added > 100, sum(1 for _ in read_ros2_messages(path)) == added)
if path.endswith(("csv", "jsonl")):
    with open(path) as file:
        *lines, last = file.read().split("\\n")
    whole = len(lines) % 400 == 1 if path.endswith("csv") else lines[-1].endswith("}")
    print(len(lines) > 40, whole and not last)
"""


SUFFIXES = ["h5", "csv", "jsonl", "parquet", "mcap", "mp4", "mkv", "avi"]


@pytest.mark.parametrize("suffix", some(SUFFIXES, ("h5", "csv", "mp4")))
def test_a_full_disk_is_reported_and_whole_frames_are_kept(tmp_path, suffix):
    """HDF5 by itself crashes, and OpenCV does not report a video that is cut off."""
    for package in PACKAGES.get(suffix, []):
        needs(package)
    inside = f"mount -t tmpfs -o size=4m tmpfs {tmp_path} && exec"
    namespace = ["unshare", "-rm", "sh", "-c"]
    if not shutil.which("unshare") or subprocess.run([*namespace, f"{inside} true"]).returncode:
        pytest.skip("no file system of its own can be made here")
    code = f"import sys; sys.path[:] = {sys.path!r}{FULL}"
    words = [sys.executable, "-c", code, str(tmp_path / f"press.{suffix}")]
    command = f"{inside} {shlex.join(words)}"
    done = subprocess.run([*namespace, command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    error, *said = done.stdout.splitlines()
    assert error.startswith("OSError")
    assert "disk full" in error or "No space left" in error
    assert said == (["True"] if suffix in ("mp4", "mkv", "avi") else ["False", "True True"])
