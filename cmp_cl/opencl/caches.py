"""The folders in which compiled kernels are kept: PoCL's, and cmp_cl's for others.

Their contents are executed, so a folder that others may write to is not used. pyopencl's own cache
is not used at all.
"""

import atexit
import contextlib
import importlib
import math
import os
import shutil
import stat
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import platformdirs
import pyopencl as cl

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_LEAST_LARGEST = 1 << 20  # bytes; the largest file in the cache has about 250 kB
_LEAST_FREE = 32 << 20  # bytes; a plan's kernels take some 10 MB in PoCL's cache


def own_folder() -> Path | None:
    """Return this user's folder of compiled kernels, made if missing; None if that fails.

    A folder of another user, or one that others may write to, is not used, and a warning says so.
    """
    folder = platformdirs.user_cache_path("cmp_cl", appauthor=False)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_ours(folder.lstat()):
            _warn(folder)
            return None
        if os.name != "nt":
            folder.chmod(0o700)
    except OSError:
        return None
    return folder


def _warn(folder: Path) -> None:
    warnings.warn(
        f"the kernels in {str(folder)!r} are not used: the folder is not yours alone; chmod 700 "
        "it, or name another one in XDG_CACHE_HOME",
        RuntimeWarning,
        stacklevel=3,
    )


def is_ours(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user, and no one else may write to it."""
    if not hasattr(os, "getuid"):  # Windows has a folder for each user
        return True
    return status.st_uid == os.getuid() and not status.st_mode & _OTHERS_WRITE


def read_ours(path: Path) -> bytes:
    """Read a file of this user; raises PermissionError if it is not this user's alone, and
    OSError."""
    with open(path, "rb") as file:
        if not is_ours(os.fstat(file.fileno())):
            raise PermissionError(f"{str(path)!r} is not ours alone")
        return file.read()


def pocl_folder() -> Path:
    """Return the folder where PoCL keeps what it compiles."""
    named = os.environ.get("POCL_CACHE_DIR")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pocl"


def guard_pocl() -> None:
    """Give PoCL a temporary folder in place of one that is not this user's alone.

    PoCL does not check the owner of its kernels. The folder is removed with the process, and a
    warning says so. This must be called before PoCL starts.
    """
    folder = pocl_folder()
    with contextlib.suppress(OSError):  # PoCL cannot read what cannot be inspected
        if folder.exists() and not is_ours(folder.stat()):
            _warn(folder)
            temporary = tempfile.mkdtemp(prefix="cmp_cl-")
            atexit.register(shutil.rmtree, temporary, ignore_errors=True)
            os.environ["POCL_CACHE_DIR"] = temporary


class _InMemory:
    """A cache of pyopencl that ends with the process."""

    def __init__(self) -> None:
        self._kept: dict[str, object] = {}

    def __getitem__(self, key: object) -> object:
        return self._kept[repr(key)]

    def store_if_not_present(self, key: object, value: object) -> None:
        """Keep a value, unless one is there."""
        self._kept.setdefault(repr(key), value)


_INVOKERS = _InMemory()


def guard_invokers() -> None:
    """Let pyopencl make the functions that call kernels in each process, not load them.

    In the user's cache they are pickles, which are code. pyopencl does not check their owner, and
    fails with an error of SQLite if the file is damaged or the disk is full.
    """
    name, switch = "pyopencl.invoker", "_PYOPENCL_NO_CACHE"
    if name not in sys.modules:
        before = getattr(cl, switch, None)
        setattr(cl, switch, True)  # during the import, or it would open the cache
        try:
            importlib.import_module(name)
        finally:
            setattr(cl, switch, before)
    invoker: Any = sys.modules[name]
    invoker.invoker_cache = _INVOKERS


def pocl_is_stuck() -> str:
    """Return the reason why PoCL cannot start or compile with its cache; "" if it can.

    Without a writable folder PoCL is not even listed. On a full disk, or if `ulimit -f` is too
    small for its files, it ends the process.
    """
    folder = pocl_folder()
    there = next((each for each in (folder, *folder.parents) if each.exists()), None)
    if there is None or not there.is_dir() or not os.access(there, os.W_OK):
        return (
            f"PoCL cannot write to its cache {str(folder)!r}; XDG_CACHE_HOME names another folder"
        )
    largest = _largest_file()
    if largest < _LEAST_LARGEST:
        return (
            f"no file may have more than {largest} bytes here, and PoCL ends the process if a "
            "file of its cache would; raise the limit, for example by ulimit -f unlimited"
        )
    free = shutil.disk_usage(there).free
    if free < _LEAST_FREE:
        return (
            f"PoCL's cache {str(folder)!r} is on a disk with {free} bytes left, and PoCL ends the "
            "process if it is full; free some space, or name another folder in XDG_CACHE_HOME"
        )
    return ""


def _largest_file() -> float:
    """Return the largest number of bytes that a file of this process may have."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return math.inf
    soft, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    return math.inf if soft == resource.RLIM_INFINITY else soft
