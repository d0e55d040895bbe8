"""`cmp-cl bench`: time the detector on this machine's device."""

import argparse
import statistics
import time
from collections.abc import Sequence
from typing import Any

from cmp_cl.cli.arguments import add_device
from cmp_cl.config import BinaryRings, DetectorConfig, EdgeLines
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.synthetic import Rendered, random_scene, render
from cmp_cl.synthetic.scoring import score


def add_parser(commands: Any) -> None:
    """Add `bench` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "bench",
        help="time the detector on this machine's device",
        description="Times the detector on a rendered 640 x 480 frame of 1936 corners, checks the "
        "answer against the truth, and shows how the time is spent.",
    )
    parser.add_argument(
        "--repeats",
        metavar="N",
        type=int,
        default=100,
        help="frames of each configuration; default: 100",
    )
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Time a few configurations on a rendered VGA frame, and check their answers.

    Raises ConfigError if --repeats is under 1, and the errors of `Detector`.
    """
    if arguments.repeats < 1:
        raise ConfigError(f"--repeats must be 1 or more, not {arguments.repeats}")
    measure(select_device(arguments.device), arguments.repeats)
    return 0


def measure(device: Device, repeats: int) -> None:
    """Print a table of configurations for a device, and the times of the default one's kernels."""
    scene = render(random_scene(1000, markers=44, severity=0.25, corrosion=0.3))
    default = DetectorConfig()
    configs = {
        "default": default,
        "EDGE_LINES": default.replace(refinement=EdgeLines()),
        "binary rings": default.replace(detection=BinaryRings()),
        "centroids": default.replace(refinement=None),
    }
    print(f"{device}, driver {device.driver}")
    print(f"640 x 480, {scene.truth.shape[0] * scene.truth.shape[1]} corners, one frame at a time")
    print(f"{'configuration':16}{'ms':>8}{'95 %':>8}{'missed':>8}{'false':>7}{'RMSE px':>9}")
    for name, config in configs.items():
        with Detector(shape=scene.image.shape, config=config, device=device) as detector:
            spent, corners = _timed(detector, scene.image, repeats)
        answer = _answer(corners, scene)
        print(f"{name:16}{statistics.median(spent):8.3f}{_late(spent):8.3f}{answer}")
    with Detector(shape=scene.image.shape, config=default, device=device, profile=True) as detector:
        _timed(detector, scene.image, 10)
        longest = sorted(detector.times.items(), key=lambda stage: -stage[1])
    print("kernels of the default, us: " + ", ".join(f"{k} {1e3 * ms:.0f}" for k, ms in longest))


def _timed(detector: Detector, image: GreyImage, repeats: int) -> tuple[list[float], Corners]:
    """Return the milliseconds of each call, after five warm-up calls, and the last answer."""
    spent = []
    for k in range(repeats + 5):
        start = time.perf_counter()
        corners = detector(image)
        if k >= 5:
            spent.append((time.perf_counter() - start) * 1e3)
    return spent, corners


def _late(spent: Sequence[float]) -> float:
    """Return the 95th percentile."""
    return sorted(spent)[min(len(spent) - 1, int(0.95 * len(spent)))]


def _answer(corners: Corners, scene: Rendered) -> str:
    answer = score(corners.xy, scene.truth, scene.cell, scene.junctions)
    return f"{answer.missed:8}{answer.false:7}{answer.rmse:9.3f}"
