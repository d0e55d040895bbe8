"""`cmp-cl devices`: list the OpenCL devices, and say which one is used by default."""

import argparse
import os
import statistics
import time
from collections.abc import Sequence

from cmp_cl.cli.arguments import add
from cmp_cl.cli.messages import one_line, tell
from cmp_cl.detector import Detector
from cmp_cl.errors import CmpClError
from cmp_cl.opencl.device import (
    DEVICE_VARIABLE,
    Device,
    list_devices,
    select_device,
    why_none,
)
from cmp_cl.synthetic import random_scene, render
from cmp_cl.synthetic.scoring import score

FRAMES = 100  # timed on each device
WARM_UP = 5


DESCRIPTION = """\
Lists the OpenCL devices and says which one is used by default, and why.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "--time", "time the default detector on each device, and check its answer")


def run(arguments: argparse.Namespace) -> int:
    devices = list_devices()
    if not devices:
        tell(f"no OpenCL device was found: {why_none()}")
        return 1
    _print_table(
        [("index", "name", "platform", "driver", "kind", "memory MB")]
        + [
            (d.index, d.name, d.platform, d.driver, d.kind.value, str(d.memory >> 20))
            for d in devices
        ]
    )
    chosen = select_device()
    wanted = os.environ.get(DEVICE_VARIABLE)
    why = f"the first {chosen.kind.value.upper()}"
    if wanted:
        why = f"{DEVICE_VARIABLE} is {wanted!r}"
    print(f"used by default: {chosen.index}, {chosen}: {why}")
    if arguments.time:
        time_devices(devices)
    return 0


def time_devices(devices: Sequence[Device]) -> None:
    """Print how long the default detector takes for a frame on each device, and how right it is.

    The frame is rendered, so that the true corners are known.
    """
    scene = render(random_scene(1000, markers=44, severity=0.25, corrosion=0.3))
    rows, columns = scene.image.shape
    count = scene.truth.shape[0] * scene.truth.shape[1]
    print(f"a frame of {columns} x {rows} px with {count} corners, on each device:")
    table = [("index", "median ms", "95 % ms", "missed", "false", "RMSE px")]
    for device in devices:
        try:
            with Detector(shape=scene.image.shape, device=device) as detector:
                spent = []
                for _ in range(WARM_UP + FRAMES):
                    start = time.perf_counter()
                    corners = detector(scene.image)
                    spent.append((time.perf_counter() - start) * 1e3)
        except CmpClError as error:
            tell(f"{device.index}: {one_line(error)}")
            continue
        late = statistics.quantiles(spent[WARM_UP:], n=20)[-1]
        answer = score(corners.xy, scene.truth, scene.cell, scene.junctions)
        table.append(
            (
                device.index,
                f"{statistics.median(spent[WARM_UP:]):.3f}",
                f"{late:.3f}",
                str(answer.missed),
                str(answer.false),
                f"{answer.rmse:.3f}",
            )
        )
    _print_table(table)


def _print_table(table: Sequence[Sequence[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
