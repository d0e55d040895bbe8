"""What PoCL, OpenCL on a CPU, needs: a linker, a folder, workers on their own cores, and a known
processor.
"""

import contextlib
import ctypes
import functools
import os
import re
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyopencl as cl

from cmp_cl.errors import DeviceError

_POCL_WORKERS = ("POCL_AFFINITY", "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")
_PROBE_S = 60.0
_UNKNOWN = b"generic"  # what LLVM calls a processor that it does not know
_LONGEST = 32  # bytes, more than a name of a processor has
_RECORD = 2048  # bytes, within which PoCL's record of a device has that name
_PROCESSORS = (  # names that LLVM knows, and the instructions that they stand for, the most first
    (b"skylake-avx512", {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}),
    (b"haswell", {"avx2", "bmi1", "bmi2", "fma", "f16c", "movbe"}),
)
_NAMES = {name: ctypes.create_string_buffer(name) for name, _ in _PROCESSORS}  # PoCL keeps them
_PROBE = """
import pyopencl as cl
from cmp_cl.opencl.device import list_devices
from cmp_cl.opencl.pocl import is_pocl
context = cl.Context([next(each.handle for each in list_devices() if is_pocl(each.handle))])
program = cl.Program(context, "__kernel void probe(__global int *a) { a[0] = 1; }")
memory = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4)
with cl.CommandQueue(context) as queue:
    program.build(cache_dir=False).probe(queue, (1,), None, memory).wait()
"""


def is_pocl(handle: cl.Device) -> bool:
    """Return whether a pyopencl device belongs to PoCL."""
    return handle.platform.name == "Portable Computing Language"


def name_processor(handle: cl.Device) -> None:
    """Let PoCL compile for a processor that its LLVM does not know, as that of pip for AMD's Zen 5.

    It asks Clang for the processor "generic", and Clang refuses
    (https://github.com/pocl/pocl/issues/1049). Its record of the device points to that name, and is
    made to point to one with the instructions of this processor. Nothing is done if the record
    cannot be read, or does not look like that.
    """
    if not (is_pocl(handle) and handle.version.endswith("-generic")):
        return
    with contextlib.suppress(OSError), open("/proc/self/mem", "rb", buffering=0) as memory:
        flags = set(re.findall(r"\w+", Path("/proc/cpuinfo").read_text()))
        named = [_NAMES[name] for name, needed in _PROCESSORS if needed <= flags]
        record = os.pread(memory.fileno(), _RECORD, handle.int_ptr)
        for k, word in enumerate(np.frombuffer(record[: len(record) // 8 * 8], np.uint64).tolist()):
            text = _text_at(memory.fileno(), word)
            if text == _UNKNOWN and named:
                place = ctypes.c_uint64.from_address(handle.int_ptr + 8 * k)
                place.value = ctypes.addressof(named[0])
            if text == _UNKNOWN or text in _NAMES:  # what lies behind may be another's
                return


def _text_at(memory: int, address: int) -> bytes:
    """Return the text at an address of this process, its first bytes; b"" without one."""
    with contextlib.suppress(OSError, OverflowError):
        return os.pread(memory, _LONGEST, address).partition(b"\0")[0]
    return b""


@contextlib.contextmanager
def workers_on_own_cores() -> Iterator[None]:
    """Make PoCL, if this process starts it, pin each of its workers to its own core.

    Otherwise the system often puts two of them on one core for the life of the process, and a frame
    takes one and a half times as long. It does nothing if the user has set a variable of the
    workers, or if the process may not use every core.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
    if cores != os.cpu_count() or any(name in os.environ for name in _POCL_WORKERS):
        yield
        return
    os.environ["POCL_AFFINITY"] = "1"
    try:
        yield
    finally:
        os.environ.pop("POCL_AFFINITY", None)


def cache_folder() -> Path:
    """Return the folder where PoCL keeps what it compiles."""
    named = os.environ.get("POCL_CACHE_DIR")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pocl"


def _check_owner(folder: Path) -> None:
    """Raise DeviceError if a folder is another user's, or everybody may write to it."""
    if not hasattr(os, "getuid") or not folder.exists():  # Windows has a folder for each user
        return
    status = folder.stat()
    if status.st_uid not in (os.getuid(), 0) or status.st_mode & stat.S_IWOTH:
        raise DeviceError(
            f"the compiled kernels in {str(folder)!r} may be someone else's: the folder is another "
            "user's or everybody may write to it; name another one in POCL_CACHE_DIR, or chmod o-w"
        )


def check_compiler() -> None:
    """Raise DeviceError if PoCL would end the process when it compiles, or run foreign kernels."""
    _check_owner(cache_folder())
    stuck = reason_stuck()
    if stuck:
        raise DeviceError(stuck)
    if not any(cache_folder().rglob("*.so")):
        _check_linker()


@functools.cache
def _check_linker() -> None:
    """Raise DeviceError if PoCL cannot compile; it would end this process, so a child tries it.

    It links with `ld` and the files of gcc and the C library.
    """
    if not sys.executable or getattr(sys, "frozen", False):  # there is no Python to start
        return
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={
                **os.environ,
                "PYOPENCL_NO_CACHE": "1",
                "PYTHONPATH": os.pathsep.join(sys.path),
            },
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_S,
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
        said = next((line for line in lines if line.startswith("error:")), lines[0])
        raise DeviceError(
            f"PoCL cannot compile kernels ({said}); it needs a linker (apt install gcc libc6-dev, "
            "or dnf install gcc glibc-devel) and a processor that it knows (apt install "
            "pocl-opencl-icd, or dnf install pocl, may be newer)"
        )


def reason_stuck() -> str:
    """Return why PoCL cannot start: without a writable folder it is not even listed; "" if it
    can."""
    folder = cache_folder()
    there = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=there):
            return ""
    except OSError as error:
        return (
            f"PoCL cannot write to its cache {str(folder)!r}: {error.strerror}; POCL_CACHE_DIR "
            "names another folder"
        )
