"""The command line: `cmp-cl COMMAND`.

Exit status: 0 done, 1 `devices` has found no device, 2 the command failed
(one line on stderr says what), 130 stopped by Ctrl-C, SIGTERM or SIGHUP.
"""

import argparse
import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NoReturn, TextIO

import cv2

from cmp_cl.cli import calibrate, demo, detect, devices, pattern, plot, render, run
from cmp_cl.cli.messages import one_line, shortened, tell
from cmp_cl.cli.running.stopping import handled, interrupt
from cmp_cl.errors import CmpClError, KernelBuildError
from cmp_cl.files import version


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    argv: the arguments without the program's name; None means those of the process.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # OpenCV 4 and 5 call it differently; 0 is silent.
    set_log_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_log_level(0)
    _open_streams()
    try:
        with handled(interrupt), warnings.catch_warnings():
            warnings.showwarning = lambda message, *_: tell(str(message))
            arguments = _parser().parse_args(argv)
            run: Callable[[argparse.Namespace], int] = arguments.run
            stdout: Any = sys.stdout
            if getattr(arguments, "out", None) not in (None, "-"):
                stdout = _Unheard(stdout)
            with contextlib.redirect_stdout(stdout):
                status = run(arguments)
                stdout.flush()  # a full disk is reported now
        return status
    except KernelBuildError as error:
        return _fail(str(error))
    except BrokenPipeError:
        _silence(sys.stdout)
        return 0
    except (CmpClError, OSError) as error:
        return _fail(one_line(error))
    except MemoryError:
        return _fail("there is not enough memory for this")
    except KeyboardInterrupt:
        return _fail("interrupted", status=130)


def _open_streams() -> None:
    """Open a sink for each closed standard stream; it takes the number that is free."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115, for good
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _silence(stream: TextIO) -> None:
    """Discard what a stream still buffers, or Python complains at its end."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Unheard:
    """A stream whose reader may leave, as `head` does; the file that was asked for is made."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with self._goes_on():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._goes_on():
            self._stream.flush()

    @contextlib.contextmanager
    def _goes_on(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            _silence(self._stream)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {shortened(message)}; {self.prog} --help says more\n")

    def parse_known_args(self, *given: Any, **how: Any) -> Any:  # what only a command knows
        found, unknown = super().parse_known_args(*given, **how)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="cmp-cl",
        description="Finds the corners of deformed checkerboards on any OpenCL device, and "
        "measures the deformation.",
    )
    parser.add_argument("--version", action="version", version=f"cmp-cl {version()}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in (demo, pattern, calibrate, run, plot, detect, render, devices):
        name = command.__name__.rpartition(".")[2]
        what = (command.__doc__ or "").partition(": ")[2].rstrip(".")
        inner = commands.add_parser(  # --rig is no short form of --right
            name, help=what, description=command.DESCRIPTION, allow_abbrev=False
        )
        command.add_arguments(inner)
        inner.set_defaults(run=command.run)
    return parser


def _fail(message: str, *, status: int = 2) -> int:
    try:
        sys.stdout.flush()
    except OSError:
        _silence(sys.stdout)
    try:
        tell(message)
    except OSError:  # the terminal is closed
        _silence(sys.stderr)
    return status
