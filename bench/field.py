"""Fields against exact truth in space, numbering and its time, order of frames, and boards of
known squares.

    python bench/field.py --quick       two scenes and the boards, about a minute
    python bench/field.py               everything; writes results/field.json

Rendered pairs: both views of a 40 x 40 pattern, 32 mm wide, in one 1600 x 1200 frame, through
cameras that are known exactly. Errors are of the nodes, in micrometres. The photographs lie
in ../shared/data beside the repository and are not part of it.
"""

import contextlib
import dataclasses
import hashlib
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import DATA, environment, parser_of, write_result
from scenes import TEST_SEED

from cmp_cl import (
    BinocularSplit,
    Detector,
    DetectorConfig,
    Device,
    EdgeLines,
    Grid,
    NodeStatus,
    StereoRig,
    build_grid,
    calibrate,
    select_device,
)
from cmp_cl.cli.progress import Progress
from cmp_cl.field import DisplacementField
from cmp_cl.image import GreyImage
from cmp_cl.measure import (
    MAX_SIGMA,
    TwoViews,
    align_views,
    find_pattern,
    square_sides,
    trusted,
)
from cmp_cl.motion import filter_positions
from cmp_cl.points import sides
from cmp_cl.space import Calibration
from cmp_cl.synthetic import (
    Indenter,
    Mode,
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)

VIEW = (1200, 800)
MARKERS = 40
CELL = 17.5  # px, of such a view
SEVERITIES = (0.5, 1.0, 1.5)
OBJECTS = tuple(kind for kind in Indenter if kind is not Indenter.NONE)
FIRST_SEED = TEST_SEED + 500
CONFIGS = {
    "run (EDGE_STEP)": DetectorConfig.for_cell(CELL),
    "EDGE_LINES": DetectorConfig.for_cell(CELL).replace(refinement=EdgeLines()),
}


class Shot(NamedTuple):
    """A rendered pair. xyz: (N, N, 3), mm, in the frame of the left camera."""

    left: Rendered
    right: Rendered
    xyz: np.ndarray

    @property
    def frame(self) -> GreyImage:
        return binocular_frame(self.left, self.right)


def wrongly_numbered(grid: Grid, view: Rendered) -> int:
    """Count the nodes that are more than half a cell from their true position."""
    off = np.linalg.norm(grid.xy - view.truth, axis=2)
    return int(np.count_nonzero(off > 0.5 * view.cell))


def scene_of(seed: int, indenter: Indenter, mode: Mode, severity: float) -> Scene:
    """Return the press of that seed; what else a seed draws is the same for all its presses."""
    return random_scene(
        seed, markers=MARKERS, shape=VIEW, indenter=indenter, mode=mode, severity=severity
    )


