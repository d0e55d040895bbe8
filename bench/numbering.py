"""Which corners get a number, and which numbers are right: family by family, beside the peers.

    python bench/numbering.py --quick        a tenth of the frames
    python bench/numbering.py                writes results/numbering.csv and ablation.csv
    python bench/numbering.py --ablation     only the second: each idea of the lattice left out

A node is right if it lies within 3 px of a corner and its number fits the lattice of the others,
wrong if its number does not, false if no corner lies within 3 px and a quarter of a cell. Nodes
that are only predicted count apart. Where a size or a frame at rest is given, the numbers must be
those of the board, or those at rest. A frame is silent if a number is wrong and nothing says so; in
clutter also if a node is none of the board.
"""

import argparse
import contextlib
import dataclasses
import functools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple
from unittest import mock

import cv2
import numpy as np
from changed import CHANGED
from environment import DATA, main_of
from patterns import (
    SIDE,
    Open,
    Views,
    behind_bars,
    clutter,
    corners_in,
    crops,
    gels,
    in_motion,
    marked,
    open_patterns,
    photographs,
    picture,
    place,
    torn,
    torn_otherwise,
    without_end,
)
from scenes import View, photograph

from cmp_cl import Corners, Detector, DetectorConfig, Grid, NodeStatus, build_grid
from cmp_cl.errors import GridError
from cmp_cl.grid import build, choice
from cmp_cl.lattice import joins
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.plan import LatticePlan
from cmp_cl.opencl import program
from cmp_cl.opencl.program import source
from cmp_cl.synthetic.scoring import agreeing

SEED = 8_100_000  # of the report; constants were chosen on other frames
FEWER = 10  # --quick takes one frame in so many
HIT, SHARE = 3.0, 0.25  # px; of a cell
CROSSED = "(passes[h] || passes[end])"  # of links that are looked at
FEW = 0.002  # share of wrong numbers in a frame of an open pattern that counts as right
K = LatticeConstants()
# Constants that leave one idea out.
ABLATION: dict[str, dict[str, Any]] = {
    "all": {},
    "links whatever lies between": {"side_middle": -1e9},
    "links may cross": {"crossing": True},
    "faces need not agree": {"agree": 100.0, "cuts": 0, "torn_corners": 4},
    "contradicted parts are not cut": {"cuts": 0, "torn_corners": 4},
    "faces of torn corners agree as others": {"torn_corners": 4},
    "no joins across tears": {"join_votes": 1e9},
    "joins whatever the colours": {"join_votes": 0.0},
    "joins whatever the surface": {"factor": lambda energy: np.full(len(energy), 2.0)},
    "torn corners count as whole ones": {"rough_weight_per_px2": 1e9},
    "worn corners are where their neighbours say": {"worn_sigmas": 1e9},
    "torn corners are as likely": {"torn_nats": 0.0, "prior_nats": K.prior_nats - K.torn_nats},
    "no test of nodes": {"prior_nats": 1e6},
    "nodes whatever their sides": {"side_nats": 0.0, "prior_nats": K.prior_nats + 4 * K.side_nats},
    "sides are read near them only": {"deep_cells": K.side_depth_cells},
    "nodes whatever their cells": {"cells_nats": 0.0, "prior_nats": K.prior_nats + K.cells_nats},
    "nodes wherever they are": {"sd_cells": 1e3},
    "outer lines and whole boards hold what they hold": {"least_line": 0.0},
    "borders say nothing of numbers": {"end_nats": 1e-6, "bare_nats": 0.0},
    "prints say nothing of numbers": {"print_clip": 0.0},
    "motion says nothing of numbers": {"motion_nats": 0.0},
    "boards of few corners, and with gaps": {"few": 0.0, "gap": 1.0},
}
VERDICTS = ("right", "right, told", "refused", "wrong, told", "silent")


class Answer(NamedTuple):
    """Measured nodes: xy (M, 2), number (M, 2) as (row, column); how many are predicted; whether
    the grid has doubts, and whether its numbers are meant to be those of the whole board."""

    xy: np.ndarray
    number: np.ndarray
    predicted: int = 0
    doubts: bool = False
    sized: bool = False


Method = Callable[[View, Corners], Answer | None]  # None: it cannot be asked
NOTHING = Answer(np.zeros((0, 2)), np.zeros((0, 2), int))


def answer_of(grid: Grid, *, sized: bool = False) -> Answer:
    row, column = np.nonzero(grid.valid & (grid.status != NodeStatus.INTERPOLATED))
    predicted = int(np.count_nonzero(grid.status == NodeStatus.INTERPOLATED))
    number = np.stack([row, column], axis=1) + np.array(grid.origin)
    return Answer(grid.xy[row, column].astype(float), number, predicted, bool(grid.doubts), sized)


