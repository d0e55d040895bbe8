"""Files written whole or not at all."""

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def whole_file(path: str | PathLike[str]) -> Iterator[BinaryIO]:
    """A file to write that appears under its name only when the block ends without an error.

    It is a temporary file in the same folder, renamed at the end; what stood under the name
    stays until then. Devices and pipes are written as they are. Raises OSError where the
    folder is missing, not writable or full.
    """
    target = check_target(path)
    if target.exists() and not target.is_file():
        with _named(path), open(target, "wb") as file:
            yield file
        return
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with _named(path, temporary):
            with open(temporary, "xb") as file:
                yield file
            os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def check_target(path: str | PathLike[str]) -> Path:
    """The place that a path to write to names, with links resolved.

    Raises OSError where it is empty or a folder, or lies in a folder that is not there.
    """
    if not os.fspath(path):
        raise FileNotFoundError("'' is no name of a file")
    if os.path.isdir(path):
        raise IsADirectoryError(f"{str(path)!r} is a folder, not a file")
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {str(target.parent)!r} to write to")
    return target


@contextlib.contextmanager
def _named(path: str | PathLike[str], temporary: Path | None = None) -> Iterator[None]:
    """Say the path in errors that name a temporary file, or a full disk and no file."""
    full = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    try:
        yield
    except OSError as error:
        unnamed = error.filename is None and error.errno in full
        if unnamed or (temporary is not None and error.filename == str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all; raises OSError."""
    with whole_file(path) as file:
        file.write(data)


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write UTF-8 text whole or not at all, line ends as they are; raises OSError."""
    write_bytes(path, text.encode("utf-8"))
