"""Names, errors and counts as they stand in one line of a message."""

import os
from pathlib import Path


def shown(name: object) -> str:
    """A file name as it can stand in a line: itself, or quoted with its odd characters escaped."""
    text = os.fspath(name) if isinstance(name, Path) else str(name)
    return text if text.isprintable() else repr(text)


def one_line(error: Exception) -> str:
    """The message of an error on one line."""
    if isinstance(error, OSError) and error.strerror is not None:
        name = "" if error.filename is None else f"{shown(error.filename)}: "
        return f"{name}{error.strerror}"
    return " ".join(str(error).splitlines())


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 frame, 2 frames."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
