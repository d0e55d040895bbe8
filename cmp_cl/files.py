"""Files written whole or not at all, and settings and arrays read within bounds."""

import contextlib
import csv
import errno
import importlib.metadata
import math
import os
import re
import secrets
import shutil
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import ZipFile, is_zipfile

import numpy as np
from numpy.typing import NDArray

_MOST_TOML = 1 << 16  # bytes
_WRITABLE = 0o222  # mode bits that allow writing
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def version() -> str:
    """Return the version of cmp_cl, as files state it; "unknown" if it is not installed."""
    try:
        return importlib.metadata.version("cmp-cl")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def suffix_of(path: str | PathLike[str]) -> str:
    """Return the suffix of a path in small letters."""
    return Path(path).suffix.lower()


@contextlib.contextmanager
def whole_file(path: str | PathLike[str]) -> Iterator[BinaryIO]:
    """Give a file to write, as `whole_path` does, open."""
    with whole_path(path) as temporary, open(temporary, "wb") as file:
        yield file


@contextlib.contextmanager
def whole_path(path: str | PathLike[str], suffix: str = ".tmp") -> Iterator[Path]:
    """Give a file to write, which gets the name `path` only if the block ends without an error.

    It lies in the same folder. An older file stays until then, and its mode is kept. suffix: the
    suffix of its name. Raises OSError if the disk is full, and as `check_target`.
    """
    target = check_target(path)
    temporary = target.with_name(f".{secrets.token_hex(8)}{suffix}")
    try:
        with open(temporary, "xb"), contextlib.suppress(FileNotFoundError):
            shutil.copymode(target, temporary)
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        full = error.filename is None and error.errno in _FULL
        if full or error.filename == str(temporary):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def check_target(path: str | PathLike[str]) -> Path:
    """Return the file that an output path names, with links resolved.

    Raises OSError if the path is a folder, a device or a read-only file, or lies in a folder that
    does not exist.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, "it is a folder or a device, not a file", str(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {str(target.parent)!r} to write to")
    if target.is_file() and not (os.access(target, os.W_OK) and target.stat().st_mode & _WRITABLE):
        raise PermissionError(errno.EACCES, "the file is read-only", str(path))
    return target


def new_folder(path: Path) -> tuple[Path, list[Path]]:
    """Make a folder of that name, or NAME-2, NAME-3 and so on if that exists.

    Returns it and those that exist.
    """
    free, taken = path, []
    while True:
        try:
            free.mkdir()
        except FileExistsError:
            taken.append(free)
            free = path.with_name(f"{path.name}-{len(taken) + 1}")
        else:
            return free, taken


def write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write data to a file whole or not at all, see `whole_file`; raises OSError."""
    with whole_file(path) as file:
        file.write(data)


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write UTF-8 text whole or not at all, line ends as they are; raises OSError."""
    write_bytes(path, text.encode("utf-8"))


def write_csv(
    path: str | PathLike[str], columns: Iterable[str], rows: Iterable[Iterable[object]]
) -> None:
    """Write rows as CSV under a header of `columns`, whole or not at all; raises OSError."""
    write_bytes(path, csv_bytes([columns, *rows]))


def csv_bytes(rows: Iterable[Iterable[object]]) -> bytes:
    """Return rows as CSV in UTF-8.

    A text that a spreadsheet would take for a formula begins with an apostrophe (OWASP, CSV
    injection).
    """
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([map(_harmless, row) for row in rows])
    return text.getvalue().encode("utf-8", "backslashreplace")


def _harmless(cell: object) -> object:
    formula = isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r"))
    return f"'{cell}" if formula else cell


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """Read settings in TOML; a byte order mark is skipped.

    Raises OSError if the file cannot be read, ValueError if it is not TOML in UTF-8 or is larger
    than 64 KiB.
    """
    with open(path, "rb") as file:
        data = file.read(_MOST_TOML + 1)
    if len(data) > _MOST_TOML:
        raise ValueError(f"over {_MOST_TOML} bytes, no settings")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError("it is not text in UTF-8") from error
    try:
        return tomllib.loads(text.replace("\r\n", "\n"))
    except RecursionError as error:
        raise ValueError("nested too deep, no settings") from error
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"it is not TOML: {error}") from error


def read_npz(
    path: str | PathLike[str],
    names: Collection[str] | None,
    check: Callable[[dict[str, NDArray[Any]]], None],
) -> dict[str, NDArray[Any]]:
    """Return the arrays of those names, as far as they are there, from a file that `numpy.savez`
    wrote; None means all.

    check: raises ValueError for arrays of other shapes or types. It is given arrays like those that
        the file promises, without their values, before they are read.

    Raises OSError if the file cannot be read; ValueError if it is damaged or of another kind, or
    the arrays do not fit into the memory that is free.
    """
    with open(path, "rb") as file:
        try:
            if not is_zipfile(file):
                raise ValueError("it is cut off, or not what numpy.savez writes")
            file.seek(0)
            with np.load(file, allow_pickle=False) as data:
                found = [name for name in data if names is None or name in names]
                promised = {name: _promised(data.zip, f"{name}.npy") for name in found}
                check(promised)
                check_memory(sum(array.nbytes for array in promised.values()))
                return {name: data[name] for name in found}
        except Exception as why:  # damaged bytes raise any of them, in zipfile and NumPy
            raise ValueError(why) from why


def _promised(data: ZipFile, name: str) -> NDArray[Any]:
    """Return an array that takes no memory, of the shape and type that the header in .npy says."""
    with data.open(name) as file:
        old = np.lib.format.read_magic(file) == (1, 0)
        header = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(file)
    return np.broadcast_to(np.empty((), dtype), shape)


def check_memory(size: int) -> None:
    """Raise ValueError if arrays of that many bytes do not fit into the memory that is free."""
    free = math.inf
    with contextlib.suppress(OSError):  # there is none on other systems than Linux
        found = re.search(r"MemAvailable: *(\d+) kB", Path("/proc/meminfo").read_text("ascii"))
        free = 1024 * int(found[1]) if found else free
    if size > free:
        raise ValueError(f"its arrays need {size} bytes, and {free} bytes of memory are free")
