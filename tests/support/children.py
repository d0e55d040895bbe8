"""Python programs in a process of their own."""

import os
import subprocess
import sys
from typing import Any

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def python(*arguments: Any, **how: Any) -> subprocess.CompletedProcess[str]:
    """Run Python with the modules that this process can import; return the outcome, as text."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        **{"capture_output": True, "text": True, "timeout": 300, "env": ENVIRONMENT} | how,
    )
