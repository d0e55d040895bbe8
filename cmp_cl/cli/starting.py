"""Ctrl-C, SIGTERM and SIGHUP while a command's modules are imported: one line, status 130.

This is imported before all else. Importing takes most of a second. During it, Python would answer
Ctrl-C with a traceback and the others with another status. `main` installs its own handlers.
"""

import os
import signal
import sys
from pathlib import PurePath

_COMMAND = "cmp-cl"


def is_command(program: str, arguments: list[str]) -> bool:
    """Return whether a process is `cmp-cl` or `python -m cmp_cl`.

    program: its sys.argv[0]. arguments: its sys.orig_argv.
    """
    return PurePath(program).stem == _COMMAND or (program == "-m" and "cmp_cl" in arguments)


def _end(_: int, __: object) -> None:
    os.write(2, b"cmp-cl: interrupted\n")
    os._exit(130)


if is_command(sys.argv[0] if sys.argv else "", sys.orig_argv):
    for _name in ("SIGINT", "SIGTERM", "SIGHUP"):
        _number = getattr(signal, _name, None)  # Windows has no SIGHUP
        if _number is not None and signal.getsignal(_number) != signal.SIG_IGN:
            signal.signal(_number, _end)
