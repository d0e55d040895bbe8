"""The command line: `cmp-cl COMMAND`.

Exit status: 0 done, 1 `devices` has found no device, 2 the command failed
(one line on stderr says what), 130 stopped by Ctrl-C, SIGTERM or SIGHUP.
"""

import argparse
import contextlib
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NoReturn, TextIO

import cv2

import cmp_cl
from cmp_cl.cli import bench as benchmark
from cmp_cl.cli import calibrate, demo, detect, pattern, plot, render, run, tune
from cmp_cl.cli.messages import by_options, one_line, shortened
from cmp_cl.cli.stopping import handled, interrupt
from cmp_cl.errors import CmpClError, KernelBuildError
from cmp_cl.media import codec_messages_caught
from cmp_cl.opencl.caches import pocl_is_stuck
from cmp_cl.opencl.device import DEVICE_VARIABLE

INSTALL = """\
What to install for a device:
  Linux, x86-64      pip install "pyopencl[pocl]": PoCL, which runs on every such CPU and needs a
                     linker: apt install gcc libc6-dev, or dnf install gcc glibc-devel
  Linux, other CPUs  apt install pocl-opencl-icd (Debian, Ubuntu) or dnf install pocl (Fedora)
  Windows            the graphics driver of NVIDIA, AMD or Intel, or Intel's CPU Runtime for OpenCL
  macOS              conda install -c conda-forge pyopencl pocl; for Apple's own OpenCL
                     ocl_icd_wrapper_apple instead of pocl
  Jetson             NVIDIA ships no OpenCL for it; apt install pocl-opencl-icd uses its CPU
  NVIDIA             the driver; on Debian also nvidia-opencl-icd; in a container
                     NVIDIA_DRIVER_CAPABILITIES=compute,utility and a file
                     /etc/OpenCL/vendors/nvidia.icd that says libnvidia-opencl.so.1
  Intel              GPU: apt install intel-opencl-icd; CPU: Intel's CPU Runtime for OpenCL
  AMD                ROCm's rocm-opencl-runtime, or apt install mesa-opencl-icd and
                     RUSTICL_ENABLE=radeonsi
If PoCL cannot write its cache, it is not found; set XDG_CACHE_HOME to a folder that it can
write."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    argv: the arguments without the program's name; None means those of the process.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    # OpenCV 4 and 5 call it differently; 0 is silent.
    set_log_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_log_level(0)
    _open_streams()
    arguments = argparse.Namespace()
    try:
        with handled(interrupt), codec_messages_caught(), warnings.catch_warnings():
            warnings.showwarning = _warn  # type: ignore[assignment]
            arguments = _parser().parse_args(argv)
            run: Callable[[argparse.Namespace], int] = arguments.run
            status = run(arguments)
            sys.stdout.flush()  # a full disk is reported now
        return status
    except KernelBuildError as error:
        return _fail(str(error))
    except BrokenPipeError:
        _silence(sys.stdout)
        return 0
    except (CmpClError, OSError) as error:
        return _fail(by_options(one_line(error), arguments))
    except MemoryError:
        return _fail("there is not enough memory for this")
    except KeyboardInterrupt:
        return _fail("interrupted", status=130)


def _open_streams() -> None:
    """Open a sink for each closed standard stream, or the next open file takes its number."""
    for number, mode in ((0, "r"), (1, "w"), (2, "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
            name = ("stdin", "stdout", "stderr")[number]
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115, for good
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _silence(stream: TextIO) -> None:
    """Discard what a stream still buffers, or Python complains at its end."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        message = re.sub("invalid int value: (.*)", r"\1 is not a whole number", message)
        message = re.sub("invalid float value: (.*)", r"\1 is not a number", message)
        self.exit(2, f"{self.prog}: {shortened(message)}; {self.prog} --help says more\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="cmp-cl",
        description="Finds the corners of deformed checkerboards on any OpenCL device, and "
        "measures the deformation.",
    )
    parser.add_argument("--version", action="version", version=f"cmp-cl {cmp_cl.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_devices(commands)
    detect.add_parser(commands)
    render.add_parser(commands)
    demo.add_parser(commands)
    run.add_parser(commands)
    plot.add_parser(commands)
    calibrate.add_parser(commands)
    tune.add_parser(commands)
    benchmark.add_parser(commands)
    pattern.add_parser(commands)
    return parser


def _warn(message: Warning | str, *_: object) -> None:
    print(f"cmp-cl: {message}", file=sys.stderr)


def _fail(message: str, *, status: int = 2) -> int:
    try:
        sys.stdout.flush()
    except OSError:
        _silence(sys.stdout)
    try:
        print(f"cmp-cl: {message}", file=sys.stderr, flush=True)
    except OSError:  # the terminal is closed
        _silence(sys.stderr)
    return status


# devices


def _add_devices(commands: Any) -> None:
    parser = commands.add_parser(
        "devices",
        help="list the OpenCL devices, and say which one is used by default",
        description="Lists the OpenCL devices and says which one is used by default, and why.",
    )
    parser.set_defaults(run=_devices)


def _devices(arguments: argparse.Namespace) -> int:
    devices = cmp_cl.list_devices()
    if not devices:
        print(f"cmp-cl: no OpenCL device was found: {_why_none()}", file=sys.stderr)
        print(INSTALL, file=sys.stderr)
        return 1
    rows = [("index", "name", "platform", "driver", "kind", "memory MB")]
    rows += [
        (d.index, d.name, d.platform, d.driver, d.kind.value, str(d.memory >> 20)) for d in devices
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )
    chosen = cmp_cl.select_device()
    wanted = os.environ.get(DEVICE_VARIABLE)
    why = f"the first {chosen.kind.value.upper()}"
    if wanted is not None:
        why = f"{DEVICE_VARIABLE} is {wanted!r}"
    print(f"used by default: {chosen.index}, {chosen}: {why}")
    return 0


def _why_none() -> str:
    stuck = pocl_is_stuck()
    if stuck:
        return stuck
    folder = os.environ.get("OCL_ICD_VENDORS", "/etc/OpenCL/vendors")
    if os.path.isdir(folder):
        drivers = sorted(name for name in os.listdir(folder) if name.endswith(".icd"))
    else:
        drivers = [folder] if os.path.isfile(folder) else []
    if drivers:
        return f"{', '.join(drivers)} in {folder} cannot be loaded or have no device"
    return f"no driver is registered in {folder}"
