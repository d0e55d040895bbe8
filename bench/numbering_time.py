"""The time of numbering against that of the detection of the same frame, in turns.

    python bench/numbering_time.py --quick      a third of the rounds
    python bench/numbering_time.py              half a minute on two quiet cores

Numbering is `Detector.grid` less `Detector.__call__`. A row of results/numbering_time.csv is a kind
of frame: medians of wall time, and of processor time, which other programs disturb less.
"""

import argparse
import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from environment import run
from patterns import gels, torn, torn_otherwise

from cmp_cl import Detector, DetectorConfig
from cmp_cl.errors import GridError
from cmp_cl.image import GreyImage

SEED = 5_300_000
ROUNDS, GELS = 60, 6  # of each gel, and gels of each kind
FINE, ANGLE, SIZE = 6.0, 17.0, (1200, 1600)  # px, degrees, of the finest board
SMALL = 10  # px, cells of many boards


def frames() -> Iterator[tuple[str, GreyImage, float]]:
    """Yield kinds of frames, images, and sides of cells, px."""
    yield from (("whole gels", view.image, view.cell) for view in gels(SEED, GELS))
    for views in (torn(SEED, GELS), torn_otherwise(SEED, GELS)):
        yield from (("torn gels", view.image, view.cell) for view in views)
    yield "cells of 6 px", fine(), FINE
    yield "400 boards", many(), SMALL


def fine() -> GreyImage:
    """Return a board that fills an image, with noise."""
    y, x = (np.mgrid[: 3 * SIZE[0], : 3 * SIZE[1]] + 0.5) / 3
    along, across = np.cos(np.radians(ANGLE)), np.sin(np.radians(ANGLE))
    u, v = x * along + y * across, y * along - x * across
    bright = (np.floor(u / FINE) + np.floor(v / FINE)) % 2
    level = bright.reshape(SIZE[0], 3, SIZE[1], 3).mean(axis=(1, 3)) * 130 + 60
    level += np.random.default_rng(SEED).normal(0, 2, SIZE)
    return level.clip(0, 255).astype(np.uint8)


def many() -> GreyImage:
    """Return 400 boards of 25 corners on grey."""
    colours = np.kron(np.indices((6, 6)).sum(axis=0) % 2, np.ones((SMALL, SMALL)))
    image = np.tile(np.pad(60 + 130 * colours, (0, 15), constant_values=125), (20, 20))
    return cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.uint8)


def spent(call: Callable[[], object]) -> tuple[float, float]:
    """Return the milliseconds of a call: wall time, and processor time of all threads."""
    wall, processor = time.perf_counter(), time.process_time()
    call()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - processor)


def times(image: GreyImage, cell: float, rounds: int) -> dict[str, float]:
    """Return corners and parts of a frame, and the times of its detection and its numbering."""
    with Detector(shape=image.shape, config=DetectorConfig.for_cell(cell)) as detector:

        def number() -> None:
            with contextlib.suppress(GridError):
                detector.grid(image)

        for _ in range(2):  # the first calls compile
            count = len(detector(image))
            number()
        found = [(spent(lambda: detector(image)), spent(number)) for _ in range(rounds)]
    detected, numbered = np.median(found, axis=0)
    wall, processor = (numbered - detected).tolist()
    return {
        "corners": count,
        "detection": float(detected[0]),
        "numbering": wall,
        "processor_detection": float(detected[1]),
        "processor_numbering": processor,
    }


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    kinds: dict[str, list[dict[str, float]]] = {}
    for kind, image, cell in frames():
        rounds = ROUNDS if "gels" in kind else 4
        found = times(image, cell, max(rounds // (3 if arguments.quick else 1), 3))
        kinds.setdefault(kind, []).append(found)
    gel = 0.0
    for kind, found in kinds.items():
        row = {name: float(np.median([each[name] for each in found])) for name in found[0]}
        for name, one, other in (
            ("ratio", "numbering", "detection"),
            ("processor_ratio", "processor_numbering", "processor_detection"),
        ):
            ratios = [each[one] / each[other] for each in found]
            row[name], row[f"{name}_worst"] = float(np.median(ratios)), max(ratios)
        own = row["processor_numbering"] / row["corners"]
        gel = gel or own
        row["per_corner_of_gel"] = own / gel
        yield {"kind": kind, "frames": len(found), **row}


def main(argv: Sequence[str] | None = None) -> int:
    return run(__doc__, {"numbering_time": rows}, argv, quick="a third of the rounds")


if __name__ == "__main__":
    raise SystemExit(main())
