"""Python programs in a process of their own, and a disk that fills up."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def python(*arguments: Any, **how: Any) -> subprocess.CompletedProcess[str]:
    """Run Python with the modules that this process can import; return the outcome, as text."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        **{"capture_output": True, "text": True, "timeout": 300, "env": ENVIRONMENT} | how,
    )


@contextlib.contextmanager
def full_after(size: int) -> Iterator[None]:
    """Let no file grow beyond `size` bytes: more is an OSError, as on a full disk."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