def of_grid(view: View, corners: Corners) -> Answer:
    return answer_of(build_grid(corners, view.image))


def of_grid_sized(view: View, corners: Corners) -> Answer | None:
    if view.whole is None:
        return None
    return answer_of(build_grid(corners, view.image, shape=view.whole), sized=True)


@contextlib.contextmanager
def changed(constants: dict[str, Any]) -> Iterator[None]:
    """Let `build_grid` use other constants, and another factor of the surface's bends at joins; and
    let links cross, if `crossing` is among them."""
    others = dict(constants)
    factor, crossing = others.pop("factor", joins.factor), others.pop("crossing", False)
    values = dataclasses.replace(K, **others)
    plan = functools.partial(LatticePlan, constants=values)
    with (
        mock.patch.object(choice, "K", values),
        mock.patch.object(build, "lattice_plan", plan),
        mock.patch.object(joins, "factor", factor),
        mock.patch.object(program, "source", crossed if crossing else program.source),
    ):
        yield


def crossed(stage: str, macros: Mapping[str, str] | None = None) -> str:
    """Return the text of a stage; in that of the lattice, links that others cross stay."""
    text = source(stage, macros)
    assert stage != "lattice" or CROSSED in text
    return text.replace(CROSSED, "false")


def calib_targets(view: View, _: Corners) -> Answer:
    import calib_targets as peer

    answer = peer.detect_chessboard(view.image)
    if answer is None:
        return NOTHING
    xy = [corner.position for corner in answer.corners]
    number = [(corner.grid.v, corner.grid.u) for corner in answer.corners]
    return Answer(np.reshape(xy, (-1, 2)), np.reshape(number, (-1, 2)).astype(int))


def sector_based(view: View, _: Corners) -> Answer:
    """Run cv2.findChessboardCornersSB with LARGER, beginning with the smallest board.

    It draws random numbers; the seed makes its answer the same in every run.
    """
    cv2.setRNGSeed(0)
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    hit, xy, meta = cv2.findChessboardCornersSBWithMeta(view.image, (3, 3), flags)
    if not hit:
        return NOTHING
    return Answer(xy.reshape(-1, 2).astype(np.float64), np.indices(meta.shape).reshape(2, -1).T)


def libcbdetect(view: View, _: Corners) -> Answer:
    """Return libcbdetect's largest board, with its own settings."""
    import libCBDetect as peer

    board = peer.Checkerboard()
    board.show_processing = False
    board.array_to_image(view.image.astype(np.float64).ravel(), *view.image.shape)
    board.find_corners()
    board.refine_corners()
    board.find_board_from_corners()
    x, y = np.zeros((2, board.rows * board.cols))
    if len(x):
        board.get_board_corners(x, y)
    return Answer(np.stack([x, y], axis=1), np.indices((board.rows, board.cols)).reshape(2, -1).T)


SIZED: dict[str, Method] = {"cmp_cl, size known": of_grid_sized}
OURS = {"cmp_cl": of_grid} | SIZED
PEERS: dict[str, Method] = {
    "calib-targets": calib_targets,
    "cv2 SB, LARGER": sector_based,
    "libcbdetect": libcbdetect,
}


class Family(NamedTuple):
    """Views from a seed, how many; whether a node that is none of the board makes a frame wrong."""

    views: Callable[[int, int], Views]
    frames: int
    alone: bool = False


FAMILIES: dict[str, Family] = {
    "whole gels": Family(gels, 54),
    "crops and windows": Family(crops, 56),
    "torn by rings": Family(torn, 40),
    "torn by other objects": Family(torn_otherwise, 40),
    "photographs, cut": Family(photographs, 60),
    **{name: Family(views, 60) for name, views in CHANGED.items()},
    "boards in clutter": Family(clutter, 75, alone=True),
    "boards behind bars": Family(behind_bars, 40),
    "boards in motion": Family(in_motion, 40),
    "marks in cells": Family(marked, 45),
    "without an end": Family(without_end, 20),
}


