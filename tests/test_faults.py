"""Faults around a detector: memory, caches, kills, threads, processes."""

import ctypes
import multiprocessing
import os
import platform
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import images
import numpy as np
import pyopencl as cl
import pytest
from cases import some
from children import ENVIRONMENT, python
from comparison import assert_same_bytes
from workers import corners_of_board

import cmp_cl
from cmp_cl import BinaryRings, Detector, DetectorConfig
from cmp_cl.cli.main import main
from cmp_cl.detector import kept_detector
from cmp_cl.errors import CapacityError
from cmp_cl.lattice import plan
from cmp_cl.measure import OneView
from cmp_cl.media import read_image
from cmp_cl.opencl import pocl

BOARD_FILE = Path(cmp_cl.__file__).parent / "data" / "board.png"
BOARD = images.eight_bits()["board"]

# --- memory --------------------------------------------------------------------------------


def refuse(*_, **__):
    raise cl.MemoryError("MEM_OBJECT_ALLOCATION_FAILURE")


@pytest.mark.parametrize("call", ["enqueue_nd_range_kernel", "enqueue_copy", "wait_for_events"])
def test_memory_that_runs_out_in_a_frame_is_a_capacity_error(device, monkeypatch, call):
    monkeypatch.setattr("cmp_cl.opencl.memory.shares_memory", lambda _: False)
    with Detector(shape=images.SHAPE, device=device) as detector:
        expected = detector(BOARD)
        with monkeypatch.context() as patch:
            patch.setattr(cl, call, refuse)
            uses = [lambda: list(detector.stream([BOARD]))]
            if call != "wait_for_events":  # of an upload during the frame before
                uses += [lambda: detector(BOARD), lambda: detector.batch([BOARD])]
            for use in uses:
                with pytest.raises(CapacityError, match="not enough memory for a plan"):
                    use()
        assert_same_bytes(detector(BOARD), expected)


def numbered(device):
    """Number the corners of a board by the command, which says an error."""
    main(["detect", str(BOARD_FILE), "--grid", "9x6", "--device", device.index])


def measured(device):
    """Make what a field needs, and say an error as a command does."""
    try:
        OneView(read_image(BOARD_FILE), device=device).close()
    except CapacityError as error:
        print(error, file=sys.stderr)


@pytest.mark.parametrize("call", ["Buffer", "enqueue_nd_range_kernel", "enqueue_copy"])
@pytest.mark.parametrize("use", [numbered, measured])
def test_memory_that_is_refused_at_any_time_is_one_line(device, monkeypatch, capsys, use, call):
    monkeypatch.setattr("cmp_cl.opencl.memory.shares_memory", lambda _: False)
    done, calls, refused = getattr(cl, call), 0, 0

    def count(*arguments, **how):
        nonlocal calls
        calls += 1
        return refuse() if calls == refused else done(*arguments, **how)

    def errors(at):
        """Return what is said if that call is refused."""
        nonlocal calls, refused
        calls, refused = 0, at
        kept_detector.cache_clear()
        plan._kept.cache_clear()
        use(device)
        return capsys.readouterr().err

    monkeypatch.setattr(cl, call, count)
    assert errors(0) == ""
    size = r" of \d+ bytes, though it has \d+" if call == "Buffer" else ""
    for at in range(1, calls + 1):
        said = errors(at)
        assert said.count("\n") == 1
        assert re.search(f"not enough memory for a plan{size}", said)


def test_a_capacity_that_cannot_grow_leaves_a_detector_that_works(device, monkeypatch):
    config = DetectorConfig(detection=BinaryRings(contrast=None), nms_radius=1, max_corners=1)
    dense = images.texture((300, 80))
    with Detector(shape=dense.shape, config=config, device=device) as detector:
        with monkeypatch.context() as patch:
            patch.setattr(cl, "Buffer", refuse)
            for use in (detector, detector.maps):
                with pytest.raises(CapacityError):
                    use(dense)
        assert len(detector(np.full_like(dense, 128))) == 0
        assert len(detector(dense)) > 64


# --- cached programs -----------------------------------------------------------------------


DETECT = """
import numpy as np
import pyopencl
import cmp_cl
with cmp_cl.Detector(shape=(64, 64)) as detector:
    assert not pyopencl._PYOPENCL_NO_CACHE
    print(len(detector(np.zeros((64, 64), np.uint8))))
"""


def test_functions_that_call_kernels_are_never_loaded_from_a_file(tmp_path):
    """pyopencl stores them as pickles; a damaged file led to an error of SQLite."""
    compiled = {"POCL_CACHE_DIR": str(pocl.cache_folder())}
    environment = {**ENVIRONMENT, **compiled, "XDG_CACHE_HOME": str(tmp_path)}
    folder = tmp_path / "pytools"
    folder.mkdir()
    python("-c", "import pyopencl.invoker", env=environment, check=True)
    (kept,) = folder.glob("*.sqlite")
    kept.write_bytes(b"damaged")
    done = python("-c", DETECT, env=environment)
    assert (done.stdout, done.returncode) == ("0\n", 0), done.stderr
    assert kept.read_bytes() == b"damaged"


