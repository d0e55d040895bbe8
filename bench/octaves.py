"""What the octaves find: spread ink, noise, every cell and blur, blank frames, photographs.

    python bench/octaves.py             about eight minutes

A row of results/octaves.csv is a set of images with one of two settings: the default, and
`octaves=0`. covered: the share of the coordinates of corners from halved frames whose error is
within two sigma; the ink of half of these boards has spread. said: the share of blank frames
whose corners `Corners.advice` says to be noise.
"""

import argparse
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import boards
import numpy as np
from boards import board, photographed, view
from environment import DATA, run
from photographs import folder, small_boards
from scenes import View

from cmp_cl import DetectorConfig, RingHarmonic, detect
from cmp_cl.synthetic.scoring import match, total

FIRST_SEED = 800_000
DRAWN, COVERED = 400, 60  # boards
INK_CELLS = (12, 25, 50, 100)  # px
SETTINGS = {
    "octaves=3": DetectorConfig(),
    "octaves=0": DetectorConfig(detection=RingHarmonic(octaves=0)),
}
CELLS = (8, 12, 20, 40, 80, 140, 200)
BLURS = (0.4, 1, 2, 4, 8)
CORRELATIONS = (0, 0.7, 1, 1.5, 2, 3, 5)


def spread_ink() -> Iterator[tuple[str, list[View]]]:
    """Yield boards of each cell whose black squares have grown or shrunk by up to 10 % of it."""
    for cell in INK_CELLS:
        group = []
        for seed, percent in enumerate((-10, -7, -5, -3, 0, 3, 5, 7, 10), FIRST_SEED):
            rng = np.random.default_rng(seed)
            ink, angle = cell * percent / 100, rng.uniform(0, 1.5)
            reflectance, truth = board(cell, angle=angle, ink=ink, start=(0.3, 0.2))
            group.append(view(photographed(reflectance, rng, noise=2), truth, cell))
        yield f"spread ink, cells of {cell} px", group


def noisy(count: int) -> Iterator[tuple[str, list[View]]]:
    """Yield drawn boards, those with strong noise first."""
    drawn = [boards.drawn(FIRST_SEED + n) for n in range(count)]
    wide = [each for each, strong in drawn if "noise, wide" in strong]
    small = [each for each, strong in drawn if "noise" in strong and each.cell < 40]
    yield "drawn, noisy, cells from 40 px", wide
    yield "drawn, noisy, cells under 40 px", small
    yield "drawn", [each for each, _ in drawn]


def judged(group: Sequence[View], config: DetectorConfig) -> dict[str, Any]:
    """Return the counts of a group of images."""
    whole = total(each.score(detect(each.image, config).xy) for each in group)
    counts = {"corners": whole.expected, "missed": whole.missed, "false": whole.false}
    return {"images": len(group), **counts}


def every_cell_and_blur() -> dict[str, Any]:
    """Return by how many of the corners the default is behind the best `for_cell`, at most."""
    configs = [DetectorConfig.for_cell(cell) for cell in (8, 15, 30)]
    behind: dict[str, float] = {}
    for cell, blur in itertools.product(CELLS, BLURS):
        if blur > cell / 3:
            continue
        rng = np.random.default_rng(FIRST_SEED + cell)
        reflectance, truth = board(cell, angle=0.3, blur=blur)
        each = view(photographed(reflectance, rng, noise=3), truth, cell)
        ours = each.score(detect(each.image).xy)
        best = min(each.score(detect(each.image, config).xy).missed for config in configs)
        share = 100 * (ours.missed - best) / ours.expected
        behind[f"cells of {cell} px, blur {blur} px"] = share
    worst = max(behind, key=behind.__getitem__)
    return {"set": "every cell and blur", "behind_percent": behind[worst], "worst": worst}


def blank(correlation: float, config: DetectorConfig) -> dict[str, Any]:
    """Return the corners a megapixel in grey frames with noise of 8 grey levels."""
    counts, said = [], []
    for seed in range(FIRST_SEED, FIRST_SEED + 3):
        rng = np.random.default_rng(seed)
        image = photographed(np.full(boards.SHAPE, 0.5), rng, noise=8, correlation=correlation)
        found = detect(image, config)
        counts.append(len(found))
        said.append("noise" in found.advice(image))
    false = float(np.mean(counts)) / math.prod(boards.SHAPE) * 1e6
    name = f"blank, noise smoothed by {correlation} px"
    return {"set": name, "false_a_megapixel": false, "said": float(np.mean(said))}


def covered() -> dict[str, Any]:
    """Return how many errors two sigma cover, of corners that halved frames found."""
    within = []
    for seed in range(FIRST_SEED, FIRST_SEED + COVERED):
        rng = np.random.default_rng(seed)
        cell, angle = rng.uniform(40, 160), rng.uniform(0, 1.5)
        blur = rng.uniform(cell / 12, cell / 6)
        reflectance, truth = board(cell, angle=angle, blur=blur, ink=cell * rng.choice([0, 0.05]))
        noise, correlation = rng.choice([1, 4, 8]), rng.choice([0, 1])
        image = photographed(reflectance, rng, noise=noise, correlation=correlation)
        found = detect(image)
        partner = match(found.xy, truth, 0.1 * cell)
        good = (partner >= 0) & (found.octave > 0) & np.isfinite(found.sigma)
        error = np.abs(found.xy[good] - truth[partner[good]])
        within.append(error < 2 * found.sigma[good, None])
    return {"set": "sigma in octaves", "covered": float(np.concatenate(within).mean())}


def groups() -> Iterator[tuple[str, list[View]]]:
    """Yield all images of which the corners are counted."""
    yield from spread_ink()
    yield from noisy(DRAWN)
    if DATA.is_dir():
        for path in sorted(DATA.glob("*/")):
            yield path.name, folder(path.name)
        yield "small boards before photographs", small_boards()


def rows(_: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for name, group in groups():
        for setting, config in SETTINGS.items():
            yield {"settings": setting, "set": name, **judged(group, config)}
    for correlation, (setting, config) in itertools.product(CORRELATIONS, SETTINGS.items()):
        yield {"settings": setting, **blank(correlation, config)}
    yield {"settings": "octaves=3", **covered()}
    yield {"settings": "octaves=3", **every_cell_and_blur()}


def main(argv: Sequence[str] | None = None) -> int:
    return run(__doc__, {"octaves": rows}, argv)


if __name__ == "__main__":
    raise SystemExit(main())
