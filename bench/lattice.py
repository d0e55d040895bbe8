"""Which corners get a node, and which nodes a right number: the lattice beside `build_grid`, family
by family, and with each of its ideas left out.

    python bench/lattice.py --quick         a few frames of each family
    python bench/lattice.py                 writes results/lattice.json
    python bench/lattice.py --seed 9000000 --ablation       other frames, each idea left out

A node is right if it lies within 3 px of a corner and its number fits the lattice of the others,
wrong if the number does not fit, false if no corner lies within 3 px or a quarter of a cell. Nodes
that are only predicted count apart. A frame is silent if a number is wrong and nothing says so. The
lattice has no borders, known size or warnings yet: both methods number one frame by itself.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from environment import environment, parser_of, write_result
from partial_views import SETS, View, agreeing, views
from surroundings import board

from cmp_cl import Corners, Detector, DetectorConfig, NodeStatus, build_grid, select_device
from cmp_cl.errors import GridError
from cmp_cl.lattice.boards import boards
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.plan import LatticePlan
from cmp_cl.opencl.program import programs_of
from cmp_cl.synthetic import Indenter, Scene, random_scene, render

SEED = 5_000_000  # of the report; constants were tuned on other frames
HIT, SHARE = 3.0, 0.25  # px; of a cell
K = LatticeConstants()
# Constants that leave one idea out.
ABLATION: dict[str, dict[str, float]] = {
    "all": {},
    "links without evidence in the image": {"least_side": 1e-6},
    "faces need not agree": {"agree": 100.0, "cuts": 0},
    "contradicted parts are not cut": {"cuts": 0},
    "no joins across tears": {"join_votes": 1e9},
    "joins whatever the surface": {"join_bend": 0.0},
    "torn corners count as whole ones": {"torn_weight_per_px2": 1e9},
    "no test of nodes": {"stay_nats": -1e6},
    "outer lines hold what they hold": {"least_line": 0.0},
}


class Answer(NamedTuple):
    """Measured nodes: xy (M, 2), number (M, 2); how many are predicted; whether it has doubts."""

    xy: np.ndarray
    number: np.ndarray
    predicted: int = 0
    doubts: bool = False


Method = Callable[[View, Corners], Answer]
NOTHING = Answer(np.zeros((0, 2)), np.zeros((0, 2), int))


def pressed(name: str, scene: Scene) -> View:
    """Return the view of a whole gel."""
    shot = render(scene)
    index = np.indices(shot.truth.shape[:2]).transpose(1, 2, 0)
    truth = np.concatenate([shot.truth, index], axis=-1).reshape(-1, 4)
    region = np.ones(shot.image.shape, np.bool_)
    return View(name, shot.image, truth, region, shot.cell, shot.truth.shape[:2])


def gels(seed: int, count: int) -> Iterator[View]:
    draw = np.random.default_rng(seed + 1)
    for n in range(count):
        scene = random_scene(
            seed + n,
            markers=int(draw.integers(30, 45)),
            severity=(0.25, 0.5, 0.75, 1.0, 1.25, 1.5)[n % 6],
            corrosion=(0.3, 1.0, 2.0)[n // 6 % 3],
        )
        yield pressed(f"gel {n}", scene)


def torn(seed: int, count: int) -> Iterator[View]:
    for n in range(count):
        scene = random_scene(
            seed + 20_000 + n, markers=40 + n % 13, indenter=Indenter.TORUS, severity=2.0
        )
        yield pressed(f"torn gel {n}", scene)


def torn_otherwise(seed: int, count: int) -> Iterator[View]:
    """Yield gels torn by all objects with edges, at several severities."""
    draw = np.random.default_rng(seed + 3)
    objects = (Indenter.TORUS, Indenter.CUBE, Indenter.WEDGE, Indenter.RIB)
    for n in range(count):
        scene = random_scene(
            seed + 30_000 + n,
            markers=int(draw.integers(36, 53)),
            indenter=objects[n % 4],
            severity=float(draw.uniform(1.6, 2)),
            corrosion=float(draw.choice([1, 2])),
        )
        yield pressed(f"torn otherwise {n}", scene)


def photographs(seed: int, count: int) -> Iterator[View]:
    """Yield photographs cut at each of their sides; no seed, all cameras but the left ones."""
    del seed
    found = (
        view
        for folder in SETS
        for view in views(folder)
        if not view.name.startswith(("gels", "torn")) and "/left" not in view.name
    )
    for _, view in zip(range(4 * count), found, strict=False):
        yield view


def clutter(seed: int, count: int) -> Iterator[View]:
    for n in range(count):
        yield board(seed + 40_000 + n)[1]


FAMILIES: dict[str, tuple[Callable[[int, int], Iterator[View]], int]] = {
    "whole gels": (gels, 54),
    "torn by rings": (torn, 40),
    "torn by other objects": (torn_otherwise, 40),
    "photographs, cut": (photographs, 60),
    "boards in clutter": (clutter, 75),
}


def of_build_grid(view: View, corners: Corners) -> Answer:
    try:
        grid = build_grid(corners, view.image)
    except GridError:
        return NOTHING
    row, column = np.nonzero(grid.valid & (grid.status != NodeStatus.INTERPOLATED))
    predicted = int(np.count_nonzero(grid.status == NodeStatus.INTERPOLATED))
    number = np.stack([row, column], axis=1)
    return Answer(grid.xy[row, column].astype(np.float64), number, predicted, bool(grid.doubts))


def of_lattice(constants: LatticeConstants) -> Method:
    """Return the largest board of the lattice with these constants; positions are as seen."""
    device = select_device()
    programs = programs_of(device.handle)
    queue = cl.CommandQueue(programs.context)

    def find(view: View, corners: Corners) -> Answer:
        plan = LatticePlan(
            queue=queue,
            programs=programs,
            device=device,
            shape=view.image.shape,
            dtype=view.image.dtype,
            full_scale=255,
            capacity=max(len(corners), 1),
            constants=constants,
        )
        plan.take(view.image, corners.xy, corners.edges, corners.refusal)
        plan.start()
        found = next(boards(plan, corners.xy), None)
        if found is None:
            return NOTHING
        row, column = np.nonzero(found.owner >= 0)
        xy = np.stack([found.x[row, column], found.y[row, column]], axis=1).astype(np.float64)
        predicted = int(np.count_nonzero(found.there)) - len(xy)
        return Answer(xy, np.stack([row, column], axis=1), predicted)

    return find


def scored(view: View, answer: Answer) -> dict[str, int]:
    """Return the corners in view and how many nodes are right, wrong, false and predicted."""
    row = dict.fromkeys(("frames", "corners", "right", "wrong", "false", "predicted"), 0)
    row |= dict.fromkeys(("refused", "with doubts", "silent"), 0)
    row |= {"frames": 1, "corners": len(view.truth), "predicted": answer.predicted}
    if not len(answer.xy):
        return row | {"refused": 1}
    away = np.linalg.norm(answer.xy[:, None] - view.truth[None, :, :2], axis=2)
    nearest, distance = away.argmin(axis=1), away.min(axis=1)
    x, y = np.rint(answer.xy).astype(int).T
    rows, columns = view.region.shape
    counts = view.region[y.clip(0, rows - 1), x.clip(0, columns - 1)]
    hit = distance < HIT
    right, _ = agreeing(answer.number[hit], view.truth[nearest[hit], 2:].astype(int), view)
    wrong = int(np.count_nonzero(hit)) - right
    false = int(np.count_nonzero((distance >= max(HIT, SHARE * view.cell)) & counts))
    row |= {"right": right, "wrong": wrong, "false": false}
    return row | {
        "with doubts": int(answer.doubts),
        "silent": int(wrong > 0 and not answer.doubts),
    }


def measured(methods: dict[str, Method], seed: int, fewer: int) -> list[dict[str, Any]]:
    """Run every method on the same corners of every frame, and sum by family."""
    rows = []
    for family, (draw, count) in FAMILIES.items():
        totals: dict[str, dict[str, int]] = {name: {} for name in methods}
        for view in draw(seed, max(count // fewer, 1)):
            config = DetectorConfig.for_cell(view.cell)
            with Detector(shape=view.image.shape, config=config) as detector:
                corners = detector(view.image)
            for name, method in methods.items():
                for key, value in scored(view, method(view, corners)).items():
                    totals[name][key] = totals[name].get(key, 0) + value
        for name, total in totals.items():
            rows.append({"family": family, "method": name, **total})
            print(f"{family:24}{name:38}" + "".join(f"{v:9}" for v in total.values()), flush=True)
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="a tenth of the frames")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first frames")
    parser.add_argument("--ablation", action="store_true", help="leave out each idea too")
    arguments = parser.parse_args(argv)
    asked = ABLATION if arguments.ablation else {"all": {}}
    methods: dict[str, Method] = {"build_grid": of_build_grid}
    for name, changes in asked.items():
        constants = dataclasses.replace(K, **changes)
        methods[f"lattice, {name}"] = of_lattice(constants)
    print(f"{'family':24}{'method':38}" + "frames, corners, right, wrong, false, predicted, ...")
    result = {
        "kind": "lattice",
        "environment": environment(),
        "seed": arguments.seed,
        "rows": measured(methods, arguments.seed, 10 if arguments.quick else 1),
    }
    write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
