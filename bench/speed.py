"""Wall time of cmp_cl and its peers in one run, each row's answer checked in that run.

    python bench/speed.py --quick       two scenes, the peers that matter, under two minutes
    python bench/speed.py               everything; writes results/speed.json

Methods take turns: in each round each method does a few frames in a row, of which the first
is not counted. The time is from an image in host memory to positions in host memory.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import methods
import numpy as np
from environment import environment, parser_of, write_result
from methods import DEFAULT, LINES, RINGS, Method
from peers import PEERS, Pattern, available, keep_freed_memory
from scenes import TEST_SEED, Frame, vga, wide

from cmp_cl import Detector, DetectorConfig
from cmp_cl.synthetic.scoring import total

QUICK_PEERS = (
    "good_features",
    "good_features_refined",
    "chess_corners_lean",
    "chess_corners_saddle",
    "chess_reference",
    "chess_opencl",
    "spectrum_opencl",
)
PACED_PEERS = ("good_features", "chess_corners_lean", "chess_opencl")  # the leanest
PACE = 0.01  # s from a frame to the next, as a camera gives them
PACED_FRAMES = 50  # of a method in a row
SCENES: dict[str, Callable[[int], Frame]] = {"vga": vga, "wide": wide}


def measure(
    rows_of: Sequence[Method], frames: Sequence[Frame], rounds: int, block: int = 8
) -> list[dict[str, Any]]:
    """Time the methods in turns, and score the very answers that were timed."""
    times: dict[str, list[float]] = {method.name: [] for method in rows_of}
    answers: dict[str, dict[int, np.ndarray]] = {method.name: {} for method in rows_of}
    for round_ in range(rounds):
        for method in rows_of:
            count = 1 if method.slow else block
            if method.slow and round_ >= max(3, rounds // 8):
                continue
            for k in range(count + 1):
                which = (round_ * count + k) % len(frames)
                start = time.perf_counter()
                xy = method.detect(frames[which].image)
                spent = time.perf_counter() - start
                if k or method.slow:
                    spent = getattr(method.detect, "seconds", spent)
                    times[method.name].append(spent * 1e3)
                    answers[method.name][which] = xy
    rows = []
    for method in rows_of:
        checked = answers[method.name].items()
        answer = total(frames[which].score(xy) for which, xy in checked)
        spent = np.array(times[method.name])
        rows.append(
            {
                "method": method.name,
                "settings": method.settings,
                "ms": float(np.median(spent)),
                "ms_p95": float(np.percentile(spent, 95)),
                "ms_least": float(spent.min()),
                "samples": len(spent),
                **answer.summary(),
            }
        )
    return rows


def paced(rows_of: Sequence[Method], frames: Sequence[Frame], rounds: int) -> list[dict[str, Any]]:
    """Time the methods on frames that come one every PACE seconds, and in a loop beside it.

    Between two frames the process sleeps: caches cool down and threads have to wake up.
    """
    pauses = {"paced": PACE, "loop": 0.0}
    times = {(method.name, how): [] for method in rows_of for how in pauses}
    for _ in range(rounds):
        for method in rows_of:
            for how, pause in pauses.items():
                due = time.perf_counter()
                for k in range(PACED_FRAMES + 1):
                    image = frames[k % len(frames)].image
                    time.sleep(max(0.0, due - time.perf_counter()))
                    start = time.perf_counter()
                    method.detect(image)
                    spent = time.perf_counter() - start
                    due = max(due + pause, start)
                    if k:
                        times[method.name, how].append(spent * 1e3)
    rows = []
    for method in rows_of:
        spaced, loop = (np.array(times[method.name, how]) for how in pauses)
        rows.append(
            {
                "method": method.name,
                "ms": float(np.median(spaced)),
                "ms_p99": float(np.percentile(spaced, 99)),
                "loop_ms": float(np.median(loop)),
                "loop_ms_p99": float(np.percentile(loop, 99)),
                "times_loop": float(np.median(spaced) / np.median(loop)),
                "samples": len(spaced),
            }
        )
    return rows


def stages(config: DetectorConfig, frame: Frame) -> dict[str, Any]:
    """Return the median ms of each kernel, of all of them, and of the host and transfers around
    them."""
    with Detector(shape=frame.image.shape, config=config, profile=True) as detector:
        walls, kernels = [], []
        for _ in range(40):
            start = time.perf_counter()
            detector(frame.image)
            walls.append((time.perf_counter() - start) * 1e3)
            kernels.append(detector.times)
        memory = detector.memory
    middle = {
        name: float(np.median([spent.get(name, 0.0) for spent in kernels[5:]]))
        for name in kernels[-1]
    }
    busy = float(np.median([sum(spent.values()) for spent in kernels[5:]]))
    wall = float(np.median(walls[5:]))
    return {
        "stages": middle,
        "kernels": busy,
        "host_and_transfers": wall - busy,
        "wall_profiled": wall,
        "bytes_per_pixel": memory / frame.image.size,
    }


def compare(
    scene: str, names: Sequence[str], own: Sequence[str] | None, count: int, rounds: int
) -> dict[str, Any]:
    """Time one class of scenes: our rows and the peers' in turns, ratios to our default."""
    frames = [SCENES[scene](TEST_SEED + k) for k in range(count)]
    first = frames[0]
    cell = 0.92 * 480 / 45 if scene == "vga" else 0.92 * 800 / 41  # at rest
    configs = methods.configs(first.markers, cell)
    kept = {name: configs[name] for name in (own or configs)}
    rows_of = [methods.own(name, config, first.image.shape) for name, config in kept.items()]
    if first.views == 1:
        rows_of += [
            methods.own_with_grid(f"{name} + grid", configs[name], first)
            for name in (DEFAULT, LINES)
        ]
    pattern = Pattern(first.markers, first.views)
    peers = {name: methods.peer(name, pattern) for name in names}
    rows_of += peers.values()
    rows = measure(rows_of, frames, rounds)
    lean = [row for row in rows_of if row.name in (DEFAULT, LINES)]
    lean += [row for name, row in peers.items() if name in PACED_PEERS]
    base = next(row["ms"] for row in rows if row["method"] == DEFAULT)
    for row in rows:
        row["times_default"] = row["ms"] / base
        if row["method"] in kept:
            row |= stages(kept[row["method"]], first)
    return {
        "scene": scene,
        "shape": list(first.image.shape),
        "corners": len(first.truth),
        "cell": first.cell,
        "seeds": [TEST_SEED + k for k in range(count)],
        "rows": rows,
        "pace_ms": PACE * 1e3,
        "paced": paced(lean, frames, max(2, rounds // 5)),
    }


def show(result: dict[str, Any]) -> None:
    """Print a scene class as a table."""
    print(
        f"\n{result['scene']}: {result['shape'][1]} x {result['shape'][0]}, "
        f"{result['corners']} corners, cells of {result['cell']:.1f} px"
    )
    print(f"{'method':38}{'ms':>8}{'p95':>8}{'times':>7}{'missed':>8}{'false':>7}{'rmse':>7}")
    for row in result["rows"]:
        rmse = "-" if row["rmse"] is None else f"{row['rmse']:.3f}"
        print(
            f"{row['method']:38}{row['ms']:8.2f}{row['ms_p95']:8.2f}{row['times_default']:7.2f}"
            f"{row['missed']:8}{row['false']:7}{rmse:>7}"
        )
    print(f"one frame every {result['pace_ms']:g} ms: ms, 99 %, and times those of the loop")
    for row in result["paced"]:
        print(
            f"{row['method']:38}{row['ms']:8.2f}{row['ms_p99']:8.2f}{row['times_loop']:7.2f}"
            f"   loop {row['loop_ms']:.2f}, 99 % {row['loop_ms_p99']:.2f}"
        )
    for row in result["rows"]:
        if row["method"] == DEFAULT:
            print(
                f"default, profiled: {row['wall_profiled']:.2f} ms = kernels {row['kernels']:.2f} "
                f"+ host and transfers {row['host_and_transfers']:.2f}; "
                f"{row['bytes_per_pixel']:.1f} bytes a pixel on the device"
            )
            longest = sorted(row["stages"].items(), key=lambda stage: -stage[1])
            print("  " + ", ".join(f"{name} {ms:.3f}" for name, ms in longest))


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="under two minutes")
    parser.add_argument("--scene", choices=list(SCENES), help="only this one")
    parser.add_argument("--rounds", type=int, help="turns of each method")
    arguments = parser.parse_args(argv)

    found, reasons = available()
    for name, reason in reasons.items():
        print(f"left out: {PEERS[name].label}: {reason}")
    names = [name for name in found if not arguments.quick or name in QUICK_PEERS]
    own = [DEFAULT, LINES, RINGS] if arguments.quick else None
    count, rounds = (2, 8) if arguments.quick else (4, 30)
    rounds = arguments.rounds or rounds
    keep_freed_memory()
    around = environment()
    print(f"{around['device']}, driver {around['driver']}, commit {around['commit']}")
    print(f"cores at other work: {around['others']}")
    results = []
    for scene in [arguments.scene] if arguments.scene else list(SCENES):
        results.append(compare(scene, names, own, count, rounds))
        show(results[-1])
    whole = {"kind": "speed", "environment": around, "unavailable": reasons, "scenes": results}
    write_result(whole, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