def of_seed(
    seed: int, scenes: Sequence[Scene], device: Device, progress: Progress
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Measure every press of a seed with every configuration, and whether their order matters."""
    rig = StereoRig(*default_rig(VIEW))
    split = BinocularSplit.halves(2 * VIEW[1], VIEW[0])
    rest = Shot(*render_stereo(scenes[0].at_rest(), rig))
    rows: list[dict[str, Any]] = []
    frames, digests = [], []
    with contextlib.ExitStack() as stack:
        measures = {
            name: stack.enter_context(
                TwoViews(
                    rest.frame, rig, split, shape=(MARKERS, MARKERS), config=config, device=device
                )
            )
            for name, config in CONFIGS.items()
        }
        main = measures[next(iter(CONFIGS))]
        for scene in scenes:
            shot = Shot(*render_stereo(scene, rig))
            for name, measure in measures.items():
                rows.append({"config": name, "seed": seed, **answer(measure, scene, rest, shot)})
            frames.append(shot.frame)
            digests.append(digest(main(shot.frame).arrays))
            progress.step()
        order = np.random.default_rng(seed).permutation(len(frames)).tolist()
        same = sum(digest(main(frames[number]).arrays) == digests[number] for number in order)
    return rows, {"seed": seed, "order": order, "same_bytes": same}


def digest(arrays: dict[str, np.ndarray]) -> str:
    """Return a digest of everything that goes into a series for one frame."""
    whole = hashlib.sha256()
    for array in arrays.values():
        whole.update(array.tobytes())
    return whole.hexdigest()


def answer(measure: TwoViews, scene: Scene, rest: Shot, now: Shot) -> dict[str, Any]:
    """Return the accuracy of one frame: numbering, and squared errors in um2 for later means."""
    frame = now.frame
    start = time.perf_counter()
    found = measure(frame)
    ms = (time.perf_counter() - start) * 1e3
    left, right = found.grids
    wrong = wrongly_numbered(left, now.left) + wrongly_numbered(right, now.right)
    wrong += sum(
        wrongly_numbered(grid, view)
        for grid, view in zip(measure.rest_grids, (rest.left, rest.right), strict=True)
    )
    field, raw = found.field, found.field.raw
    truth = now.xyz - rest.xyz
    valid = field.valid
    place = np.linalg.norm(field.position + field.displacement - now.xyz, axis=2)[valid] * 1e3
    moved = np.linalg.norm(field.displacement - truth, axis=2)[valid] * 1e3
    raw_place = np.linalg.norm(found.points.xyz - now.xyz, axis=2)[valid] * 1e3
    raw_moved = np.linalg.norm(raw.displacement - truth, axis=2)[valid] * 1e3
    return {
        "object": scene.indenter.value,
        "mode": scene.mode.value,
        "severity": scene.severity,
        "wrong_index": wrong,
        "nodes": len(place),
        "interpolated": int(np.count_nonzero(found.points.source == NodeStatus.INTERPOLATED)),
        "place_um2": float(np.mean(place**2)),
        "place_p95_um": float(np.percentile(place, 95)),
        "moved_um2": float(np.mean(moved**2)),
        "moved_p95_um": float(np.percentile(moved, 95)),
        "raw_place_um2": float(np.mean(raw_place**2)),
        "raw_moved_um2": float(np.mean(raw_moved**2)),
        "within_2": within(field, truth),
        "raw_within_2": within(raw, truth),
        "ms": ms,
    }


def within(field: DisplacementField, truth: np.ndarray) -> float:
    """Return the share of errors within two standard deviations, along each node's own axes."""
    known = np.isfinite(field.covariance).all(axis=(2, 3)) & field.valid
    values, axes = np.linalg.eigh(field.covariance[known])
    off = np.einsum("nij,ni->nj", axes, (field.displacement - truth)[known])
    return float(np.mean(np.abs(off) <= 2 * np.sqrt(values.clip(0))))


def grouped(rows: Sequence[dict[str, Any]], *keys: str) -> list[dict[str, Any]]:
    """Return root mean squares, and shares of frames, over the rows that agree in those keys."""
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return [
        {
            **dict(zip(keys, values, strict=True)),
            "frames": len(group),
            "index_right": float(np.mean([row["wrong_index"] == 0 for row in group])),
            "nodes_placed": float(np.mean([row["nodes"] for row in group])) / MARKERS**2,
            "place_rms_um": float(np.sqrt(np.mean([row["place_um2"] for row in group]))),
            "moved_rms_um": float(np.sqrt(np.mean([row["moved_um2"] for row in group]))),
            "moved_p95_um": float(np.median([row["moved_p95_um"] for row in group])),
            **{
                f"{name}_rms_um": float(np.sqrt(np.mean([row[f"{name}_um2"] for row in group])))
                for name in ("raw_place", "raw_moved")
            },
            **{
                name: float(np.mean([row[name] for row in group]))
                for name in ("within_2", "raw_within_2")
            },
            "ms": float(np.median([row["ms"] for row in group])),
        }
        for values, group in groups.items()
    ]


# the time of the numbering

NUMBERED = 44  # corners a side, in 640 x 480
STREAMS = {"whole": (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), "torn": (0.6, 0.75, 0.9, 1.0)}  # severities


def numbering(device: Device, rounds: int) -> list[dict[str, Any]]:
    """Measure the time of `detector.grid` after the detection, in both forms, one frame after
    another.

    The frames of a press come in another order in every round. Those of the first stream show
    every corner to the detector, those of the second leave some to the second look.
    """
    scene = random_scene(
        FIRST_SEED, markers=NUMBERED, indenter=Indenter.TORUS, mode=Mode.TWIST, severity=1.0
    )
    config = DetectorConfig()
    shape = (NUMBERED, NUMBERED)
    rows: list[dict[str, Any]] = []
    with Detector(shape=scene.shape, config=config, device=device) as detector:
        rest = detector.grid(render(scene.at_rest()).image, shape=shape)[1]
        for stream, severities in STREAMS.items():
            shots = [render(dataclasses.replace(scene, severity=level)) for level in severities]
            frames = [(shot, detector(shot.image)) for shot in shots]
            for form in ("shape", "like"):
                wanted: dict[str, Any] = {"shape": shape} if form == "shape" else {"like": rest}
                draw = np.random.default_rng(0)
                spent, wrong = [], 0
                for turn in range(rounds + 1):  # the first is not counted
                    for number in draw.permutation(len(frames)).tolist():
                        shot, corners = frames[number]
                        start = time.perf_counter()
                        grid = build_grid(corners, shot.image, **wanted)
                        ms = (time.perf_counter() - start) * 1e3
                        if turn:
                            spent.append(ms)
                            wrong += wrongly_numbered(grid, shot)
                rows.append(
                    {
                        "stream": stream,
                        "severities": severities,
                        "form": form,
                        "frames": len(spent),
                        "corners": float(np.mean([len(corners) for _, corners in frames])),
                        "wrong_index": wrong,
                        "ms": float(np.median(spent)),
                        "ms_p95": float(np.percentile(spent, 95)),
                    }
                )
    return rows


# boards


def with_lines(config: Callable[[float], DetectorConfig]) -> Callable[[float], DetectorConfig]:
    return lambda cell: config(cell).replace(refinement=EdgeLines())


BOARD_CONFIGS: dict[str, Callable[[float], DetectorConfig]] = {
    "EDGE_LINES": with_lines(DetectorConfig.for_cell),
    "EDGE_STEP": DetectorConfig.for_cell,
}


def board(path: Path, shape: tuple[int, int], config: Callable[[float], DetectorConfig]) -> Grid:
    view = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    device = select_device()
    cell, _ = find_pattern(view, shape=shape, device=device)
    with Detector(shape=view.shape, config=config(cell), device=device) as detector:
        return detector.grid(view, shape=shape)[1]


def pairs(folder: Path, count: int, shape: tuple[int, int], config: Any) -> list[tuple[Grid, Grid]]:
    found = []
    for number in range(1, count + 1):
        left = board(folder / f"left{number:02}.jpg", shape, config)
        found.append(
            (left, align_views(left, board(folder / f"right{number:02}.jpg", shape, config)))
        )
    return found


def boards() -> list[dict[str, Any]]:
    """Measure squares with the published rig, and on boards that the calibration has not seen."""
    rows: list[dict[str, Any]] = []
    published = DATA / "stereo_bumblebee2"
    own = DATA / "stereo_opencv"
    for name, config in BOARD_CONFIGS.items():
        if published.is_dir():
            rig = published_rig(published / "stereo.yaml")
            views = pairs(published, 4, (6, 4), config)
            for kind, chosen in (("", views), (", filtered", [*map(lattice_filtered, views)])):
                sides = [square_sides(rig.triangulate(*pair)) for pair in chosen]
                row = {"set": "bumblebee2", "config": name + kind, "true": 30.0}
                rows.append(row | spread(sides))
        if own.is_dir():
            views = pairs(own, 5, (6, 9), config)
            rows.append({"set": "opencv", "config": name, "true": 25.0, **left_out(views)})
            if "STEP" in name:
                smooth = [lattice_filtered(pair) for pair in views]
                row = {"set": "opencv", "config": f"{name}, filtered", "true": 25.0}
                rows.append(row | left_out(smooth))
                row = {"set": "opencv", "config": f"{name}, filtered, free board", "true": 25.0}
                rows.append(row | left_out(smooth, free_board=True))
                sure = [
                    (trusted(left, MAX_SIGMA), trusted(right, MAX_SIGMA)) for left, right in views
                ]
                name = f"{name}, filtered, sigma <= {MAX_SIGMA:g} px"
                rows.append({"set": "opencv", "config": name, "true": 25.0, **left_out(sure)})
    return rows


def lattice_filtered(pair: tuple[Grid, Grid]) -> tuple[Grid, Grid]:
    left, right = (filter_positions(grid)[0] for grid in pair)
    return left, right


def left_out(views: Sequence[tuple[Grid, Grid]], *, free_board: bool = False) -> dict[str, Any]:
    """Measure each pair with the calibration of the others.

    With a free board each side is also compared with the same side of the board that the others
    found, whose sides are 25 mm long on average: `repeated` is the deviation from it, `board` that
    of its own sides.
    """
    lengths, off, boards = [], [], []
    for out, pair in enumerate(views):
        others = [view for place, view in enumerate(views) if place != out]
        found = calibrated(others, free_board=free_board)
        half_turn = 2 if pair[0].parity != others[0][0].parity else 0
        points = found.rig().triangulate(*(grid.turned(half_turn) for grid in pair))
        lengths.append(square_sides(points))
        if found.board is not None:
            boards.append(every_side(found.board))
            off.append(every_side(points.xyz) - boards[-1])
    error = calibrated(views, free_board=free_board).error
    row = {"calibration_error_px": error, **spread(lengths)}
    if free_board:
        row["repeated"], row["board"] = (float(np.nanstd(each)) for each in (off, boards))
    return row


def calibrated(views: Sequence[tuple[Grid, Grid]], *, free_board: bool) -> Calibration:
    left, right = zip(*views, strict=True)
    sizes = {"left": (640, 480), "right": (640, 480)}
    return calibrate({"left": left, "right": right}, spacing=25, sizes=sizes, free_board=free_board)


def every_side(xyz: np.ndarray) -> np.ndarray:
    return np.concatenate([each.ravel() for each in sides(xyz)])


def spread(sides: Sequence[np.ndarray]) -> dict[str, Any]:
    every = np.concatenate(sides)
    return {
        "sides": len(every),
        "mean": float(every.mean()),
        "deviation": float(every.std()),
        "pair_means": [float(part.mean()) for part in sides],
        "pair_deviations": [float(part.std()) for part in sides],
    }


def published_rig(path: Path) -> StereoRig:
    sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
    from stereo_data import bumblebee_rig

    return bumblebee_rig(path)


def show(result: dict[str, Any]) -> None:
    """Print the summary."""
    print("\nboth views of 40 x 40 corners, RMS errors in space, um")
    print(
        f"{'settings':30}{'severity':>9}{'frames':>8}{'index right':>13}{'placed':>8}"
        f"{'position':>10}{'raw':>7}{'displacement':>14}{'raw':>7}"
        f"{'within 2':>9}{'raw':>6}{'ms':>7}"
    )
    for row in result["by_severity"]:
        print(
            f"{row['config']:30}{row['severity']:9}{row['frames']:8}{row['index_right']:13.0%}"
            f"{row['nodes_placed']:8.2%}{row['place_rms_um']:10.1f}{row['raw_place_rms_um']:7.1f}"
            f"{row['moved_rms_um']:14.1f}{row['raw_moved_rms_um']:7.1f}"
            f"{row['within_2']:9.0%}{row['raw_within_2']:6.0%}"
            f"{row['ms']:7.0f}"
        )
    for row in result["numbering"]:
        print(
            f"numbering, {row['form'] + '=':7}{row['stream']:6}{row['corners']:7.0f} corners: "
            f"median {row['ms']:.2f} ms, 95 % {row['ms_p95']:.2f} ms, "
            f"{row['wrong_index']} wrong in {row['frames']} frames"
        )
    for run in result["orders"]:
        print(
            f"seed {run['seed']}: {run['same_bytes']} of {len(run['order'])} frames gave the same "
            "bytes in another order"
        )
    for row in result["boards"]:
        error = row.get("calibration_error_px")
        told = "published calibration" if error is None else f"reprojection error {error:.3f} px"
        print(
            f"{row['set']:11}{row['config']:44}{row['mean']:8.3f} +- {row['deviation']:.3f} mm of "
            f"{row['true']:g}, {told}{free_board_figures(row)}"
        )
    if not result["boards"]:
        print(f"left out: no photographs in {DATA}")


def free_board_figures(row: dict[str, Any]) -> str:
    if "board" not in row:
        return ""
    return (
        f"; {row['repeated']:.3f} from the board of the others, whose sides vary {row['board']:.3f}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="about a minute")
    parser.add_argument("--seeds", type=int, default=2, help="presses of each kind; default: 2")
    arguments = parser.parse_args(argv)
    around, device = environment(), select_device()
    print(f"{around['device']}, driver {around['driver']}, commit {around['commit']}")
    cases = [(kind, mode, severity) for kind in OBJECTS for mode in Mode for severity in SEVERITIES]
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.seeds)
    if arguments.quick:
        cases = [(Indenter.TORUS, Mode.TWIST, 1.0), (Indenter.CUBE, Mode.PRESS, 0.5)]
        seeds = seeds[:1]
    numbered = numbering(device, 5 if arguments.quick else 30)  # as in a process of its own
    rows: list[dict[str, Any]] = []
    orders = []
    with Progress(len(cases) * len(seeds), "pairs") as progress:
        for seed in seeds:
            scenes = [scene_of(seed, *case) for case in cases]
            answers, order = of_seed(seed, scenes, device, progress)
            rows += answers
            orders.append(order)
    result = {
        "kind": "field",
        "environment": around,
        "view": VIEW,
        "markers": MARKERS,
        "seeds": list(seeds),
        "configs": {name: dataclasses.asdict(config) for name, config in CONFIGS.items()},
        "by_severity": grouped(rows, "config", "severity"),
        "by_case": grouped(rows, "config", "object", "mode", "severity"),
        "frames": rows,
        "orders": orders,
        "numbering": numbered,
        "boards": boards(),
    }
    show(result)
    write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