def detected(device, **environment):
    """Detect in a process of its own; return its status and what it says."""
    arguments = f"cmp_cl.DetectorConfig(refinement=None), device={device.index!r}"
    image = "np.zeros((40, 40), np.uint8)"
    code = f"import cmp_cl, numpy as np; cmp_cl.detect({image}, {arguments})"
    done = python("-c", code, env=ENVIRONMENT | environment)
    return done.returncode, done.stderr


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has a folder for each user")
def test_pocl_runs_no_kernels_of_a_folder_that_everybody_may_write_to(device, tmp_path):
    if not pocl.is_pocl(device.handle):
        pytest.skip("only PoCL has a cache of its own")
    shared = tmp_path / "pocl"
    shared.mkdir()
    shared.chmod(0o777)
    status, said = detected(device, POCL_CACHE_DIR=str(shared))
    assert status == 1
    assert f"the compiled kernels in {str(shared)!r} may be someone else's" in said
    assert "name another one in POCL_CACHE_DIR" in said
    assert not list(shared.rglob("*.so"))


@pytest.mark.parametrize("left", some([0, 99, "half"], ["half"]))
def test_a_damaged_cache_of_pocl_is_told(device, tmp_path, left):
    if not pocl.is_pocl(device.handle):
        pytest.skip("only PoCL keeps programs so")
    assert detected(device, POCL_CACHE_DIR=str(tmp_path))[0] == 0
    kept = list(tmp_path.rglob("program.bc"))
    assert kept
    for each in kept:
        whole = each.read_bytes()
        each.write_bytes(whole[: len(whole) // 2 if left == "half" else left])
    status, said = detected(device, POCL_CACHE_DIR=str(tmp_path))
    assert status
    assert "DeviceError: a compiled program has no kernels" in said
    assert str(tmp_path) in said


def test_without_a_linker_pocl_does_not_end_the_process(device, tmp_path):
    if not pocl.is_pocl(device.handle):
        pytest.skip("only PoCL needs a linker")
    status, said = detected(device, POCL_CACHE_DIR=str(tmp_path / "cold"), PATH=str(tmp_path))
    assert status == 1, "the signal of PoCL"
    assert "DeviceError: PoCL cannot compile kernels" in said
    assert "apt install gcc libc6-dev" in said


@pytest.mark.skipif(
    (platform.system(), platform.machine()) != ("Linux", "x86_64"), reason="PoCL of pip is for this"
)
@pytest.mark.parametrize(
    ("names", "renamed"), [(["pthread", "generic", "generic"], [1]), (["pthread", "haswell"], [])]
)
def test_pocl_is_told_a_processor_where_it_knows_none(names, renamed):
    """Its record of a device points to the name that it asks the compiler for."""
    texts = [ctypes.create_string_buffer(name.encode()) for name in names]
    record = (ctypes.c_uint64 * 256)(1, 2**63, *map(ctypes.addressof, texts))
    device = SimpleNamespace(
        platform=SimpleNamespace(name="Portable Computing Language"),
        version="OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic",
        int_ptr=ctypes.addressof(record),
    )
    for _ in range(2):  # each list of the devices does it
        pocl.name_processor(device)
    at = [ctypes.string_at(address).decode() for address in record[2 : 2 + len(names)]]
    assert [k for k, name in enumerate(names) if at[k] != name] == renamed
    assert all(at[k] in ("haswell", "skylake-avx512") for k in renamed)


# --- threads and processes -----------------------------------------------------------------


ENDS = """
import numpy as np
import cmp_cl
from cmp_cl.media.ahead import Ahead

def endless():
    image = np.zeros((480, 640), np.uint8)
    with cmp_cl.Detector(shape=image.shape, device={device!r}) as detector:
        while True:
            yield detector(image)

ahead = Ahead(endless(), 1, lossy=True)
ahead.take()
"""


def test_a_process_may_end_while_a_thread_measures(device):
    """Without a call of close, as scripts for PyTac3D do. Python ends a daemon thread where it
    stands, which the C++ of a kernel's call does not take."""
    done = python("-c", ENDS.format(device=device.index))
    assert (done.returncode, done.stderr) == (0, "")


def test_a_spawned_process_finds_the_same_corners(device):
    here = corners_of_board(device.index)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(corners_of_board, [device.index]) == [here]


FORKED = """
import multiprocessing, threading
import numpy as np
import cmp_cl

image = np.zeros((40, 40), np.uint8)
detector = cmp_cl.Detector(shape=image.shape, device={device!r})
uses = [
    cmp_cl.list_devices,
    lambda: cmp_cl.detect(image),
    lambda: detector(image),
    lambda: list(detector.stream([image])),
    lambda: detector.batch([image]),
    lambda: detector.maps(image),
]


def work(lines):
    for use in uses:
        try:
            use()
        except cmp_cl.DeviceError as error:
            lines.send("spawn" in str(error) and "forkserver" in str(error))
    detector.close()
    lines.send("done")


def hold():
    with detector._lock:
        held.set()
        release.wait()


# another thread is in the middle of a frame while the process forks
held, release = threading.Event(), threading.Event()
threading.Thread(target=hold, daemon=True).start()
held.wait()
mine, other = multiprocessing.Pipe()
child = multiprocessing.get_context("fork").Process(target=work, args=(other,))
child.start()
said = []
while said[-1:] != ["done"] and mine.poll(20):
    said.append(mine.recv())
child.kill()
release.set()
assert len(detector(image)) == 0  # the parent goes on
print(said == [True] * len(uses) + ["done"], said)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_a_forked_child_of_a_process_that_used_opencl_gets_an_error_and_does_not_hang(device):
    done = python("-c", FORKED.format(device=device.index), check=True)
    assert done.stdout.startswith("True"), done.stdout + done.stderr