def scored(view: View, answer: Answer, *, alone: bool) -> dict[str, int]:
    """Return the nodes that are right, wrong, false and predicted, and the frame's verdict."""
    row = dict.fromkeys(("right", "wrong", "false"), 0) | {"predicted": answer.predicted}
    real = (np.abs(answer.xy) < 1e5).all(axis=1)
    xy, number = answer.xy[real], answer.number[real]
    if not len(xy):
        return row | {"frame": VERDICTS.index("refused")}
    away = np.abs(np.subtract.outer(xy @ [1, 1j], view.truth[:, :2] @ [1, 1j]))
    nearest, distance = away.argmin(axis=1), away.min(axis=1)
    hit = distance < HIT
    truth = view.truth[nearest[hit], 2:].astype(int)
    right = int(np.count_nonzero(agreeing(number[hit], truth)))
    of_board = hit.any() and view.whole and agreeing(number[hit], truth, view.whole).all()
    far = (distance >= max(HIT, SHARE * view.cell)) & view.counted(xy)
    wrong = int(np.count_nonzero(hit)) - right
    row |= {"right": right, "wrong": wrong, "false": int(np.count_nonzero(far))}
    bad = row["wrong"] > 0 or (answer.sized and not of_board) or (alone and row["false"] > 0)
    return row | {"frame": verdict(good=not bad, told=answer.doubts)}


def verdict(*, good: bool, told: bool) -> int:
    """Return the index among `VERDICTS`."""
    word = ("right" if good else "wrong") + ", told" if told else "right" if good else "silent"
    return VERDICTS.index(word)


