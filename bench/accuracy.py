"""Measures missed and false corners and position errors, by object, density and severity.

    python bench/accuracy.py --quick    30 scenes, about two minutes
    python bench/accuracy.py            360 scenes, about an hour; writes
                                        results/accuracy.json

Every method sees the same rendered frames. A frame fails if one corner is missed or one is
false. Times are those of the same calls, one frame at a time, after one warm-up call.
"""

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import methods
import numpy as np
from environment import environment, parser_of, write_result
from methods import DEFAULT, FILTERED, FOR_CELL, FULL, GRIDDED, LINES, Method
from peers import PEERS, Pattern, available
from scenes import TEST_SEED, Frame, rendered
from tqdm import tqdm

from cmp_cl.synthetic import Indenter, Mode, Scene, random_scene
from cmp_cl.synthetic.scoring import Score, match, reach, total

DENSITIES = (20, 30, 40, 44)
SEVERITIES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
INDENTERS = [kind for kind in Indenter if kind is not Indenter.NONE]
GRID_PEERS = (
    "chess_opencl",
    "spectrum_opencl",
    "chess_corners_lean",
    "chess_corners_saddle",
    "mrgingham",
    "good_features_refined",
    "libcbdetect",
)


def scenes(markers: int, severities: Sequence[float], repeats: int) -> Iterator[Scene]:
    """Yield the scenes of one density: every object at every severity, `repeats` of each."""
    seed = TEST_SEED + 10_000 * markers
    for severity in severities:
        for indenter in INDENTERS:
            for k in range(repeats):
                seed += 1
                yield random_scene(
                    seed,
                    markers=markers,
                    severity=severity,
                    indenter=indenter,
                    mode=list(Mode)[k % len(Mode)] if repeats >= len(Mode) else None,
                )


def rows_of(markers: int, frame: Frame, names: Sequence[str]) -> list[Method]:
    """Run every method of the tables, for one density."""
    cell = 0.92 * min(frame.image.shape) / (markers + 1)  # at rest
    pattern = Pattern(markers)
    configs = methods.configs(markers, cell)
    rows = [methods.own(name, config, frame.image.shape) for name, config in configs.items()]
    rows.append(methods.own_with_grid(GRIDDED, configs[DEFAULT], frame))
    rows.append(methods.own_with_grid(FULL, configs[FOR_CELL], frame))
    rows.append(methods.own_with_grid(FILTERED, configs[DEFAULT], frame, filtered=True))
    rows += [methods.peer(name, pattern) for name in names]
    rows += [methods.peer_with_grid(name, pattern) for name in names if name in GRID_PEERS]
    return rows


class Tables:
    """Scores and times by method and group of scenes, and errors on corners found by both."""

    def __init__(self) -> None:
        self.scores: dict[tuple[str, str], list[Score]] = defaultdict(list)
        self.times: dict[tuple[str, str], list[float]] = defaultdict(list)
        self.both: dict[str, list[np.ndarray]] = defaultdict(list)
        self.settings: dict[str, dict[str, str]] = defaultdict(dict)

    def add(self, scene: Scene, frame: Frame, rows: Sequence[Method]) -> None:
        """Run every method on a frame."""
        errors: dict[str, np.ndarray] = {}
        for row in rows:
            start = time.perf_counter()
            xy = row.detect(frame.image)
            spent = (time.perf_counter() - start) * 1e3
            spent = getattr(row.detect, "seconds", spent / 1e3) * 1e3
            answer = frame.score(xy)
            for group in groups(scene):
                self.scores[row.name, group].append(answer)
                self.times[row.name, group].append(spent)
            self.settings[row.name][str(scene.markers)] = row.settings
            errors[row.name] = by_corner(xy, frame)
        for name, mine in errors.items():
            trio = np.stack([mine, errors[DEFAULT], errors[LINES]])
            self.both[name].append(trio[:, np.isfinite(trio).all(0)])

    def as_json(self) -> dict[str, Any]:
        rows = []
        for (name, group), scores in self.scores.items():
            spent = self.times[name, group]
            rows.append(
                {
                    "method": name,
                    "group": group,
                    "ms": float(np.median(spent)),
                    "ms_p95": float(np.percentile(spent, 95)),
                    **_kept(total(scores).summary()),
                }
            )
        common = {}
        for name, parts in self.both.items():
            trio = np.concatenate(parts, axis=1)
            if trio.shape[1]:
                own, step, lines = np.sqrt((trio**2).mean(1))
                common[name] = {
                    "corners": trio.shape[1],
                    "rmse": float(own),
                    "rmse_default": float(step),
                    "rmse_lines": float(lines),
                }
        columns = list(rows[0])
        body = [[_short(row[name]) for name in columns] for row in rows]
        return {"columns": columns, "rows": body, "common": common, "settings": self.settings}


