"""Positions and displacements before and after the lattice filter, and whether sigma is right.

    python bench/positions.py --quick   30 scenes, two minutes
    python bench/positions.py           every scene of accuracy.py with its frame at rest, and
                                        prints of other wear and noise; writes
                                        results/positions.json, about twenty minutes

A node counts if the numbering of both frames is right. `within` is the share of the coordinates
whose error is within one and within two stated standard deviations: 68 and 95 % if errors are
normal and sigma is right.
"""

import dataclasses
import itertools
import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from accuracy import DENSITIES, INDENTERS, SEVERITIES, by_corner, scenes
from environment import environment, parser_of, write_result
from methods import peer
from peers import PEERS, Detect, Pattern, available
from scenes import TEST_SEED, Frame, rendered
from tqdm import tqdm

from cmp_cl import Detector, DetectorConfig, Grid, GridError, NodeStatus
from cmp_cl.grid import filter_grid, filter_positions
from cmp_cl.grid.grid import MEASURED
from cmp_cl.motion import PlaneScale, displacement
from cmp_cl.space import Points3D, PointStatus
from cmp_cl.synthetic import Scene, random_scene

CORROSIONS = (0.0, 0.3, 2.0)  # beside the 1 of accuracy.py
REPEATS = 3  # prints of each of these, density and severity
NOISES = (0.5, 8.0)  # beside the 2 to 4.5
BEND = 0.2  # px, least distance of a node's true position from the cubic through its neighbours
RIVALS = (
    "find_chessboard_sb",
    "spectrum_opencl",
    "chess_corners_saddle",
    "libcbdetect",
)
STRAINS = (1e-4, 1e-3, 1e-2, 0.1, 0.3)
WAVES = (4, 6, 8, 10, 12, 16, 20, 24, 32)  # nodes
KINDS = ("position", "displacement", "raw position", "raw displacement")


def others(quick: bool) -> Iterator[Scene]:
    """Yield prints of other wear, and images of other noise, at every severity."""
    seed = TEST_SEED + 700_000
    yield from worn(seed, quick)
    seed += len(CORROSIONS) * len(DENSITIES) * len(SEVERITIES)
    for noise in NOISES:
        for corrosion in (0.0, 1.0):
            for severity in SEVERITIES:
                seed += 1
                if not quick:
                    scene = random_scene(seed, severity=severity, corrosion=corrosion)
                    yield dataclasses.replace(scene, noise=noise)


def worn(seed: int, quick: bool) -> Iterator[Scene]:
    """Yield a print of each other wear, density and severity."""
    for corrosion in CORROSIONS:
        for markers in DENSITIES:
            for number, severity in enumerate(SEVERITIES):
                seed += 1
                if quick and (markers != 40 or number % 3):
                    continue
                yield random_scene(
                    seed,
                    markers=markers,
                    severity=severity,
                    indenter=INDENTERS[seed % len(INDENTERS)],
                    corrosion=corrosion,
                )


@dataclasses.dataclass(frozen=True)
class Node:
    """Errors of all good nodes of one frame, by kind: error (N, 2) and sigma (N,), px."""

    scene: Scene
    errors: dict[str, np.ndarray]
    sigmas: dict[str, np.ndarray]
    bends: dict[str, np.ndarray]
    rivals: dict[str, tuple[float, float, float, int]]


def turned_truth(grid: Grid, truth: np.ndarray) -> np.ndarray:
    """Return the truth numbered as the grid is: the quarter rotation that fits best."""
    markers = math.isqrt(len(truth))
    square = truth.reshape(markers, markers, 2)
    turns = [np.rot90(square, quarters) for quarters in range(4)]
    return min(turns, key=lambda turn: float(np.nanmedian(np.abs(grid.xy - turn))))


def bent(truth: np.ndarray) -> np.ndarray:
    """Return the nodes whose truth is off the cubic through four neighbours in a row or column."""
    off = np.zeros(truth.shape[:2])
    for axis in (0, 1):
        lines = np.moveaxis(truth, axis, 0)
        cubic = (4 * (lines[1:-3] + lines[3:-1]) - lines[:-4] - lines[4:]) / 6
        inner = np.moveaxis(off, axis, 0)[2:-2]
        np.maximum(inner, np.linalg.norm(lines[2:-2] - cubic, axis=2), out=inner)
    return off > BEND


