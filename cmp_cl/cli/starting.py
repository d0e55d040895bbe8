"""Ctrl-C while a command's modules are imported: one line, status 130.

This is imported before all else. Importing takes most of a second, in which Python would answer
Ctrl-C with a traceback. `main` has handlers of its own.
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


if (
    is_command(sys.argv[0] if sys.argv else "", sys.orig_argv)
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, _end)
