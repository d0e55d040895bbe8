"""What commands print: names, errors and counts in one line."""

import os
import sys
from pathlib import Path

_LONGEST = 1000  # characters of a message; a refused value may have any length


def shown(name: object) -> str:
    """Return a file name for one line: as it is, or quoted with unprintable characters escaped."""
    text = os.fspath(name) if isinstance(name, Path) else str(name)
    return text if text.isprintable() else repr(text)


def one_line(error: Exception) -> str:
    """Return the message of an error on one line."""
    if isinstance(error, OSError) and error.strerror is not None:
        name = "" if error.filename is None else f"{shown(error.filename)}: "
        return shortened(f"{name}{error.strerror}")
    return shortened(" ".join(str(error).splitlines()))


def shortened(line: str) -> str:
    """Cut out the middle of a line that is longer than _LONGEST."""
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 100]} ... {line[-90:]}"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: 1 frame, 2 frames."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def tell(line: str) -> None:
    """Print a line of this program on stderr."""
    print(f"cmp-cl: {line}", file=sys.stderr, flush=True)
