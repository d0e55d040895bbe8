"""A file for a library that takes a name and does not report a full disk."""

import contextlib
import io
import os
import tempfile
import threading
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from cmp_cl.files import whole_file

_CHUNK = 1 << 16


class PipedFile:
    """A named pipe whose bytes go to a file, which appears whole or not at all.

    begin: a function that is called with the name of the pipe and opens it for writing. Where the
    system has no named pipes, the name is that of a temporary file, and `check` does nothing.

    Raises OSError as `whole_file` does, and what `begin` raises.
    """

    def __init__(self, path: str | PathLike[str], begin: Callable[[str], object]) -> None:
        self._path = path
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None
        with contextlib.ExitStack() as stack:
            file = stack.enter_context(whole_file(path))
            if not hasattr(os, "mkfifo"):
                begin(file.name)
            else:
                name = str(Path(stack.enter_context(tempfile.TemporaryDirectory())) / "pipe")
                os.mkfifo(name)
                end = os.open(name, os.O_RDONLY | os.O_NONBLOCK)  # does not wait for the writer
                pipe = stack.enter_context(open(end, "rb", buffering=0))
                begin(name)
                os.set_blocking(end, True)
                self._thread = threading.Thread(target=self._copy, args=(pipe, file), daemon=True)
                self._thread.start()
            self._stack = stack.pop_all()

    def _copy(self, pipe: io.FileIO, file: BinaryIO) -> None:
        while data := pipe.read(_CHUNK):
            if self._error is None:  # after an error it reads on, or the writer would wait
                try:
                    file.write(data)
                except OSError as error:
                    self._error = OSError(error.errno, error.strerror, os.fspath(self._path))

    def check(self) -> None:
        """Raise the OSError of a write that failed."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Wait until the writer has closed the pipe; the file appears if all was written.

        Raises the OSError of a write that failed; an older file is then kept.
        """
        with self._stack:
            if self._thread is not None:
                self._thread.join()
            self.check()

    def abandon(self) -> None:
        """Remove what was written, as `close` does after an error; an older file is kept."""
        if self._thread is not None:
            self._thread.join()
        error = InterruptedError()
        self._stack.__exit__(type(error), error, None)
