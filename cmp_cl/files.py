"""Files written whole or not at all, and settings and arrays read."""

import contextlib
import csv
import errno
import importlib.metadata
import os
import secrets
import shutil
import tomllib
from collections.abc import Collection, Iterable, Iterator
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

_WRITABLE = 0o222  # mode bits that allow writing
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def version() -> str:
    """Return the version of cmp_cl, as files state it; "unknown" if it is not installed."""
    try:
        return importlib.metadata.version("cmp-cl")
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


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
    does not exist or cannot be written.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, "it is a folder or a device, not a file", str(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {str(target.parent)!r} to write to")
    if target.is_file() and not (os.access(target, os.W_OK) and target.stat().st_mode & _WRITABLE):
        raise PermissionError(errno.EACCES, "the file is read-only", str(path))
    if not target.exists() and not os.access(target.parent, os.W_OK):
        raise PermissionError(errno.EACCES, "its folder cannot be written", str(path))
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
    """Return rows as CSV in UTF-8."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")


def read_toml(path: str | PathLike[str]) -> dict[str, Any]:
    """Read settings in TOML; a byte order mark is skipped.

    Raises OSError if the file cannot be read, ValueError if it is not TOML in UTF-8.
    """
    try:
        return tomllib.loads(Path(path).read_text("utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"it is not TOML in UTF-8: {error}") from error


def read_npz(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Return the arrays of those names, as far as they are there, from a file that `numpy.savez`
    wrote; None means all.

    Raises OSError if the file cannot be read; ValueError if it is damaged or of another kind.
    """
    with open(path, "rb") as file:
        try:
            with np.load(file, allow_pickle=False) as data:
                return {name: data[name] for name in data if names is None or name in names}
        except Exception as why:  # damaged bytes raise any of them, in zipfile and NumPy
            raise ValueError(why) from why
