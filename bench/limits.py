"""Where it fails: float32 kernels against the float64 oracle, unusual images, and the levels of
blur, noise, light, size and deformation at which each method breaks.

    python bench/limits.py --quick      few levels, two minutes
    python bench/limits.py              about ten minutes

A row of results/limits.csv is a method at one level of one difficulty; results/stiff.csv has the
single cases and the differences to the oracle, each beside what is expected.
"""

import argparse
import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2
import methods
import numpy as np
from environment import main_of
from peers import Pattern, available
from scenes import MILD, TEST_SEED, rendered

from cmp_cl import Detector, DetectorConfig, EdgeLines, GridError, detect, reference
from cmp_cl.errors import ConfigError
from cmp_cl.synthetic import Scene, Surround, random_scene
from cmp_cl.synthetic.boards import drawn, plane
from cmp_cl.synthetic.scoring import total

SEED = TEST_SEED + 900_000
CLOSE = 1e-4  # a check so near to its bound may decide either way in float32
MARKERS = 30
SHOWN = ("good_features", "chess_opencl", "spectrum_opencl", "chess_corners_saddle")
Row = dict[str, Any]
Make = Callable[[float, int], Scene]


# where each method breaks


def sweeps() -> dict[str, tuple[list[float], Make]]:
    """Return, for each difficulty, its levels, and the scene of a level and a seed."""

    def base(seed: int, markers: int = MARKERS, **changes: Any) -> Scene:
        scene = random_scene(seed, markers=markers, **MILD)
        return dataclasses.replace(scene, surround=Surround.GREY, **changes)

    return {
        "blur, px": ([0.5, 1, 1.5, 2, 2.5, 3, 4, 5], lambda v, s: base(s, blur=v)),
        "noise, grey levels": ([0, 10, 20, 25, 35, 50, 70], lambda v, s: base(s, noise=v)),
        "exposure": ([0.05, 0.1, 0.2, 0.5, 1, 2.5, 6, 10], lambda v, s: base(s, exposure=v)),
        "vignetting": ([1, 1.5, 2.6, 4, 6, 8, 10], lambda v, s: base(s, vignetting=v, light=0.0)),
        "cell, px": (
            [6, 7, 8, 10, 12, 15, 20, 30, 45, 60],
            lambda v, s: base(s, max(3, min(100, round(0.92 * 480 / v) - 1))),
        ),
        "severity": (
            [0, 0.5, 1, 1.25, 1.5, 1.75, 2],
            lambda v, s: random_scene(s, markers=MARKERS, severity=v),
        ),
        "corrosion": ([0, 1, 1.5, 2, 2.5, 3], lambda v, s: base(s, corrosion=v, severity=1.0)),
    }


def breaking(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield missed, false and RMSE of every method at every level."""
    names = [name for name in available() if name in SHOWN]
    levels = [(what, v, make) for what, (values, make) in sweeps().items() for v in values]
    for what, level, make in levels[::3] if arguments.quick else levels:
        frames = []
        for k in range(1 if arguments.quick else 3):
            try:
                frames.append(rendered(make(level, SEED + k)))
            except ConfigError as error:  # a surface that folds over cannot be rendered
                print(f"{what} {level}: {error}")
        if not frames:
            continue
        pattern = Pattern(frames[0].whole[0])
        density = min((20, 30, 40), key=lambda known: abs(known - pattern.markers))
        for method in methods.used(pattern, frames[0].image.shape, names, density):
            score = total(frame.score(method.detect(frame.image)) for frame in frames)
            yield {
                "difficulty": what,
                "level": level,
                "method": method.name,
                "corners": score.expected,
                "missed": score.missed,
                "false": score.false,
                "rmse": score.rmse,
            }


# single cases


def case(name: str, figure: float, expected: str) -> Row:
    return {"case": name, "figure": float(figure), "expected": expected}


def against_oracle(scenes: Sequence[Scene]) -> Iterator[Row]:
    """Yield the largest difference to the float64 oracle, by refinement."""
    configs = {"EDGE_STEP": DetectorConfig(), "EDGE_LINES": DetectorConfig(refinement=EdgeLines())}
    for name, config in configs.items():
        apart, other = [np.zeros(0)], 0
        for scene in scenes:
            image = rendered(scene).image
            seen = detect(image, config)
            expected, margin = reference.detect_with_margin(image, config)
            same = np.array_equal(seen.pixel, expected.pixel)
            other += not same
            if same:
                sure = (seen.method == expected.method) & (margin > CLOSE)
                apart.append(np.hypot(*(seen.xy.astype(float) - expected.xy.astype(float)).T)[sure])
        largest = float(np.concatenate(apart).max())
        yield case(f"{name}, float32 against float64: largest difference, px", largest, "< 0.01")
        yield case(f"{name}: frames with other corners than the oracle's", other, "0")


def blank() -> Iterator[Row]:
    """Yield the corners of images that have none."""
    draw = np.random.default_rng(SEED)
    for grey in (0, 128, 255):
        yield case(f"flat frame of {grey}", len(detect(np.full((480, 640), grey, np.uint8))), "0")
    for sd in (5, 15, 25):
        noise = draw.normal(128, sd, (480, 640)).clip(0, 255).astype(np.uint8)
        yield case(f"blank frame, noise of {sd}", len(detect(noise)), "0")
        soft = cv2.GaussianBlur(draw.normal(0, 1, (480, 640)), (0, 0), 2)
        soft = (128 + sd * soft / soft.std()).clip(0, 255).astype(np.uint8)
        yield case(f"blank frame, noise of {sd}, correlated over 2 px", len(detect(soft)), "< 3")


def numbering() -> Iterator[Row]:
    """Yield the time of numbering where corners or boards are most."""
    fine = drawn(plane(cell=6, middle=(0, 0), turn=17), (1200, 1600), blur=0, count=3).image
    squares = 60 + 130 * np.kron(np.indices((6, 6)).sum(axis=0) % 2, np.ones((10, 10)))
    boards = np.tile(np.pad(squares, (0, 15), constant_values=125), (20, 20))
    boards = cv2.GaussianBlur(boards, (0, 0), 0.8).astype(np.uint8)
    for name, image in {"cells of 6 px": fine, "400 boards": boards}.items():
        spent = []
        with Detector(shape=image.shape) as detector:
            count = len(detector(image))
            for _ in range(5):
                moments = [time.perf_counter()]
                for find in (detector, detector.grid):
                    with contextlib.suppress(GridError):
                        find(image)
                    moments.append(time.perf_counter())
                spent.append(np.diff(moments))
        alone, with_grid = np.median(spent[1:], axis=0)  # the first compiles
        yield case(f"{name}: numbering, us a corner", 1e6 * (with_grid - alone) / count, "")


def single(arguments: argparse.Namespace) -> Iterator[Row]:
    mixed = [
        random_scene(SEED + k, markers=MARKERS, severity=severity)
        for k in range(1 if arguments.quick else 3)
        for severity in (0.25, 1.0, 1.5)
    ]
    yield from (*blank(), *against_oracle(mixed), *numbering())


TABLES = {"stiff": single, "limits": breaking}
main = main_of(__doc__, TABLES, quick="few levels, two minutes")

if __name__ == "__main__":
    raise SystemExit(main())