def singles(
    methods: dict[str, Method], families: Iterable[str], seed: int, fewer: int
) -> Iterator[dict[str, Any]]:
    """Run every method on every view, and sum by family."""
    for name in families:
        family = FAMILIES[name]
        totals: dict[str, dict[str, Any]] = {}
        times: dict[str, list[tuple[float, float]]] = {}
        for view in family.views(seed, max(family.frames // fewer, 1)):
            corners, ms_detect = detected(view)
            for method, ask in methods.items():
                start = time.perf_counter()
                try:
                    answer = ask(view, corners)
                except GridError:
                    answer = NOTHING
                except ImportError:  # a peer that is not installed
                    continue
                if answer is None:
                    continue
                ms = 1e3 * (time.perf_counter() - start)
                times.setdefault(method, []).append((ms, ms_detect))
                score = scored(view, answer, alone=family.alone) | {"corners": len(view.truth)}
                add(totals.setdefault(method, new_row(name, method)), score)
        for method, total in totals.items():
            total["ms"], total["ms_detect"] = np.median(times[method], axis=0).tolist()
            yield total


def detected(view: View) -> tuple[Corners, float]:
    """Return the corners of a view, and the time that they took, ms."""
    config = DetectorConfig.for_cell(view.cell)
    with Detector(shape=view.image.shape, config=config) as detector:
        detector(view.image)  # the first call compiles
        start = time.perf_counter()
        return detector(view.image), 1e3 * (time.perf_counter() - start)


def new_row(family: str, method: str) -> dict[str, Any]:
    row: dict[str, Any] = {"family": family, "method": method}
    keys = ("frames", "corners", "right", "wrong", "false", "predicted")
    return row | dict.fromkeys((*keys, *(f"frames {word}" for word in VERDICTS)), 0)


# sizes, and frames at rest


def wrong_sizes(fewer: int) -> dict[str, Any]:
    """Ask for whole boards of photographs in a size that is wrong by one or two lines."""
    row = new_row("size wrong by a line or two", "cmp_cl, size known")
    names = [f"stereo_opencv/{each}{n:02}" for n in range(1, 6) for each in ("left", "right")]
    for name in names[:: min(fewer, 5)] if DATA.is_dir() else ():
        view = photograph(name)
        corners, _ = detected(view)
        for asked in ((6, 8), (5, 9), (5, 8), (4, 7), (7, 9), (6, 10), (7, 10)):
            row["frames"] += 1
            try:
                told = bool(build_grid(corners, view.image, shape=asked).doubts)
            except GridError:
                row["frames refused"] += 1
            else:
                row["frames wrong, told" if told else "frames silent"] += 1
    return row


def attempt(detector: Detector, case: Open, seed: int, **known: Any) -> Grid | None:
    image = picture(case, seed)
    try:
        return build_grid(detector(image), image, **known)
    except GridError:
        return None


def numbers_at(grid: Grid, case: Open) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers (M, 2) of the measured nodes, and the true ones there."""
    answer = answer_of(grid)
    u, v = place(case, *answer.xy.T)
    return answer.number, np.rint(np.stack([v, u], axis=1)).astype(int)


def judged(rest: Grid, first: Open, grid: Grid | None, case: Open) -> dict[str, int]:
    """Return the nodes right and wrong, and the verdict, of a frame like one at rest."""
    if grid is None or not grid.valid.any():
        return {"right": 0, "wrong": 0, "frame": VERDICTS.index("refused")}
    number, truth = numbers_at(rest, first)
    offset = np.median(truth - number, axis=0)
    number, truth = numbers_at(grid, case)
    wrong = int(np.count_nonzero((truth - number != offset).any(axis=1)))
    frame = verdict(good=wrong < FEW * len(number), told=grid.ambiguous)
    return {"right": len(number) - wrong, "wrong": wrong, "frame": frame}


def liked(seed: int, count: int) -> list[dict[str, Any]]:
    """Number open patterns like a frame at rest: alone, and after frames that lead there, between
    which the middle moves by .3 cells at most. One frame may turn by up to 60 degrees."""
    rows = [new_row("without an end, like", f"cmp_cl, {form}") for form in ("alone", "followed")]
    for number, case in enumerate(open_patterns(seed, count)):
        config = DetectorConfig.for_cell(case.cell)
        with Detector(shape=(SIDE, SIDE), config=config) as detector:
            rest = before = attempt(detector, case.at(0), seed)
            steps = max(1, int(np.ceil(np.hypot(*case.shift) / 0.3)))
            grids: list[Grid | None] = [None, None]
            if rest is not None and before is not None and rest.valid.any():
                grids[0] = attempt(detector, case, seed + number, like=rest)
                for step in range(1, steps + 1):
                    known = {"like": rest, "previous": before}
                    grids[1] = attempt(detector, case.at(step / steps), seed + step, **known)
                    before = grids[1] if grids[1] is not None and grids[1].valid.any() else before
        for row, grid in zip(rows, grids, strict=True):
            score = judged(rest, case.at(0), grid, case) if rest else {"frame": 2}
            add(row, score | {"corners": len(corners_in(case))})
    return rows


def film(seed: int, count: int) -> dict[str, Any]:
    """Follow a pattern without an end that turns, zooms and jumps by up to .45 cells a frame."""
    row = new_row("a film without an end", "cmp_cl, followed")
    draw = np.random.default_rng(seed + 5)
    case = first = Open(cell=12.0, wear=0.02, sheet=seed)
    with Detector(shape=(SIDE, SIDE), config=DetectorConfig.for_cell(12.0)) as detector:
        rest = before = attempt(detector, case, seed)
        for frame in range(count if rest is not None else 0):
            jump = draw.uniform(0, 0.45) * np.exp(1j * draw.uniform(0, 2 * np.pi))
            case = case._replace(
                shift=(case.shift[0] + jump.real, case.shift[1] + jump.imag),
                zoom=1 + 0.1 * np.sin(frame / 17),
                rotation=25 * np.sin(frame / 40),
            )
            grid = attempt(detector, case, seed + frame, like=rest, previous=before)
            add(row, judged(rest, first, grid, case) | {"corners": len(corners_in(case))})
            before = grid if grid is not None and grid.valid.any() else before
    return row


def add(row: dict[str, Any], score: dict[str, int]) -> None:
    row["frames"] += 1
    row[f"frames {VERDICTS[score['frame']]}"] += 1
    for key in ("corners", "right", "wrong", "false", "predicted"):
        row[key] += score.get(key, 0)


def numbered(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    if arguments.ablation:
        return
    fewer = FEWER if arguments.quick else 1
    yield from singles(OURS | PEERS, arguments.families or FAMILIES, arguments.seed, fewer)
    if not arguments.families:
        yield wrong_sizes(fewer)
        yield from liked(arguments.seed, max(120 // fewer, 1))
        yield film(arguments.seed, max(360 // fewer, 1))


def ablation(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the rows of each idea, as a method, in each family; times say nothing here."""
    seed, fewer = arguments.seed, FEWER if arguments.quick else 1
    methods = {idea: changed(each)(of_grid) for idea, each in ABLATION.items()}
    yield from singles(methods, arguments.families or FAMILIES, seed, fewer)
    for idea, constants in () if arguments.families else ABLATION.items():
        with changed(constants):
            rows = list(singles(SIZED, ["photographs, cut"], seed, fewer))
            rows += wrong_sizes(fewer), *liked(seed, max(40 // fewer, 1))
        for row in rows:
            family = row["family"] + row["method"].removeprefix("cmp_cl")
            yield row | {"family": family, "method": idea}


OPTIONS: dict[str, dict[str, Any]] = {
    "seed": {"type": int, "default": SEED, "help": "of the first frames"},
    "ablation": {"action": "store_true", "help": "only each idea left out"},
    "families": {"nargs": "+", "choices": FAMILIES, "help": "only these"},
}
TABLES = {"numbering": numbered, "ablation": ablation}
main = main_of(__doc__, TABLES, quick="a tenth of the frames", options=OPTIONS)

if __name__ == "__main__":
    raise SystemExit(main())
