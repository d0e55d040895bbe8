"""Numerical limits: float32 kernels against the float64 oracle, the images on which each method
fails, and whether `corners.sigma` is right.

    python bench/stability.py --quick   few levels, two minutes
    python bench/stability.py           writes results/stability.json, about fifteen minutes
"""

import dataclasses
import itertools
import json
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import methods
import numpy as np
from environment import environment, parser_of, write_result
from methods import DEFAULT, FOR_CELL, LINES, Method
from peers import PEERS, Pattern, available
from scenes import TEST_SEED, Frame, rendered
from tqdm import tqdm

from cmp_cl import (
    Corners,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Midlines,
    detect,
    reference,
)
from cmp_cl.errors import ConfigError
from cmp_cl.reference import edges
from cmp_cl.synthetic import Scene, Surround, random_scene
from cmp_cl.synthetic.scoring import match, reach, total

SEED = TEST_SEED + 700_000
CLOSE = 1e-4  # a check so near to its bound may decide either way in float32
MARKERS = 30
CELL = 0.92 * 480 / (MARKERS + 1)
REFINEMENTS = {"EDGE_LINES": EdgeLines(), "EDGE_STEP": EdgeStep(cell=CELL), "MIDLINE": Midlines()}
PEERS_SHOWN = (
    "good_features_refined",
    "chess_opencl",
    "spectrum_opencl",
    "chess_corners_lean",
    "chess_corners_saddle",
    "mrgingham",
)


# float32 against float64


