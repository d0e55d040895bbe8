"""What each constant of the octaves, and of sigma, trades: it is varied alone, on drawn boards.

    python bench/fit.py octaves|sigma [BOARDS]      prints a table; up to 40 s a board

No photograph and no rendered scene is among the boards, and none of another bench.
octaves: the oracle decides about its maxima, on boards of `boards.drawn`. Missed and false are
shares of a board's corners, at most all of them, %, and means over the boards.
sigma: the oracle's share of the errors within two sigma, %, and the median sigma over the errors'
RMS, on boards as drawn, enlarged by repeating pixels, compressed, in coarse noise, blurred, or
whose ink has spread; see kernels/residual.cl.
"""

import itertools
import math
import sys
from collections import defaultdict
from collections.abc import Iterator
from unittest import mock

import boards
import numpy as np
from boards import board, drawn, photographed

from cmp_cl import DetectorConfig, RingHarmonic, reference
from cmp_cl.image import GreyImage
from cmp_cl.reference import edge_step, harmonic
from cmp_cl.synthetic.scoring import match

FIRST_SEED = 700_000
RADIUS = 3  # px, of suppression
OCTAVES: dict[str, tuple[float, ...]] = {  # of the oracle; `relative` is the rule's
    "relative": (0.1875, 0.125, 0.16, 0.22, 0.25),  # the first is the default
    "OCTAVE_WIDE": (1, 2, 8, 10**6),
    "OCTAVE_SHARE": (16, 24, 32, 40, 56, 72, 80),
    "OCTAVE_APART": (2, 3, 4, 6, 8),
    "STRONG": (1, 1.25, 1.75, 2),
    "NEIGHBOURS": (20, 24, 28, 40),
    "OUTDONE": (1, 1.5, 4, 10**6),
    "SEEN": (0.5, 2.5),
    "ASKEW": (1.5, 1.75, 2.25, 2.5, 3),
    "CONFIRMED": (0, 2, 4, 8, 12),
    "NEEDED": (8, 12, 14, 18, 20),
    "SPARED": (12, 16, 24, 28),
}
SIGMA = {
    "VARIANCE_OF_ODD": (1000, 0, 500, 700, 1400, 2000),  # the first is the default
    "VARIANCE_OF_GRAIN": (0, 1, 1.5, 3),
    "MOST_OFF": (0, 0.5),
    "ODD_Y": (0, 0.6, 2),
    "LEAST_NOISE": (0.1, 0.25, 1),
}
ENLARGED = {"x2": 2, "x3": 3, "x4": 4, "x6": 6}
KINDS = ("drawn", *ENLARGED, "JPEG", "coarse noise", "blur", "spread ink")
Judged = Iterator[tuple[str, str, tuple[float, ...]]]  # constant and value, kind of board, figures


def rows(constants: dict[str, tuple[float, ...]]) -> list[tuple[str, float]]:
    return [(name, value) for name, values in constants.items() for value in values]


def places(image: GreyImage, layers: list[harmonic.Layer], name: str, value: float) -> np.ndarray:
    """Return the corners (N, 2), px, that the oracle finds before refinement, with that value."""
    rule = RingHarmonic(relative=value) if name == "relative" else RingHarmonic()
    constants = {} if name == "relative" else {name: value}
    with mock.patch.multiple(harmonic, layers_of=lambda *_: iter(layers), **constants):
        found = harmonic.corners(image, rule, RADIUS, 255, np.ones(image.shape, np.bool_))
    return (np.stack([found.x, found.y], axis=1) + 0.5) * 2.0 ** found.halvings[:, None] - 0.5


def octaves(count: int) -> Judged:
    """Yield missed and false of each board."""
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        view, kinds = drawn(seed)
        mask = np.ones(view.image.shape, np.bool_)
        layers = list(harmonic.layers_of(view.image, RingHarmonic(), RADIUS, 255, mask))
        for name, value in rows(OCTAVES):
            score = view.score(places(view.image, layers, name, value))
            if score.expected:
                shares = [min(100 * n / score.expected, 100) for n in (score.missed, score.false)]
                for kind in ("all", *kinds):
                    yield f"{name} {value:g}", kind, (shares[0], shares[1])


def of_kind(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the image of a board, its corners, and the side of a cell, px."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    times = ENLARGED.get(kind, 1)
    boards.SHAPE = (240, 320) if times > 1 else (480, 640)
    least, most = (14, 40) if times > 1 else (12, 80)
    cell = math.exp(rng.uniform(math.log(least), math.log(most)))
    soft = (1.2, max(1.3, min(6, cell / 5))) if kind == "blur" else (0.5, 1.2)
    reflectance, truth = board(
        cell,
        angle=rng.uniform(0, math.pi / 2),
        tilt=rng.uniform(-0.2, 0.2),
        blur=rng.uniform(*soft),
        ink=cell * rng.uniform(-0.1, 0.1) if kind == "spread ink" else 0.0,
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


def sigma(count: int) -> Judged:
    """Yield, of each board, the share of the errors within two sigma, and sigma over their RMS."""
    for seed, kind in itertools.product(range(FIRST_SEED, FIRST_SEED + count), KINDS):
        image, truth, cell = of_kind(kind, seed)
        margin = max(12, 0.6 * cell)
        for name, value in rows(SIGMA):
            with mock.patch.object(edge_step, name, value):
                found = reference.detect(image, DetectorConfig())
            partner = match(found.xy, truth, max(3.0, 0.1 * cell))
            inside = boards.inside(found.xy, image.shape, margin)
            good = (partner >= 0) & np.isfinite(found.sigma) & inside
            error = np.abs(found.xy[good] - truth[partner[good]])
            if len(error):
                within = error < 2 * found.sigma[good, None]
                ratio = np.median(found.sigma[good]) / np.sqrt(np.square(error).mean())
                yield f"{name} {value:g}", kind, (100 * within.mean(), ratio)


def main() -> None:
    fit, count = sys.argv[1], int(sys.argv[2]) if sys.argv[2:] else 25
    judged: dict[str, dict[str, list[tuple[float, ...]]]] = defaultdict(lambda: defaultdict(list))
    for row, kind, figures in {"octaves": octaves, "sigma": sigma}[fit](count):
        judged[row][kind].append(figures)
    kinds = sorted({kind for row in judged.values() for kind in row})
    print(f"{count} boards of each kind")
    print(f"{'':24}" + "".join(f"{kind:>20}" for kind in kinds))
    for row, found in judged.items():
        means = [np.mean(found[kind], axis=0) for kind in kinds]
        texts = (" / ".join(f"{each:.2f}" for each in mean) for mean in means)
        print(f"{row:24}" + "".join(f"{text:>20}" for text in texts))


if __name__ == "__main__":
    main()