def _kept(summary: dict[str, Any]) -> dict[str, Any]:
    """Remove the entries that follow from the counts."""
    return {name: summary[name] for name in summary if name not in ("recall", "precision")}


def _short(value: Any) -> Any:
    """Round floats to 5 digits: the tables have thousands of them."""
    return float(f"{value:.5g}") if isinstance(value, float) else value


def unpacked(result: dict[str, Any]) -> dict[str, Any]:
    """Return the same result with its rows as dicts."""
    columns = result["columns"]
    return result | {"rows": [dict(zip(columns, row, strict=True)) for row in result["rows"]]}


def groups(scene: Scene) -> list[str]:
    """Return the groups that a scene belongs to."""
    return [
        "all",
        f"markers {scene.markers}",
        f"severity {scene.severity:g}",
        f"object {scene.indenter.value}",
        f"mode {scene.mode.value}",
        f"markers {scene.markers}, severity {scene.severity:g}",
        f"markers {scene.markers}, object {scene.indenter.value}",
    ]


def by_corner(xy: np.ndarray, frame: Frame) -> np.ndarray:
    """Return the distance of the detection of each corner, (M,), px, NaN if it was missed."""
    partner = match(xy, frame.truth, reach(frame.cell))
    apart = np.full(len(frame.truth), np.nan)
    hit = partner >= 0
    apart[partner[hit]] = np.hypot(*(np.asarray(xy)[hit] - frame.truth[partner[hit]]).T)
    return apart


def show(result: dict[str, Any]) -> None:
    """Print success rates by severity, and the sums."""
    severities = [f"severity {severity:g}" for severity in result["severities"]]
    table = {(row["method"], row["group"]): row for row in result["rows"]}
    print(
        f"\nsuccess, % by severity; missed and false a frame; all {table[DEFAULT, 'all']['frames']}"
    )
    print(
        f"{'method':46}"
        + "".join(f"{s.split()[1]:>6}" for s in severities)
        + f"{'missed':>8}{'false':>8}{'rmse':>7}{'p95':>7}{'ms':>8}"
    )
    for name in dict.fromkeys(row["method"] for row in result["rows"]):
        rates = []
        for severity in severities:
            row = table[name, severity]
            rates.append(f"{100 * row['success'] / row['frames']:6.0f}")
        row = table[name, "all"]
        numbers = [row["missed"] / row["frames"], row["false"] / row["frames"]]
        rmse, p95 = row["rmse"] or float("nan"), row["p95"] or float("nan")
        print(
            f"{name:46}" + "".join(rates) + f"{numbers[0]:8.2f}{numbers[1]:8.2f}"
            f"{rmse:7.3f}{p95:7.3f}{row['ms']:8.2f}"
        )


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="30 scenes, few peers")
    parser.add_argument("--repeats", type=int, help="scenes of each object and severity")
    arguments = parser.parse_args(argv)
    found, reasons = available()
    for name, reason in reasons.items():
        print(f"left out: {PEERS[name].label}: {reason}")
    if arguments.quick:
        found = [name for name in found if not PEERS[name].slow]
    severities = (0.5, 1.0) if arguments.quick else SEVERITIES
    densities = DENSITIES[:3] if arguments.quick else DENSITIES
    repeats = arguments.repeats or (1 if arguments.quick else 3)

    around = environment()
    tables = Tables()
    count = len(densities) * len(severities) * len(INDENTERS) * repeats
    with tqdm(total=count, unit=" scenes") as progress:
        for markers in densities:
            rows: list[Method] = []
            for scene in scenes(markers, severities, repeats):
                frame = rendered(scene)
                if not rows:
                    rows = rows_of(markers, frame, found)
                    methods.warm(rows, frame.image)
                tables.add(scene, frame, rows)
                progress.update()
    result = {
        "kind": "accuracy",
        "environment": around,
        "unavailable": reasons,
        "densities": densities,
        "severities": severities,
        "repeats": repeats,
        "first_seed": TEST_SEED,
        **tables.as_json(),
    }
    show(unpacked(result))
    write_result(result, arguments.out, quick=arguments.quick, indent=None)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
