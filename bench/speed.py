"""Wall time of ours and the peers in one run, the timed answers scored.

    python bench/speed.py --quick       the peers that matter, a minute
    python bench/speed.py               everything, about three minutes

Methods take turns: in each round each one does a few frames in a row, of which the first is not
counted. The time is from an image in host memory to positions in host memory. A row of
results/speed.csv is a method on one class of frames; the last ones are our default with many
frames at once, whose time is that of a frame.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import methods
import numpy as np
from environment import main_of
from peers import Pattern, available
from scenes import TEST_SEED, View, vga, wide

from cmp_cl import Corners, Detector
from cmp_cl.synthetic.scoring import Score, total

SCENES: dict[str, Callable[[int], View]] = {"vga": vga, "wide": wide}
SHORT = ("good_features", "chess_corners_saddle", "chess_opencl", "spectrum_opencl")
BLOCK = 8  # frames of a turn
MANY = 16  # frames in a stream, and in a batch


def measure(
    used: Sequence[methods.Method], frames: Sequence[View], rounds: int
) -> list[dict[str, Any]]:
    """Time the methods in turns, and score the very answers that were timed."""
    times: dict[str, list[float]] = {method.name: [] for method in used}
    answers: dict[str, dict[int, np.ndarray]] = {method.name: {} for method in used}
    for number in range(rounds):
        for method in used:
            if method.slow and number >= max(3, rounds // 8):
                continue
            block = 1 if method.slow else BLOCK
            for k in range(block + 1):
                which = (number * block + k) % len(frames)
                xy, ms = method.timed(frames[which].image)
                if k or method.slow:
                    times[method.name].append(ms)
                    answers[method.name][which] = xy
    return [
        row_of(
            method.name,
            times[method.name],
            total(frames[which].score(xy) for which, xy in answers[method.name].items()),
        )
        for method in used
    ]


def many(frames: Sequence[View], rounds: int) -> Iterator[dict[str, Any]]:
    """Time our default on many frames at once: what a frame takes then."""
    film = [frames[k % len(frames)] for k in range(MANY)]
    images = [frame.image for frame in film]
    stack = np.stack(images)
    with Detector(shape=images[0].shape) as detector:
        ways: dict[str, Callable[[], list[Corners]]] = {
            "stream": lambda: list(detector.stream(images)),
            f"batches of {MANY}": lambda: detector.batch(stack),
        }
        for name, call in ways.items():
            spent = []
            for _ in range(rounds):
                start = time.perf_counter()
                found = call()
                spent.append(1e3 * (time.perf_counter() - start) / MANY)
            score = total(f.score(each.xy) for f, each in zip(film, found, strict=True))
            yield row_of(f"{methods.DEFAULT}, {name}", spent[1:], score)


def row_of(name: str, spent: Sequence[float], score: Score) -> dict[str, Any]:
    return {
        "method": name,
        "ms": float(np.median(spent)),
        "ms_p95": float(np.percentile(spent, 95)),
        "corners": score.expected // score.frames,
        "missed": score.missed,
        "false": score.false,
        "rmse": score.rmse,
    }


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    names = [name for name in available() if not arguments.quick or name in SHORT]
    count, rounds = (2, 8) if arguments.quick else (4, 12)
    for scene, draw in SCENES.items():
        frames = [draw(TEST_SEED + k) for k in range(count)]
        pattern = Pattern(frames[0].whole[0], frames[0].pictures)
        used = methods.used(pattern, frames[0].image.shape, names)
        for row in [*measure(used, frames, rounds), *many(frames, rounds)]:
            yield {"scene": scene, **row}


main = main_of(__doc__, {"speed": rows}, quick="a minute")

if __name__ == "__main__":
    raise SystemExit(main())