def measured(scene: Scene, detector: Detector, rivals: dict[str, Detect]) -> Node | None:
    """Measure a scene against its frame at rest; None if the numbering is wrong or missing."""
    shape = (scene.markers, scene.markers)
    rest_frame, frame = rendered(scene.at_rest()), rendered(scene)
    try:
        rest = detector.grid(rest_frame.image, shape=shape)[1]
        now = detector.grid(frame.image, like=rest)[1]
    except GridError:
        return None
    rest_truth = turned_truth(rest, rest_frame.truth)
    quarters = next(
        k
        for k in range(4)
        if np.array_equal(np.rot90(rest_frame.truth.reshape(*shape, 2), k), rest_truth)
    )
    truth = np.rot90(frame.truth.reshape(*shape, 2), quarters)
    wrong = np.linalg.norm(now.xy - truth, axis=2) > 0.6 * frame.cell
    if np.count_nonzero(wrong) > 0.05 * wrong.size:
        return None
    filtered, raw = filter_positions(now, rest=rest)
    good = np.isin(now.status, MEASURED) & np.isin(rest.status, MEASURED) & ~wrong
    change = displacement(rest, now)
    moved = truth - rest_truth
    values = {
        "position": (filtered.xy - truth, filtered.sigma),
        "displacement": (change.displacement - moved, change.sigma),
        "raw position": (raw.xy - truth, raw.sigma),
        "raw displacement": (now.xy - rest.xy - moved, change.raw.sigma),
        "corner": (raw.xy - truth, now.sigma),
    }
    good &= np.isfinite(change.displacement[..., 0])
    edges = {"position": bent(truth) & good, "displacement": bent(moved) & good}
    bends = {
        kind: np.square(values[kind][0][edges[kind.removeprefix("raw ")]]).sum(axis=1)
        for kind in KINDS
    }
    return Node(
        scene=scene,
        errors={kind: error[good] for kind, (error, _) in values.items()},
        sigmas={kind: sigma[good] for kind, (_, sigma) in values.items()},
        bends=bends,
        rivals=against(rivals, frame, filtered, raw, good),
    )


def against(
    rivals: dict[str, Detect], frame: Frame, filtered: Grid, raw: Grid, good: np.ndarray
) -> dict[str, tuple[float, float, float, int]]:
    """Sum squared distances on the corners that a rival finds too: its, EDGE_STEP's, ours."""
    mine, ours = (by_corner(grid.xy[good], frame) for grid in (raw, filtered))
    sums = {}
    for name, detect in rivals.items():
        theirs = by_corner(detect(frame.image), frame)
        both = np.isfinite(theirs) & np.isfinite(mine) & np.isfinite(ours)
        sums[PEERS[name].label] = (
            *(float(np.sum(each[both] ** 2)) for each in (theirs, mine, ours)),
            int(np.count_nonzero(both)),
        )
    return sums


def interval(hits: float, count: float) -> list[float]:
    """Return Wilson's interval of 95 % for a share."""
    if not count:
        return [0.0, 1.0]
    z, share = 1.96, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    return [middle - half, middle + half]


def student(count: int) -> float:
    """Return the 97.5 % point of Student's t for that many values, to 4 % from four on."""
    z, free = 1.96, max(count - 1, 1)
    return z + (z**3 + z) / (4 * free) + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * free**2)


def mean_interval(values: Sequence[float]) -> list[float]:
    """Return the interval of 95 % for the mean of some frames' figures, NaN for a single one."""
    if len(values) < 2:
        return [math.nan, math.nan]
    half = student(len(values)) * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return [float(np.mean(values)) - half, float(np.mean(values)) + half]


def rms_interval(squares: Sequence[float]) -> list[float]:
    """Return the interval of 95 % for the root of the mean of some frames' mean squares."""
    return [math.sqrt(max(bound, 0)) for bound in mean_interval(squares)]


