"""How the part of sigma that the whole frame has was chosen, on boards of our own.

    python bench/fit_sigma.py [BOARDS]      prints a table; a minute for 4 boards of each kind

A row is three constants, see `_grown` in cmp_cl/stages/refine.py. A column is the share of the
errors within two sigma, %, on boards as drawn, compressed, blurred, in coarse noise, or enlarged by
repeating pixels. No photograph and no rendered scene is among them.
"""

import itertools
import math
import sys

import boards
import numpy as np
from boards import board, photographed

from cmp_cl import Detector
from cmp_cl.stages import refine
from cmp_cl.synthetic.scoring import match

FIRST_SEED = 920_000
ENLARGED = {"x2": 2, "x3": 3, "x4": 4}
KINDS = ("drawn", *ENLARGED, "JPEG", "coarse noise", "blur")
RANGES = (0.0015, 0.0025)
VARIANCES = (1000, 3000)
GRAINS = (0, 1.5, 2.2, 3)
NAMES = ("LEAST_RANGE", "VARIANCE_OF_RANGE", "VARIANCE_OF_GRAIN")


def drawn(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the image of a board, its corners, and the side of a cell, px."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    times = ENLARGED.get(kind, 1)
    boards.SHAPE = (240, 320) if times > 1 else (480, 640)
    least, most = (14, 40) if times > 1 else (12, 80)
    cell = math.exp(rng.uniform(math.log(least), math.log(most)))
    reflectance, truth = board(
        cell,
        angle=rng.uniform(0, math.pi / 2),
        tilt=rng.uniform(-0.2, 0.2),
        blur=rng.uniform(1.2, max(1.3, min(6, cell / 5)))
        if kind == "blur"
        else rng.uniform(0.5, 1.2),
        start=(rng.random(), rng.random()),
    )
    coarse = kind == "coarse noise"
    image = photographed(
        reflectance,
        rng,
        noise=rng.choice([5, 10, 15] if coarse else [0.5, 2, 5, 12]),
        correlation=rng.choice([0.7, 1.5, 3]) if coarse else 0,
        quality=rng.choice([85, 60, 30]) if kind == "JPEG" else None,
    )
    image = np.ascontiguousarray(image.repeat(times, axis=0).repeat(times, axis=1))
    return image, truth * times + (times - 1) / 2, cell * times


def main() -> None:
    count = int(sys.argv[1]) if sys.argv[1:] else 25
    rows = list(itertools.product(RANGES, VARIANCES, GRAINS))
    shares: dict[str, list[np.ndarray]] = {kind: [] for kind in KINDS}
    detectors: dict[tuple[int, ...], Detector] = {}
    for seed, kind in itertools.product(range(FIRST_SEED, FIRST_SEED + count), KINDS):
        image, truth, cell = drawn(kind, seed)
        if image.shape not in detectors:
            detectors[image.shape] = Detector(shape=image.shape)
        within = []
        for constants in rows:
            for name, value in zip(NAMES, constants, strict=True):
                setattr(refine, name, np.float32(value))
            found = detectors[image.shape](image)
            partner = match(found.xy, truth, max(3.0, 0.1 * cell))
            margin = max(12, 0.6 * cell)
            inside = (found.xy > margin) & (found.xy < np.subtract(image.shape[::-1], 1 + margin))
            good = (partner >= 0) & np.isfinite(found.sigma) & inside.all(axis=1)
            error = np.abs(found.xy[good] - truth[partner[good]])
            within.append(error < 2 * found.sigma[good, None])
        shares[kind].append(np.array(within).reshape(len(rows), -1))
    print(f"{'range  variance  grain':24}" + "".join(f"{kind:>14}" for kind in KINDS))
    for n, (least, variance, grain) in enumerate(rows):
        means = (100 * np.hstack(shares[kind])[n].mean() for kind in KINDS)
        print(
            f"{least:<6g} {variance:<9d} {grain:<7g}" + "".join(f"{mean:14.1f}" for mean in means)
        )


if __name__ == "__main__":
    main()
