"""The folder in which compiled kernels are kept, for implementations that keep none; PoCL does.

What lies there is executed. It is trusted as pyopencl trusts its own, unless the folder is another
user's or everybody may write to it.
"""

import importlib
import os
import stat
from pathlib import Path
from typing import Any

import platformdirs
import pyopencl as cl

from cmp_cl.errors import DeviceError


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