def group(nodes: Sequence[Node], **keys: Any) -> dict[str, Any]:
    """Return the figures of some frames. Shares are of coordinates; intervals are those of 95 %
    over frames, whose nodes are not independent of each other.
    """
    row: dict[str, Any] = {**keys, "frames": len(nodes)}
    for kind in (*KINDS, "corner"):
        shares = []
        for node in nodes:
            ratio = np.abs(node.errors[kind]) / node.sigmas[kind][:, None]
            ratio = ratio[np.isfinite(ratio).all(axis=1)]
            if len(ratio):
                z2 = np.square(ratio).mean()
                shares.append([np.mean(ratio <= 1), np.mean(ratio <= 2), z2])
        one, two, z2 = np.mean(shares, axis=0) if shares else (np.nan,) * 3
        squares = [float(np.square(node.errors[kind]).sum(axis=1).mean()) for node in nodes]
        row[kind] = {
            "rms": math.sqrt(np.mean(squares)),
            "rms_interval": rms_interval(squares),
            "within_1": float(one),
            "within_2": float(two),
            "within_2_interval": mean_interval([share[1] for share in shares]),
            "z": math.sqrt(z2),
        }
    ratios = [
        math.sqrt(
            np.square(node.errors["displacement"]).sum()
            / np.square(node.errors["raw displacement"]).sum()
        )
        for node in nodes
    ]
    worse = int(np.sum(np.array(ratios) > 1))
    row |= {
        "worse": worse / len(nodes),
        "worse_interval": interval(worse, len(nodes)),
        "worst_ratio": float(max(ratios)),
        "median_ratio": float(np.median(ratios)),
    }
    return row


def groups(nodes: Sequence[Node]) -> list[dict[str, Any]]:
    """Group by wear and severity, then the usual ones by density and by noise."""
    rows = []
    usual = [node for node in nodes if 2 <= node.scene.noise <= 4.5]
    for corrosion in sorted({node.scene.corrosion for node in usual}):
        worn = [node for node in usual if node.scene.corrosion == corrosion]
        rows.append(group(worn, corrosion=corrosion))
        for key in ("severity", "markers"):
            for value in sorted({getattr(node.scene, key) for node in worn}):
                chosen = [node for node in worn if getattr(node.scene, key) == value]
                rows.append(group(chosen, corrosion=corrosion, **{key: value}))
        noises = np.quantile([node.scene.noise for node in worn], [0, 1 / 3, 2 / 3, 1])
        for low, high in itertools.pairwise(noises):
            chosen = [node for node in worn if low <= node.scene.noise <= high]
            if chosen:
                band = [float(low), float(high)]
                rows.append(group(chosen, corrosion=corrosion, noise=band))
    for noise in NOISES:
        for corrosion in (0.0, 1.0):
            chosen = [n for n in nodes if n.scene.noise == noise and n.scene.corrosion == corrosion]
            if chosen:
                rows.append(group(chosen, corrosion=corrosion, noise=[noise, noise]))
    return rows


def at_bends(nodes: Sequence[Node]) -> dict[str, Any]:
    """Return the RMS of the distance at nodes where the truth bends, for scenes of usual wear."""
    worn = [node for node in nodes if node.scene.corrosion == 1]
    sums = {kind: np.concatenate([node.bends[kind] for node in worn]) for kind in KINDS}
    return {
        kind: {"nodes": len(values), "rms": float(np.sqrt(values.mean())) if len(values) else None}
        for kind, values in sums.items()
    }


def compared(nodes: Sequence[Node]) -> list[dict[str, Any]]:
    """Return the RMS of the distance of other methods on the corners that they find, px, with
    intervals of 95 % over frames; without wear and with it.
    """
    frames: dict[tuple[float, str], list[tuple[float, float, float, int]]] = defaultdict(list)
    for node in nodes:
        for name, sums in node.rivals.items():
            frames[node.scene.corrosion, name].append(sums)
    rows = []
    for (corrosion, name), sums in sorted(frames.items(), key=lambda item: item[0][0]):
        *squares, counts = np.array(sums).T
        if not counts.sum():
            continue
        row: dict[str, Any] = {"corrosion": corrosion, "method": name}
        row |= {"corners": int(counts.sum()), "frames": len(sums)}
        for kind, square in zip(("rms", "edge_step", "filtered"), squares, strict=True):
            mean = square.sum() / counts.sum()
            apart = np.sqrt(np.square(square - mean * counts).sum()) / counts.sum()
            half = student(len(sums)) * math.sqrt(len(sums) / max(len(sums) - 1, 1)) * apart
            row[kind] = math.sqrt(mean)
            bounds = (mean - half, mean + half)
            row[f"{kind}_interval"] = [math.sqrt(max(bound, 0)) for bound in bounds]
        rows.append(row)
    return rows


