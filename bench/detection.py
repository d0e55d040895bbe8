"""Which corners are found, how accurately and how fast, on rendered gels; ours and peers in turns.

    python bench/detection.py --quick   30 scenes, no slow peers, about two minutes
    python bench/detection.py           360 scenes, about seven minutes on two quiet cores

A frame is right if no corner is missed and none is false. A row of results/detection.csv is a
method on the scenes of one density, severity and object: all motions, or one of them in turn for
findChessboardCorners, which takes seconds where it finds no board.
"""

import argparse
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import methods
import numpy as np
from environment import main_of
from peers import PEERS, Pattern, available
from scenes import DENSITIES, INDENTERS, SEVERITIES, TEST_SEED, rendered

from cmp_cl.synthetic import Mode, Scene, random_scene
from cmp_cl.synthetic.scoring import Score, total

REPEATS = 3  # scenes of each object and severity, of which FEWER sees one
FEWER = PEERS["find_chessboard"].label


def scenes(markers: int, severities: Sequence[float], repeats: int) -> Iterator[list[Scene]]:
    """Yield the scenes of one density: `repeats` of each object at each severity."""
    modes = list(Mode)
    seed = TEST_SEED + 10_000 * markers
    for severity, indenter in itertools.product(severities, INDENTERS):
        some = []
        for k in range(repeats):
            seed += 1
            mode = modes[k % len(modes)] if repeats >= len(modes) else None
            some.append(
                random_scene(seed, markers=markers, severity=severity, indenter=indenter, mode=mode)
            )
        yield some


def figures(scores: Sequence[Score], spent: Sequence[float]) -> dict[str, Any]:
    """Return the counts, errors (px) and times (ms) of some frames as columns."""
    whole = total(scores)
    return {
        "frames": whole.frames,
        "right": whole.success,
        "corners": whole.expected,
        "missed": whole.missed,
        "false": whole.false,
        "found": whole.found,
        "squares": float(np.sum(whole.errors**2)),
        "ms": float(np.median(spent)),
    }


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    names = [name for name in available() if not (arguments.quick and PEERS[name].slow)]
    severities = (0.5, 1.0) if arguments.quick else SEVERITIES
    densities = DENSITIES[:3] if arguments.quick else DENSITIES
    repeats = 1 if arguments.quick else REPEATS
    for markers in densities:
        pattern = Pattern(markers)
        used: list[methods.Method] = []
        for number, some in enumerate(scenes(markers, severities, repeats)):
            frames = [rendered(scene) for scene in some]
            if not used:
                used = methods.used(pattern, frames[0].image.shape, names)
                for method in used:  # some compile or allocate only now
                    method.detect(frames[0].image)
            for method in used:
                seen = [frames[number % repeats]] if method.name == FEWER else frames
                found, spent = zip(*(method.timed(frame.image) for frame in seen), strict=True)
                scores = [frame.score(xy) for frame, xy in zip(seen, found, strict=True)]
                yield {
                    "method": method.name,
                    "markers": markers,
                    "severity": some[0].severity,
                    "indenter": some[0].indenter.value,
                    **figures(scores, spent),
                }


main = main_of(__doc__, {"detection": rows}, quick="30 scenes, no slow peers")

if __name__ == "__main__":
    raise SystemExit(main())
