"""Files in and out: written whole or not at all, images read as grey."""

import os
import tempfile
from os import PathLike
from pathlib import Path


def write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all: a temporary file in the same folder, then renamed.

    Raises OSError where the folder is missing or not writable.
    """
    target = Path(path)
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder, not a file")
    handle, name = tempfile.mkstemp(prefix=f".{target.name[:32]}.", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(name, _mode(target))
        os.replace(name, target)
    except BaseException:
        os.unlink(name)
        raise


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write UTF-8 text whole or not at all, line ends as they are; raises OSError."""
    write_bytes(path, text.encode("utf-8"))


def _mode(target: Path) -> int:
    """Permissions of the file that is replaced, else those that open() would give."""
    if target.exists():
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