# the bound on a perfect print


def bound(frames: int) -> dict[str, Any]:
    """Return the noise-only Cramer-Rao bound of a disc of 0.75 cell on perfect prints at rest.

    The image without noise is known except for its position: F = sum of grad grad^T / noise^2.
    The noise part of EDGE_STEP is the distance between its answers with and without noise.
    """
    bounds, parts, whole = [], [], []
    for number in range(frames):
        noisy = random_scene(TEST_SEED + 800_000 + number, severity=0.0, corrosion=0.0)
        clean = dataclasses.replace(noisy, noise=0.0)
        shown, still = rendered(noisy), rendered(clean)
        shape = (noisy.markers, noisy.markers)
        radius = 0.75 * still.cell
        with Detector(
            shape=shown.image.shape, config=DetectorConfig.for_cell(still.cell)
        ) as detector:
            grids = [detector.grid(frame.image, shape=shape)[1] for frame in (shown, still)]
        truth = turned_truth(grids[0], shown.truth)
        parts.append(np.square(grids[0].xy - grids[1].xy).sum(axis=2).ravel())
        whole.append(np.square(grids[0].xy - truth).sum(axis=2).ravel())
        grey = still.image.astype(np.float64)
        by_x, by_y = (cv2.Sobel(grey, cv2.CV_64F, *order) / 8 for order in ((1, 0), (0, 1)))
        y, x = np.mgrid[: grey.shape[0], : grey.shape[1]]
        for cx, cy in truth.reshape(-1, 2)[::7]:
            disc = np.square(x - cx) + np.square(y - cy) < radius**2
            slopes = np.stack([by_x[disc], by_y[disc]])
            bounds.append(np.trace(np.linalg.inv(slopes @ slopes.T)) * noisy.noise**2)
    said = {"bound": bounds, "noise_part": np.concatenate(parts), "all": np.concatenate(whole)}
    return {name: float(np.sqrt(np.nanmean(values))) for name, values in said.items()} | {
        "frames": frames
    }


# known deformations


PITCH = 0.78  # mm, of 40 nodes on 32 mm
PIXEL = PITCH / 15  # mm, in the plane
WEAR, OWN = 10e-3, 2e-3  # mm: wear that travels with the nodes, and noise of each moment
AMPLITUDE = 0.05  # mm, of the sines


def lattice(nodes: int = 40) -> np.ndarray:
    """Return a flat lattice, (R, C, 3), mm."""
    r, c = np.mgrid[:nodes, :nodes] * PITCH
    return np.stack([c, r, np.full_like(r, 45.0)], axis=-1)


def points(xyz: np.ndarray) -> Points3D:
    """Return nodes in space, mm, as a triangulation would give them."""
    shape = xyz.shape[:2]
    return Points3D(
        xyz=xyz,
        error=np.zeros(shape),
        covariance=np.full((*shape, 3, 3), np.nan),
        status=np.full(shape, PointStatus.VALID, np.uint8),
        source=np.full(shape, NodeStatus.DETECTED, np.uint8),
        unit="mm",
    )


def grid(xyz: np.ndarray) -> Grid:
    """Return the nodes as one view sees them from the front."""
    shape = xyz.shape[:2]
    return Grid(
        xy=(xyz[..., :2] / PIXEL).astype(np.float32),
        status=np.full(shape, NodeStatus.DETECTED, np.uint8),
        sigma=np.full(shape, np.nan, np.float32),
        index=np.empty((0, 2), np.int32),
    )


