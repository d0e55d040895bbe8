"""Files that keep what was written when the disk fills up."""

import contextlib
import errno
import os
import tempfile
from os import PathLike
from pathlib import Path
from typing import IO, Any

from cmp_cl.files import check_target, whole_file

_ZEROS = bytes(1 << 16)


class Appended:
    """A file that appears when it is finished, with all parts that were written completely.

    On a full disk it keeps those parts. If there is none, an older file stays.

    files: on leaving this context the file appears, or is removed if an error was raised.
    """

    def __init__(self, path: str | PathLike[str], files: contextlib.ExitStack) -> None:
        buffered: Any = files.enter_context(whole_file(path))
        self._file = buffered.raw  # a buffer would keep the bytes that a full disk refused
        self._path = path
        self._end = 0
        self.error: OSError | None = None

    def append(self, part: bytes) -> None:
        """Write a part completely or not at all; raises OSError."""
        try:
            write_all(self._file, part)
        except OSError as error:
            self.error = OSError(error.errno, error.strerror, str(self._path))
            with contextlib.suppress(OSError):  # a device or a pipe cannot be truncated
                self._file.truncate(self._end)
                self._file.seek(self._end)
            raise self.error from error
        self._end += len(part)

    def check_whole(self) -> None:
        """Raise OSError if the disk has refused the first part."""
        if self.error is not None and not self._end:
            raise self.error


class Reserve:
    """Disk space that is reserved for the last parts of a file.

    folder: a folder on that disk; None reserves nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._file: IO[bytes] | None = None
        self._size = 0

    def grow(self, size: int) -> None:
        """Reserve at least `size` bytes; raises OSError if the disk is full."""
        if self._folder is None:
            return
        if self._file is None:
            self._file = tempfile.TemporaryFile(  # noqa: SIM115, closed by free
                dir=self._folder, buffering=0
            )
        while self._size < size:
            written = self._file.write(_ZEROS)
            if not written:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._size += written

    def free(self) -> None:
        """Release the space for good."""
        self._folder = None
        if self._file is not None:
            self._file.close()


class Finishable:
    """A file that appears when it is finished, and can be finished on a full disk.

    It is for writers of other packages, whose files cannot be read without their last part.
    `expect` reserves disk space for the data that wait in memory. When the disk is full, that space
    is released and the data are written there. From then on `check` raises an error, so that
    nothing more is added.

    files: on leaving this context the file appears, or is removed if an error was raised.
    """

    closed = False  # the attribute that a file has

    def __init__(self, path: str | PathLike[str], files: contextlib.ExitStack) -> None:
        target = check_target(path)
        buffered: Any = files.enter_context(whole_file(path))
        self._file = buffered.raw
        self._reserve = Reserve(None if target.exists() and not target.is_file() else target.parent)
        files.callback(self._reserve.free)
        self._path = path
        self._length = 0
        self._error: OSError | None = None
        self._cut = False

    def expect(self, size: int) -> None:
        """Reserve `size` bytes; if the disk is full, note it and release the reserve."""
        if self._error is None:
            try:
                self._reserve.grow(size)
            except OSError as error:
                self._full(error)

    def check(self) -> None:
        """Raise OSError if the disk is full."""
        if self._error is not None:
            raise self._error

    def check_whole(self) -> None:
        """Raise OSError if the disk has refused what was written."""
        if self._cut:
            self.check()

    def _full(self, error: OSError) -> None:
        self._error = OSError(error.errno, error.strerror, str(self._path))
        self._reserve.free()

    def write(self, data: bytes | memoryview) -> int:
        """Write all data, into the reserved space if necessary; raises OSError."""
        part = memoryview(data).cast("B")
        try:
            done = 0
            while done < len(part):  # a nearly full disk may take only some of it
                done += self._try(part[done:])
        except OSError:
            self._cut = True
            raise
        self._length += len(part)
        return len(part)

    def _try(self, part: memoryview) -> int:
        try:
            return int(self._file.write(part))
        except OSError as error:
            if self._error is not None:
                raise
            self._full(error)
            return int(self._file.write(part))

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._length

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


def write_all(file: Any, part: bytes) -> None:
    """Write data to an unbuffered file; raises OSError."""
    rest = memoryview(part)
    while rest:  # a nearly full disk may take only some of it
        rest = rest[file.write(rest) :]
