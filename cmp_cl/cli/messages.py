"""Names, errors and counts as they stand in one line of a message."""

import os
from pathlib import Path

_LONGEST = 1000  # letters of a message: a value that is refused may be of any length


def shown(name: object) -> str:
    """Return a file name as one line shows it: itself, or quoted with odd characters escaped."""
    text = os.fspath(name) if isinstance(name, Path) else str(name)
    return text if text.isprintable() else repr(text)


def one_line(error: Exception) -> str:
    """Return the message of an error on one line."""
    if isinstance(error, OSError) and error.strerror is not None:
        name = "" if error.filename is None else f"{shown(error.filename)}: "
        return shortened(f"{name}{error.strerror}")
    return shortened(" ".join(str(error).splitlines()))


def shortened(line: str) -> str:
    """Return a line without its middle where it is longer than anyone reads."""
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 100]} ... {line[-90:]}"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: 1 frame, 2 frames."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