def pressed(now: np.ndarray, seed: int) -> dict[tuple[str, str], tuple[np.ndarray, ...]]:
    """Measure the deformation of the flat lattice to `now`, with wear and noise, in space and in
    the plane, raw and filtered: displacement, E11 and the sigma of E11.
    """
    draw = np.random.default_rng(seed)
    flat = lattice()
    wear = draw.normal(0, WEAR, flat.shape)
    moments = [xyz + wear + draw.normal(0, OWN, flat.shape) for xyz in (flat, now)]
    space = displacement(*(points(moment) for moment in moments)).with_strain()
    scale = PlaneScale.of_pixel(PIXEL, "mm")
    plane = displacement(*(grid(moment) for moment in moments), scale=scale).with_strain()
    found = {}
    for view, field in (("space", space), ("plane", plane)):
        for name, each in (("raw", field.raw.with_strain()), ("filtered", field)):
            strain, sigma = each.strain[..., 0], each.strain_sigma[..., 0]
            found[view, name] = (each.displacement, strain, sigma)
    return found


def known_strains(repeats: int) -> list[dict[str, Any]]:
    """Measure uniform stretches along the rows: E11 and displacement, with intervals over the
    prints.
    """
    rows = []
    for stretch in STRAINS:
        now = lattice() * [1 + stretch, 1 - 0.4 * stretch, 1]
        moved = now - lattice()
        true = stretch + stretch**2 / 2
        found = [pressed(now, TEST_SEED + seed) for seed in range(repeats)]
        for view, name in found[0]:
            each = [one[view, name] for one in found]
            errors = np.stack([strain - true for _, strain, _ in each])
            sigmas = np.stack([sigma for *_, sigma in each])
            off = [np.square(far - moved[..., : far.shape[2]]).sum(axis=2) for far, *_ in each]
            within = np.nanmean(np.abs(errors) <= 2 * sigmas, axis=(1, 2))
            rows.append(
                {
                    "view": view,
                    "field": name,
                    "strain": true,
                    "mean": float(np.nanmean(errors)) + true,
                    "rms": float(np.sqrt(np.nanmean(errors**2))),
                    "rms_interval": rms_interval(np.nanmean(errors**2, axis=(1, 2)).tolist()),
                    "within_2": float(np.mean(within)),
                    "within_2_interval": mean_interval(within.tolist()),
                    "displacement_um": 1e3 * math.sqrt(np.nanmean(off)),
                    "displacement_um_interval": [
                        1e3 * bound for bound in rms_interval([float(np.nanmean(o)) for o in off])
                    ],
                }
            )
    return rows


def resolution(repeats: int) -> list[dict[str, Any]]:
    """Return, by wavelength, the share of a strain's amplitude that is left and the displacement's
    error, for a displacement that is a sine over the rows.
    """
    rows = []
    column = np.arange(40) * PITCH
    for nodes in WAVES:
        wave = 2 * np.pi / (nodes * PITCH)
        moved = AMPLITUDE * np.sin(wave * column)[None, :, None] * np.array([1.0, 0, 0])
        moved = np.broadcast_to(moved, (40, 40, 3))
        slope = AMPLITUDE * wave * np.cos(wave * column)
        true = np.broadcast_to(slope + slope**2 / 2, (40, 40))[4:-4, 4:-4]
        centred = true - true.mean()
        found = [pressed(lattice() + moved, TEST_SEED + seed) for seed in range(repeats)]
        for view, name in found[0]:
            each = [one[view, name] for one in found]
            shares = [
                float((strain[4:-4, 4:-4] * centred).sum() / np.square(centred).sum())
                for _, strain, _ in each
            ]
            off = [np.square(far - moved[..., : far.shape[2]]).sum(axis=2) for far, *_ in each]
            rows.append(
                {
                    "view": view,
                    "field": name,
                    "wavelength": nodes,
                    "left": float(np.mean(shares)),
                    "left_interval": mean_interval(shares),
                    "displacement_um": 1e3 * math.sqrt(np.nanmean(off)),
                }
            )
    return rows


