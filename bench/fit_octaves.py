"""What each constant of the octaves trades: it is varied alone, on boards of our own.

    python bench/fit_octaves.py [BOARDS]        prints a table; some seconds a board

The oracle decides, with one of its constants changed. The boards are those of `boards.drawn`; no
photograph and no rendered scene is among them. Missed and false are means over the boards of shares
of a board's corners, at most all of them, so that a board of thousands counts like one of ten.
"""

import sys
from unittest import mock

import numpy as np
from boards import drawn

from cmp_cl import RingHarmonic
from cmp_cl.image import GreyImage
from cmp_cl.reference import harmonic

FIRST_SEED = 700_000
RADIUS = 3  # px, of suppression
KINDS = ("all", "spread ink", "noise, wide", "noise", "clutter", "cells under 20 px")
VARIED: dict[str, tuple[float, ...]] = {  # of the oracle; `relative` is the rule's
    "relative": (0.125, 0.16, 0.22, 0.25),
    "OCTAVE_WIDE": (1, 2, 8, 10**6),
    "OCTAVE_SHARE": (16, 24, 32, 40, 56, 72, 80),
    "OCTAVE_APART": (2, 3, 4, 6, 8),
    "STRONG": (1, 1.25, 1.75, 2),
    "NEIGHBOURS": (20, 24, 28, 40),
    "ALIGNED": (5, 6, 7, 10, 12),
    "SEEN": (0.5, 2.5),
}


def places(image: GreyImage, layers: list[harmonic.Layer], name: str, value: float) -> np.ndarray:
    """Return the corners (N, 2), px, that the oracle finds before refinement, with that value."""
    rule = RingHarmonic(relative=value) if name == "relative" else RingHarmonic()
    constants = {} if name == "relative" else {name: value}
    with mock.patch.multiple(harmonic, layers_of=lambda *_: iter(layers), **constants):
        found = harmonic.corners(image, rule, RADIUS, 255, np.ones(image.shape, np.bool_))
    return (np.stack([found.x, found.y], axis=1) + 0.5) * 2.0 ** found.halvings[:, None] - 0.5


def main() -> None:
    rows = [("relative", RingHarmonic().relative)]  # as it is
    rows += [(name, value) for name, values in VARIED.items() for value in values]
    count = int(sys.argv[1]) if sys.argv[1:] else 100
    judged: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        board, kinds = drawn(seed)
        mask = np.ones(board.image.shape, np.bool_)
        layers = list(harmonic.layers_of(board.image, RingHarmonic(), RADIUS, 255, mask))
        for row, (name, value) in enumerate(rows):
            score = board.score(places(board.image, layers, name, value))
            if score.expected:
                share = score.missed / score.expected, min(score.false / score.expected, 1)
                for kind in ("all", *kinds):
                    judged.setdefault((row, kind), []).append(share)
    print(f"{count} boards; missed / false, % of a board's corners")
    print(f"{'':24}" + "".join(f"{kind:>20}" for kind in KINDS))
    for row, (name, value) in enumerate(rows):
        shares = [np.mean(judged.get((row, kind), [(np.nan,) * 2]), axis=0) for kind in KINDS]
        what = f"{name} {value:g}" if row else "as it is"
        print(f"{what:24}" + "".join(f"{100 * a:12.2f} / {100 * b:5.2f}" for a, b in shares))


if __name__ == "__main__":
    main()
