"""Files that grow by whole parts, also on a disk that fills up."""

import contextlib
import errno
import os
from pathlib import Path
from typing import Any


class Appended:
    """A file that grows by parts, each of which is written completely or not at all.

    path: the file, which exists; it is emptied.
    """

    def __init__(self, path: Path) -> None:
        self._file: Any = open(path, "wb", buffering=0)  # noqa: SIM115, closed by close
        self.end = 0
        self._ending = b""

    def append(self, part: bytes, ending: bytes = b"") -> None:
        """Write a part; raises OSError.

        ending: what completes the file after this part; the next part is written over it.
        """
        try:
            self._write(part + ending)
        except BaseException:
            with contextlib.suppress(OSError):
                self._file.seek(self.end)
                self._write(self._ending)  # where it was before, so there is room for it
                self._file.truncate()
                self._file.seek(self.end)
            raise
        self.end, self._ending = self.end + len(part), ending
        self._file.seek(self.end)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:  # a nearly full disk may take only some of it
            rest = rest[self._file.write(rest) :]

    def close(self) -> None:
        self._file.close()


def check_room(folder: Path, size: int) -> None:
    """Raise OSError if the disk of a folder has less room than `size` bytes."""
    if hasattr(os, "statvfs"):
        disk = os.statvfs(folder)
        if disk.f_bavail * disk.f_frsize < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
