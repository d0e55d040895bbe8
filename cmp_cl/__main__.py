"""The entry of `cmp-cl` and of `python -m cmp_cl`.

It answers Ctrl-C, SIGTERM and SIGHUP before the rest is imported, which takes most of a second.
During it, Python would answer Ctrl-C with a traceback and the others with another status.
`cmp_cl.cli.main` installs its own handlers.
"""

import os
import signal
import sys


def _end(_: int, __: object) -> None:
    os.write(2, b"cmp-cl: interrupted\n")
    os._exit(130)


def main() -> int:
    """Run the command of this process; return its exit status."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)

    from cmp_cl.cli.main import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