def against_oracle(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return the difference of kernels and oracle per corner, by refinement and conditioning."""
    whole: dict[str, Any] = {}
    for name, refinement in REFINEMENTS.items():
        config = DetectorConfig(refinement=refinement)
        columns: dict[str, list[np.ndarray]] = {
            key: [] for key in ("apart", "sine", "contrast", "rings")
        }
        other_branch = other_set = corners = 0
        for scene in scenes:
            image = rendered(scene).image
            seen = detect(image, config)
            expected, margin = reference.detect_with_margin(image, config)
            if not np.array_equal(seen.pixel, expected.pixel):
                other_set += 1
                continue
            corners += len(seen)
            same = (seen.method == expected.method) & (margin > CLOSE)
            other_branch += int((~same).sum())
            apart = np.hypot(*(seen.xy.astype(float) - expected.xy.astype(float)).T)
            start = np.rint(expected.xy).astype(np.int64)
            columns["apart"].append(apart[same])
            columns["sine"].append(_sine(expected)[same])
            columns["contrast"].append(_contrast(image, start)[same])
            columns["rings"].append(edges.edge_points(image, start, 1.0).valid.sum(1)[same])
        values = {key: np.concatenate(parts) for key, parts in columns.items()}
        whole[name] = {
            "frames_with_other_corners": other_set,
            "corners": corners,
            "near_a_bound_or_other_branch": other_branch,
            **_spread(values["apart"]),
            "by_sine": _binned(values, "sine", (0.0, 0.17, 0.3, 0.5, 0.7, 0.85, 0.95, 1.01)),
            "by_contrast": _binned(values, "contrast", (0, 20, 30, 40, 60, 80, 120, 256)),
            "by_rings": _binned(values, "rings", (0, 1, 2, 3, 4)),
        }
    return whole


def _sine(corners: Corners) -> np.ndarray:
    """Return the |sin| of the angle between the two lines through opposite boundaries."""
    unit = np.exp(1j * corners.edges.astype(float))
    first, second = unit[:, 0] - unit[:, 2], unit[:, 1] - unit[:, 3]
    return np.abs(np.imag(np.conj(first) * second)) / np.abs(first * second)


def _contrast(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the largest minus the smallest grey level of the radius-3 ring."""
    ring = at[:, None, :] + np.array(reference.ring.INNER)
    rows, columns = image.shape
    grey = image[ring[..., 1].clip(0, rows - 1), ring[..., 0].clip(0, columns - 1)].astype(int)
    return grey.max(1) - grey.min(1)


def _spread(apart: np.ndarray) -> dict[str, Any]:
    if not len(apart):
        return {"count": 0, "largest": None, "p99_9": None}
    return {
        "count": len(apart),
        "largest": float(apart.max()),
        "p99_9": float(np.percentile(apart, 99.9)),
    }


def _binned(values: dict[str, np.ndarray], key: str, ends: Sequence[float]) -> list[dict[str, Any]]:
    which = np.digitize(values[key], ends) - 1
    return [
        {"from": low, "to": high, **_spread(values["apart"][which == k])}
        for k, (low, high) in enumerate(itertools.pairwise(ends))
    ]


def along_position(offsets: Sequence[int]) -> list[dict[str, Any]]:
    """Measure the same image farther and farther to the right: the distances of the corners from
    their first positions plus the offset."""
    frame = rendered(dataclasses.replace(random_scene(SEED, markers=MARKERS), severity=0.5))
    image = frame.image
    rows = []
    for name in ("EDGE_LINES", "EDGE_STEP"):
        config = DetectorConfig(refinement=REFINEMENTS[name])
        at_zero = None
        for offset in offsets:
            wide = np.full((image.shape[0], image.shape[1] + offset), image[0, 0], np.uint8)
            wide[:, offset:] = image
            found = detect(wide, config)
            inside = found.pixel[:, 0] >= offset + 16
            xy = found.xy[inside].astype(float) - (offset, 0)
            if at_zero is None:
                at_zero = xy
            same = len(xy) == len(at_zero)
            moved = np.hypot(*(xy - at_zero).T) if same else np.array([np.nan])
            rows.append(
                {
                    "refinement": name,
                    "offset": offset,
                    "corners": len(xy),
                    "largest": float(moved.max()),
                    "float32_step": float(np.spacing(np.float32(offset + image.shape[1] // 2))),
                }
            )
    return rows


# where each method breaks


def sweeps(quick: bool) -> dict[str, tuple[list[float], Callable[[float, int], Scene]]]:
    """Return, for each sweep, its levels and a function that returns the scene at a level for a
    seed."""
    mild = {"severity": 0.25, "corrosion": 0.3}

    def base(seed: int, **changes: Any) -> Scene:
        scene = random_scene(seed, markers=MARKERS, **mild)
        return dataclasses.replace(scene, surround=Surround.GREY, **changes)

    levels: dict[str, tuple[list[float], Callable[[float, int], Scene]]] = {
        "blur, px": ([0.5, 1, 1.5, 2, 2.5, 3, 4, 5], lambda v, s: base(s, blur=v)),
        "noise, grey levels": (
            [0, 5, 10, 15, 20, 25, 35, 50, 70],
            lambda v, s: base(s, noise=v),
        ),
        "exposure": (
            [0.05, 0.1, 0.2, 0.5, 1, 1.5, 2.5, 4, 6, 10],
            lambda v, s: base(s, exposure=v),
        ),
        "vignetting, centre over corner": (
            [1, 1.5, 2.6, 4, 6, 8, 10],
            lambda v, s: base(s, vignetting=v, light=0.0),
        ),
        "cell, px": (
            [6, 7, 8, 10, 12, 15, 20, 30, 45, 60],
            lambda v, s: dataclasses.replace(
                random_scene(s, markers=max(3, min(100, round(0.92 * 480 / v) - 1)), **mild),
                surround=Surround.GREY,
            ),
        ),
        "severity": (
            [0, 0.25, 0.5, 0.75, 1, 1.25, 1.5, 1.75, 2],
            lambda v, s: random_scene(s, markers=MARKERS, severity=v),
        ),
        "corrosion": ([0, 0.5, 1, 1.5, 2, 2.5, 3], lambda v, s: base(s, corrosion=v, severity=1.0)),
    }
    if quick:
        return {name: (values[::3], make) for name, (values, make) in levels.items()}
    return levels


def breaking(names: Sequence[str], quick: bool, repeats: int, progress: tqdm) -> dict[str, Any]:
    """Return missed and false per thousand corners, and RMSE, of every method at every level."""
    whole: dict[str, Any] = {}
    for what, (values, make) in sweeps(quick).items():
        curves: dict[str, list[dict[str, Any]]] = {}
        for value in values:
            frames: list[Frame] = []
            for k in range(repeats):
                try:
                    frames.append(rendered(make(value, SEED + k)))
                except ConfigError as error:  # a surface that folds over cannot be rendered
                    progress.write(f"{what} {value}: {error}")
            if not frames:
                continue
            for row in rows_for(frames[0], names):
                scores = [frame.score(row.detect(frame.image)) for frame in frames]
                curves.setdefault(row.name, []).append({"at": value, **total(scores).summary()})
            progress.update()
        whole[what] = curves
    return whole


def rows_for(frame: Frame, names: Sequence[str]) -> list[Method]:
    """Return the methods of the curves, for the pattern of that frame."""
    cell = 0.92 * 480 / (frame.markers + 1)
    configs = methods.configs(_nearest(frame.markers), cell)
    kept = (DEFAULT, LINES, FOR_CELL)
    rows = [methods.own(name, configs[name], frame.image.shape) for name in kept]
    rows.append(methods.own_with_grid(methods.FULL, configs[FOR_CELL], frame))
    for name in names:
        peer = PEERS[name]
        settings = peer.settings(_nearest(frame.markers))
        pattern = Pattern(frame.markers)
        rows.append(Method(peer.label, json.dumps(settings), peer.make(settings, pattern)))
    return rows


def _nearest(markers: int) -> int:
    return min((20, 30, 40), key=lambda known: abs(known - markers))


def breaking_points(curves: dict[str, Any]) -> list[dict[str, Any]]:
    """Return, for each sweep and method, the levels at which at most 10 per thousand are wrong."""
    rows = []
    for what, methods_ in curves.items():
        for name, points in methods_.items():
            holds = [
                p["at"] for p in points if p["per_thousand"] is not None and p["per_thousand"] <= 10
            ]
            rows.append({"sweep": what, "method": name, "holds": holds})
    return rows


def depth(repeats: int) -> list[dict[str, Any]]:
    """Compare 8 bits with 12 in a 16-bit image, at exposures down to where 8 bits run out."""
    rows = []
    for exposure in (1.0, 0.4, 0.15, 0.06):
        for bits, full_scale in ((8, None), (12, 4095)):
            scores = []
            for k in range(repeats):
                scene = dataclasses.replace(
                    random_scene(SEED + k, markers=MARKERS, severity=0.25, corrosion=0.3),
                    exposure=exposure,
                    bits=bits,
                    noise=0.5,
                )
                frame = rendered(scene)
                config = DetectorConfig(full_scale=full_scale)
                image = frame.image
                scores.append(frame.score(detect(image, config).xy))
            rows.append({"exposure": exposure, "bits": bits, **total(scores).summary()})
    return rows


# corners.sigma


def calibration(scenes: dict[str, list[Scene]]) -> list[dict[str, Any]]:
    """Compare EDGE_STEP's sigma with the real error: the root mean square of error / sigma per axis
    is 1 if sigma is right. Compare the flag `doubtful` with errors above 1 px."""
    rows = []
    for kind, those in scenes.items():
        errors, sigmas, doubts = [], [], []
        for scene in those:
            frame = rendered(scene)
            cell = 0.92 * 480 / (scene.markers + 1)
            config = DetectorConfig(refinement=EdgeStep(cell=cell))
            found = detect(frame.image, config)
            partner = match(found.xy, frame.truth, reach(frame.cell))
            hit = (partner >= 0) & np.isfinite(found.sigma)
            errors.append(np.hypot(*(found.xy[hit] - frame.truth[partner[hit]]).T))
            sigmas.append(found.sigma[hit].astype(float))
            doubts.append(found.doubtful[hit])
        error, sigma, doubt = (np.concatenate(part) for part in (errors, sigmas, doubts))
        order = np.argsort(sigma)
        far = error > 1
        rows.append(
            {
                "kind": kind,
                "corners": len(error),
                "z": _z(error, sigma),
                "rank_correlation": _rank_correlation(error, sigma),
                "doubtful": float(doubt.mean()),
                "far": int(far.sum()),
                "doubtful_of_far": float(doubt[far].mean()) if far.any() else None,
                "deciles": [
                    {
                        "sigma": float(np.sqrt(np.mean(sigma[part] ** 2))),
                        "error": float(np.sqrt(np.mean(error[part] ** 2) / 2)),
                    }
                    for part in np.array_split(order, 10)
                ],
            }
        )
    return rows


def _z(error: np.ndarray, sigma: np.ndarray) -> float:
    return float(np.sqrt(np.mean((error / sigma) ** 2) / 2))


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    ranks = [np.argsort(np.argsort(values)) for values in (a, b)]
    return float(np.corrcoef(*ranks)[0, 1])


# single cases


def cases() -> list[dict[str, Any]]:
    """Run unusual inputs, and return each with its result."""
    draw = np.random.default_rng(SEED)
    frame = rendered(random_scene(SEED, markers=MARKERS, severity=0.5))
    image = frame.image
    rows = []

    def found(picture: np.ndarray, **changes: Any) -> Corners:
        picture = np.ascontiguousarray(picture)
        config = DetectorConfig(**changes)
        return detect(picture, config)

    def case(what: str, figure: float, expected: str) -> None:
        rows.append({"case": what, "figure": figure, "expected": expected})

    for grey in (0, 128, 255):
        case(f"flat frame of {grey}: corners", len(found(np.full((480, 640), grey, np.uint8))), "0")
    for sigma in (5, 15, 25):
        noise = np.clip(np.rint(draw.normal(128, sigma, (480, 640))), 0, 255).astype(np.uint8)
        case(f"blank frame with noise {sigma}: corners", len(found(noise)), "0")
    for width in range(1, 9):
        stripes = (np.arange(640) // width % 2 * 200 + 20).astype(np.uint8)
        count = len(found(np.broadcast_to(stripes, (480, 640)).copy()))
        case(f"stripes of {width} px: corners", count, "0")
    rows_, columns_ = np.indices((480, 640))
    for width in range(3, 13):
        across = 0.9 * columns_ + 0.44 * rows_
        slanted = (np.floor(across / width) % 2 * 200 + 20).astype(np.uint8)
        slanted = cv2.GaussianBlur(slanted, (0, 0), 0.8)
        xy = found(slanted).xy
        inside = ((xy > 12) & (xy < (627, 467))).all(axis=1)
        case(f"slanted stripes of {width} px: corners inside", int(inside.sum()), "0")
    salt = image.copy()
    hit = draw.random(salt.shape) < 0.02
    salt[hit] = draw.choice(np.array([0, 255], np.uint8), int(hit.sum()))
    answer = frame.score(found(salt).xy)
    case("salt and pepper on 2 %: missed", answer.missed, "few")
    case("salt and pepper on 2 %: false", answer.false, "few")
    as_is = found(image)
    places = as_is.xy.astype(float)
    columns = image.shape[1]
    turns: dict[str, tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]] = {
        "inverted": (255 - image, lambda xy: xy),
        "mirrored": (image[:, ::-1], lambda xy: np.stack([columns - 1 - xy[:, 0], xy[:, 1]], 1)),
        "turned by 90 degrees": (
            np.rot90(image),
            lambda xy: np.stack([columns - 1 - xy[:, 1], xy[:, 0]], 1),
        ),
    }
    for what, (picture, back) in turns.items():
        other = back(found(picture).xy.astype(float))
        partner = match(other, places, 1.0)
        missing = len(places) + len(other) - 2 * int((partner >= 0).sum())
        apart = np.hypot(*(other[partner >= 0] - places[partner[partner >= 0]]).T)
        case(f"{what}: corners without a partner", missing, "few: ties fall by raster order")
        case(f"{what}: median difference, px", float(np.median(apart)), "below 0.001")
    board = np.kron(np.indices((12, 12)).sum(0) % 2, np.ones((20, 20))) * 200 + 20
    perfect = found(board.astype(np.uint8), refinement=Midlines())
    case(
        "perfect board, midlines: positions not finite", int((~np.isfinite(perfect.xy)).sum()), "0"
    )
    plain = found(board.astype(np.uint8))
    want = np.stack(np.meshgrid(np.arange(1, 12), np.arange(1, 12)), -1).reshape(-1, 2) * 20 - 0.5
    case("perfect board: corners", len(plain), "121")
    partner = match(plain.xy, want, 3)
    hit = partner >= 0
    case(
        "perfect board: largest error, px",
        float(np.hypot(*(plain.xy[hit] - want[partner[hit]]).T).max()),
        "below 0.01",
    )
    for shape in ((0, 0), (1, 1), (5, 7), (16, 16)):
        case(
            f"image of {shape[0]} x {shape[1]}: corners", len(found(np.zeros(shape, np.uint8))), "0"
        )
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__, quick="few levels, two minutes").parse_args(argv)
    found, reasons = available()
    names = [name for name in PEERS_SHOWN if name in found]
    repeats = 1 if arguments.quick else 3
    mixed = [
        random_scene(SEED + k, markers=MARKERS, severity=severity)
        for k in range(repeats)
        for severity in (0.25, 1.0, 1.5)
    ]
    kinds = {
        "print": [
            random_scene(SEED + 100 + k, markers=MARKERS, severity=0.25, corrosion=0.0)
            for k in range(2 * repeats)
        ],
        "worn gel": [
            random_scene(SEED + 200 + k, markers=MARKERS, severity=0.75) for k in range(2 * repeats)
        ],
    }
    steps = sum(len(values) for values, _ in sweeps(arguments.quick).values())
    with tqdm(total=steps + 5, unit=" levels") as progress:
        result: dict[str, Any] = {"kind": "stability", "environment": environment()}
        result["cases"] = cases()
        progress.update()
        result["against_oracle"] = against_oracle(mixed)
        progress.update()
        offsets = (0, 1000, 4000) if arguments.quick else (0, 1000, 4000, 8000, 12000, 15500)
        result["along_position"] = along_position(offsets)
        progress.update()
        result["depth"] = depth(repeats)
        progress.update()
        result["sigma"] = calibration(kinds)
        progress.update()
        result["breaking"] = breaking(names, arguments.quick, repeats, progress)
        result["breaking_points"] = breaking_points(result["breaking"])
    result |= {"unavailable": reasons, "first_seed": SEED, "repeats": repeats}
    show(result)
    write_result(result, arguments.out, quick=arguments.quick, indent=None)
    return 0


def show(result: dict[str, Any]) -> None:
    for row in result["cases"]:
        print(f"{row['case']:52}{row['figure']:12.6g}   expected {row['expected']}")
    for name, row in result["against_oracle"].items():
        print(
            f"{name}: float32 differs from float64 by at most {row['largest']:.2e} px, 99.9 % "
            f"below {row['p99_9']:.2e}, of {row['count']}; {row['near_a_bound_or_other_branch']} "
            f"near a bound; {row['frames_with_other_corners']} frames with other corners"
        )
    for row in result["along_position"]:
        print(
            f"{row['refinement']} at x + {row['offset']}: moved by {row['largest']:.2e} px, "
            f"float32 there has steps of {row['float32_step']:.2e}"
        )
    for row in result["sigma"]:
        print(
            f"sigma, {row['kind']}: z {row['z']:.2f}, rank correlation "
            f"{row['rank_correlation']:.2f}, doubtful {100 * row['doubtful']:.2f} %, of "
            f"{row['far']} above 1 px {row['doubtful_of_far']}"
        )
    for row in result["breaking_points"]:
        holds = [f"{value:g}" for value in row["holds"]]
        print(f"{row['sweep']:32}{row['method']:40} holds at {', '.join(holds) or 'none'}")


if __name__ == "__main__":
    raise SystemExit(main())
