"""`cmp-cl devices`: the OpenCL devices."""

import argparse
import os
import sys

from cmp_cl.cli.messages import tell
from cmp_cl.opencl.device import DEVICE_VARIABLE, list_devices, select_device, why_none

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
                     RUSTICL_ENABLE=radeonsi"""


HELP = "list the OpenCL devices, and say which one is used by default"
DESCRIPTION = """\
Lists the OpenCL devices and says which one is used by default, and why.
"""


def add_arguments(_: argparse.ArgumentParser) -> None:
    """Add no arguments: the command has none."""


def run(_: argparse.Namespace) -> int:
    """Print the devices; return 1 if there is none."""
    devices = list_devices()
    if not devices:
        tell(f"no OpenCL device was found: {why_none()}")
        print(INSTALL, file=sys.stderr)
        return 1
    table = [("index", "name", "platform", "driver", "kind", "memory MB")]
    for d in devices:
        table.append((d.index, d.name, d.platform, d.driver, d.kind.value, str(d.memory >> 20)))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    chosen = select_device()
    wanted = os.environ.get(DEVICE_VARIABLE)
    why = f"the first {chosen.kind.value.upper()}"
    if wanted:
        why = f"{DEVICE_VARIABLE} is {wanted!r}"
    print(f"used by default: {chosen.index}, {chosen}: {why}")
    return 0