def show(result: dict[str, Any]) -> None:
    """Print the tables."""
    for row in result["groups"]:
        keys = ("corrosion", "severity", "markers", "noise")
        said = ", ".join(f"{key} {row[key]}" for key in keys if key in row)
        print(
            f"{said:34}{row['frames']:4} frames "
            + " | ".join(
                f"{kind} {row[kind]['rms']:.4f} px {row[kind]['within_1']:.0%} "
                f"{row[kind]['within_2']:.0%}"
                for kind in (*KINDS, "corner")
            )
            + f" | worse {row['worse']:.0%}, at most {row['worst_ratio']:.2f} times"
        )
    for kind, row in result["bends"].items():
        print(f"where the truth bends, {kind}: {row['nodes']} nodes, RMSE {row['rms']:.4f} px")
    for row in result["compared"]:
        print(
            f"corrosion {row['corrosion']}, on the {row['corners']} corners of {row['method']}: "
            f"its RMSE {row['rms']:.4f}, EDGE_STEP {row['edge_step']:.4f}, filtered "
            f"{row['filtered']:.4f} px"
        )
    bound = result["bound"]
    print(
        f"perfect print: bound {bound['bound']:.4f}, noise part of EDGE_STEP "
        f"{bound['noise_part']:.4f}, whole error {bound['all']:.4f} px, {bound['frames']} frames"
    )
    for row in result["strains"]:
        print(
            f"strain {row['strain']}, {row['view']}, {row['field']}: mean {row['mean']:.5f}, RMSE "
            f"{row['rms']:.5f}, within two sigma {row['within_2']:.0%}"
        )
    for row in result["resolution"]:
        print(
            f"wavelength {row['wavelength']} nodes, {row['view']}, {row['field']}: "
            f"{row['left']:.0%} of the amplitude of the strain is left"
        )
    print(
        f"{result['left_out']} scenes were not numbered; the filter takes {result['ms']:.2f} ms "
        f"for the positions of 1936 nodes and {result['ms_bends']:.2f} ms for their displacements"
    )


def filter_time(*, bends: bool) -> float:
    """Return the milliseconds for values and sigma of 44 x 44 nodes, the median."""
    draw = np.random.default_rng(0)
    values = draw.normal(0, 0.1, (44, 44, 2)) + np.mgrid[:44, :44].transpose(1, 2, 0) * 0.1
    spent = []
    for _ in range(200):
        start = time.perf_counter()
        filter_grid(values, bends=bends)
        spent.append((time.perf_counter() - start) * 1e3)
    return float(np.median(spent[10:]))


def chosen_scenes(quick: bool) -> Iterable[tuple[Scene, bool]]:
    """Return the scenes, and whether other methods see them too."""
    for markers in DENSITIES[1:3] if quick else DENSITIES:
        severities = SEVERITIES[1::3] if quick else SEVERITIES
        for number, scene in enumerate(scenes(markers, severities, 1 if quick else 3)):
            yield scene, number % 3 == 0
    for scene in others(quick):
        yield scene, scene.corrosion == 0
    if not quick:
        for repeat in range(1, REPEATS):
            for scene in worn(TEST_SEED + 700_000 + 1000 * repeat, quick):
                yield scene, False


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__, quick="30 scenes, no slow peers").parse_args(argv)
    around = environment()
    found, reasons = available()
    found = [name for name in RIVALS if name in found]
    if arguments.quick:
        found = [name for name in found if not PEERS[name].slow]
    detectors: dict[int, Detector] = {}
    rivals: dict[int, dict[str, Detect]] = {}
    nodes, lost = [], 0
    for scene, contested in tqdm(list(chosen_scenes(arguments.quick)), unit=" scenes"):
        if scene.markers not in detectors:
            config = DetectorConfig.for_cell(0.92 * min(scene.shape) / (scene.markers + 1))
            detectors[scene.markers] = Detector(shape=scene.shape, config=config)
            pattern = Pattern(scene.markers)
            rivals[scene.markers] = {name: peer(name, pattern).detect for name in found}
        node = measured(scene, detectors[scene.markers], rivals[scene.markers] if contested else {})
        nodes += [] if node is None else [node]
        lost += node is None
    repeats = 1 if arguments.quick else 5
    result = {
        "kind": "positions",
        "environment": around,
        "unavailable": {name: reasons[name] for name in RIVALS if name in reasons},
        "groups": groups(nodes),
        "bends": at_bends(nodes),
        "compared": compared(nodes),
        "bound": bound(1 if arguments.quick else 4),
        "strains": known_strains(repeats),
        "resolution": resolution(repeats),
        "left_out": lost,
        "ms": filter_time(bends=False),
        "ms_bends": filter_time(bends=True),
    }
    show(result)
    write_result(result, arguments.out, quick=arguments.quick, indent=None)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
