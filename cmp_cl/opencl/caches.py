"""The folders in which compiled kernels are kept: PoCL's, and cmp_cl's for other implementations.

What lies there is executed. It is trusted as pyopencl trusts its own, unless the folder is another
user's or everybody may write to it.
"""

import functools
import importlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import platformdirs
import pyopencl as cl

from cmp_cl.errors import DeviceError

_LEAST_FREE = 32 << 20  # bytes; a plan's kernels take some 10 MB in PoCL's cache
_PROBE_S = 60.0
_PROBE = """
import pyopencl as cl
platform = next(p for p in cl.get_platforms() if p.name == "Portable Computing Language")
context = cl.Context(platform.get_devices()[:1])
program = cl.Program(context, "__kernel void probe(__global int *a) { a[0] = 1; }")
memory = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4)
with cl.CommandQueue(context) as queue:
    program.build(cache_dir=False).probe(queue, (1,), None, memory).wait()
"""


def own_folder() -> Path | None:
    """Return the user's folder of compiled kernels, made if missing; None if that fails.

    Raises DeviceError as `check_owner`.
    """
    folder = platformdirs.user_cache_path("cmp_cl", appauthor=False)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return None
    check_owner(folder)
    return folder


def check_owner(folder: Path) -> None:
    """Raise DeviceError if a folder is another user's, or everybody may write to it."""
    if not hasattr(os, "getuid") or not folder.exists():  # Windows has a folder for each user
        return
    status = folder.stat()
    if status.st_uid not in (os.getuid(), 0) or status.st_mode & stat.S_IWOTH:
        raise DeviceError(
            f"the compiled kernels in {str(folder)!r} may be someone else's: the folder is another "
            "user's or everybody may write to it; name another one in XDG_CACHE_HOME, or chmod o-w"
        )


def pocl_folder() -> Path:
    """Return the folder where PoCL keeps what it compiles."""
    named = os.environ.get("POCL_CACHE_DIR")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pocl"


def check_pocl() -> None:
    """Raise DeviceError if PoCL would end the process when it compiles, or run foreign kernels."""
    check_owner(pocl_folder())
    stuck = pocl_is_stuck()
    if stuck:
        raise DeviceError(stuck)
    if not any(pocl_folder().rglob("*.so")):
        _check_compiler()


@functools.cache
def _check_compiler() -> None:
    """Raise DeviceError if PoCL cannot compile; it would end this process, so a child tries it.

    It links with `ld` and the files of gcc and the C library.
    """
    if not sys.executable or getattr(sys, "frozen", False):  # there is no Python to start
        return
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env={**os.environ, "PYOPENCL_NO_CACHE": "1"},
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_S,
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    if done.returncode:
        said = (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[0]
        raise DeviceError(
            f"PoCL cannot compile kernels ({said}); it needs a linker: apt install gcc libc6-dev, "
            "or dnf install gcc glibc-devel"
        )


def pocl_is_stuck() -> str:
    """Return the reason why PoCL cannot start or compile with its cache; "" if it can.

    Without a writable folder PoCL is not even listed. On a full disk it ends the process.
    """
    folder = pocl_folder()
    there = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        return (
            f"PoCL cannot write to its cache {str(folder)!r}: {error.strerror}; XDG_CACHE_HOME "
            "names another folder"
        )
    free = shutil.disk_usage(there).free
    if free < _LEAST_FREE:
        return (
            f"PoCL's cache {str(folder)!r} is on a disk with {free} bytes left, and PoCL ends the "
            "process if it is full; free some space, or name another folder in XDG_CACHE_HOME"
        )
    return ""


class _InMemory(dict[object, object]):
    """A cache of pyopencl that ends with the process."""

    store_if_not_present = dict.setdefault


_INVOKERS = _InMemory()


def guard_invokers() -> None:
    """Let pyopencl make the functions that call kernels in each process, not load them.

    It keeps them in SQLite, and fails if the folder cannot be written or the disk is full.
    """
    library: Any = cl
    before, library._PYOPENCL_NO_CACHE = library._PYOPENCL_NO_CACHE, True
    try:
        invoker: Any = importlib.import_module("pyopencl.invoker")  # would open the cache
    finally:
        library._PYOPENCL_NO_CACHE = before
    invoker.invoker_cache = _INVOKERS
