"""Boards in front of busy backgrounds, and patterns with a mirror in the view.

    python bench/surroundings.py            writes results/surroundings.json
    python bench/surroundings.py --first 900000 --show        other scenes

There are rendered boards in front of a plain ground, squares, keys, bars and noise, with and
without their size. There are rendered patterns that a mirror continues: along a line of cells,
nearly so, anywhere, and along a diagonal; on worn prints and perfect ones; alone, and like a frame
at rest without the mirror. The same views without the mirror show false alarms. An answer is wrong
if one of its nodes is no corner of the pattern itself or has a wrong number. It is silently wrong
if it carries no warning.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import environment, parser_of, write_result
from open_patterns import Case, Print, place
from partial_views import METHODS, Found, View, agreeing, each_answer, found

from cmp_cl import Detector, DetectorConfig, build_grid
from cmp_cl.errors import GridError
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage

FIRST = 31_000  # the first scene's seed
BOARDS, MIRRORS = 75, 80
QUICK = 5  # times fewer in the short form
HIGH, WIDE = 420, 560  # px, of the boards' pictures
SIDE = 400  # px, of the mirrors' pictures
SAMPLES = 3  # of a pixel, along each axis
NEAR = 0.25  # cells: a node farther from all corners is false
REFLECTED = 3  # nodes of a reflection that do not count: they may lie on the mirror's edge
GROUNDS = ("plain", "squares", "keys", "bars", "noise")
EDGES = ("along a line of cells", "nearly so", "anywhere", "along a diagonal")
VERDICTS = (
    "right",
    "right, with a warning",
    "refused",
    "wrong, with a warning",
    "background alone",
    "silently wrong",
)


# boards before a background


def background(kind: str, draw: np.random.Generator) -> np.ndarray:
    """Return grey levels of a background, (HIGH, WIDE) times SAMPLES, float32."""
    high, wide = HIGH * SAMPLES, WIDE * SAMPLES
    size = int(draw.uniform(12, 40) * SAMPLES)
    dark, bright = draw.uniform(30, 110), draw.uniform(130, 230)
    level = np.full((high, wide), dark).astype(np.uint8)
    if kind == "squares":
        y, x = np.indices((high, wide), np.float32)
        turn = np.exp(1j * draw.uniform(-0.5, 0.5))
        u, v = x * turn.real + y * turn.imag, y * turn.real - x * turn.imag
        level[(np.floor(u / size) + np.floor(v / size)) % 2 == 0] = bright
    elif kind == "keys":
        for top in range(size // 8, high, size):
            for left in range(int(draw.integers(-size, 0)), wide, size):
                end = left + int(0.8 * size), top + int(0.8 * size)
                cv2.rectangle(level, (left, top), end, dark + 40, -1)
                letter = chr(int(draw.integers(65, 91)))
                cv2.putText(level, letter, (left + 9, end[1] - 9), 0, size / 50, bright, 4)
    elif kind == "bars":
        for top in range(0, high, 2 * size):
            left = 0
            while left < wide:
                end = left + int(draw.uniform(8, 40))
                cv2.rectangle(
                    level, (left, top), (end, top + 2 * size - 9), draw.uniform(20, 240), -1
                )
                left = end
    elif kind == "noise":
        rough = draw.uniform(20, 235, (high // 16, wide // 16)).astype(np.uint8)
        level = cv2.resize(rough, (wide, high), interpolation=cv2.INTER_NEAREST)
    return level.astype(np.float32)


def board(seed: int) -> tuple[str, View]:
    """Return the background, and a view of a board before it."""
    draw = np.random.default_rng(seed)
    kind = GROUNDS[seed % len(GROUNDS)]
    rows, columns = int(draw.integers(4, 11)), int(draw.integers(5, 13))
    columns += rows == columns
    cell = draw.uniform(0.35, 0.8) * min(WIDE / (columns + 1), HIGH / (rows + 1))
    turn = np.exp(1j * draw.choice([draw.normal(0, 0.15), draw.uniform(-np.pi, np.pi)]))
    turn *= cell
    moved = np.array([[turn.real, -turn.imag, 0], [turn.imag, turn.real, 0], [0, 0, 1]])
    tilt = np.eye(3)
    tilt[2, :2] = draw.normal(0, 0.0009, 2)  # perspective
    middle = np.array([WIDE / 2 + draw.normal(0, 60), HIGH / 2 + draw.normal(0, 45)])
    shift = np.eye(3)
    shift[:2, 2] = middle
    to_view = shift @ tilt @ moved

    steps = [(np.arange(n * SAMPLES) + 0.5) / SAMPLES - 0.5 for n in (WIDE, HIGH)]
    x, y = np.meshgrid(*steps)
    across, down, scale = np.tensordot(np.linalg.inv(to_view), [x, y, np.ones_like(x)], 1)
    across, down = across / scale + (columns + 1) / 2, down / scale + (rows + 1) / 2

    def within(margin: float) -> np.ndarray:
        inside = (across > -margin) & (across < columns + 1 + margin) & (scale > 0)
        return inside & (down > -margin) & (down < rows + 1 + margin)

    level = background(kind, draw)
    level[within(float(draw.choice([0, 0.3, 1, 2])))] = paper = draw.uniform(140, 240)
    black = (np.floor(across) + np.floor(down)) % 2 == draw.integers(2)
    level[within(0) & black] = draw.uniform(10, 60)
    level[within(0) & ~black] = paper
    small = cv2.resize(level, (WIDE, HIGH), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), draw.uniform(0.5, 1))
    noisy = small + draw.uniform(1, 5) * draw.standard_normal(small.shape)

    row, column = np.indices((rows, columns)).reshape(2, -1)
    flat = np.stack([column - (columns - 1) / 2, row - (rows - 1) / 2, np.ones(row.size)])
    x, y, scale = to_view @ flat
    truth = np.stack([x / scale, y / scale, row, column], axis=1)
    image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    return kind, View(str(seed), image, truth, np.ones(image.shape, bool), cell, (rows, columns))


def board_verdict(view: View, answer: Found) -> str:
    """Return the verdict on the nodes; `background alone` if none of them is the board's."""
    if not len(answer.xy):
        return "refused"
    away = np.linalg.norm(answer.xy[:, None] - view.truth[None, :, :2], axis=2)
    near = away.min(axis=1) < max(3, NEAR * view.cell)
    warned = ", with a warning" * answer.doubts
    if not near.any():
        return "wrong, with a warning" if warned else "background alone"
    corner = view.truth[away.argmin(axis=1)[near], 2:].astype(int)
    right, identity = agreeing(answer.number[near], corner, view)
    good = right == len(answer.xy) and (identity or not answer.sized)
    if good:
        return "right" + warned
    return "wrong, with a warning" if warned else "silently wrong"


def boards(first: int, count: int, reasons: dict[str, str]) -> list[dict[str, Any]]:
    """Return how many answers of each method have each verdict, by background."""
    counts: dict[tuple[str, str], dict[str, int]] = {}
    for seed in range(first, first + count):
        kind, view = board(seed)
        for name, answer in each_answer(view, reasons):
            group = counts.setdefault((kind, name), dict.fromkeys(VERDICTS, 0))
            group[board_verdict(view, answer)] += 1
    order = sorted(counts, key=lambda key: (GROUNDS.index(key[0]), list(METHODS).index(key[1])))
    return [{"ground": key[0], "method": key[1], **counts[key]} for key in order]


# mirrors


class Mirror(NamedTuple):
    """Its edge: a point (x, y), px, the direction of its normal, rad; how bright it is.

    What lies beyond the edge along the normal is a reflection.
    """

    x: float
    y: float
    normal: float
    bright: float

    def reflected(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the depth in the mirror, px, and the points that are seen there."""
        across, down = np.cos(self.normal), np.sin(self.normal)
        depth = (x - self.x) * across + (y - self.y) * down
        behind = np.maximum(depth, 0)
        return depth, x - 2 * behind * across, y - 2 * behind * down


def mirror_scene(seed: int) -> tuple[int, Case, Mirror]:
    """Return the kind of edge, a pattern past all edges of the picture, and a mirror."""
    draw = np.random.default_rng(seed)
    edge = seed % len(EDGES)
    case = Case(
        cell=float(draw.uniform(10, 20)),
        rotation=float(draw.choice([0, draw.uniform(-8, 8)])),
        wave=float(draw.choice([0, draw.uniform(0, 0.8)])),
        wear=float(draw.choice([0, 0.015, 0.03, 0.05])),
        print_seed=seed,
    )
    angle = np.pi / 2 * draw.integers(4) + (np.pi / 4 if edge == 3 else 0)
    point = SIDE / 2 * (1 + 1j) + draw.uniform(-0.1, 0.6) * SIDE / 2 * np.exp(1j * angle)

    def at(point: complex) -> np.ndarray:
        return np.array(place(case, np.array(point.real), np.array(point.imag)), float)

    slope = np.stack([at(point + d) - at(point - d) for d in (0.5, 0.5j)], axis=1)
    normal = np.rint(np.array([np.cos(angle), np.sin(angle)]))  # on the pattern
    slack = float((draw.uniform(-0.02, 0.02), *draw.uniform(-0.12, 0.12, 2))[min(edge, 2)])
    value = normal @ at(point)
    if edge == 2:
        slack = draw.uniform(-0.5, 0.5)
    line = 2 * np.round(value / 2) if edge == 3 else np.floor(value) + 0.5
    move = np.linalg.solve(slope, normal * (line - value + slack) / (normal @ normal))
    across, down = slope.T @ normal
    tilt = np.deg2rad(draw.choice([0, draw.normal(0, 0.5), draw.normal(0, 2)]))
    x, y = point.real + move[0], point.imag + move[1]
    bright = float(draw.choice([1, 0.75]))
    return edge, case, Mirror(float(x), float(y), float(np.arctan2(down, across) + tilt), bright)


def picture(case: Case, mirror: Mirror | None, seed: int) -> GreyImage:
    """Return the view, (SIDE, SIDE) uint8."""
    steps = ((np.arange(SIDE * SAMPLES) + 0.5) / SAMPLES - 0.5).astype(np.float32)
    x, y = np.meshgrid(steps, steps)
    depth = np.zeros_like(x)
    if mirror is not None:
        depth, x, y = mirror.reflected(x, y)
    u, v = (each.astype(np.float32) for each in place(case, x, y))
    u, v = Print(case.print_seed, case.wear).printed(u, v)
    black = (np.floor(u).astype(np.int32) + np.floor(v).astype(np.int32)) & 1 == 0
    level = np.where(black, np.float32(45), np.float32(205))
    if mirror is not None:
        level[depth > 0] *= mirror.bright
    small = cv2.GaussianBlur(
        cv2.resize(level, (SIDE, SIDE), interpolation=cv2.INTER_AREA), (0, 0), 0.7
    )
    noise = np.random.default_rng(seed).standard_normal(small.shape)
    return np.clip(np.rint(small + case.noise * noise), 0, 255).astype(np.uint8)


def mirror_verdict(case: Case, mirror: Mirror | None, grid: Grid | None, rest: Grid | None) -> str:
    """Return the verdict: are the nodes the pattern's own, with their numbers at rest?"""
    if grid is None or not grid.valid.any():
        return "refused"
    number, corner, real = _numbers(case, mirror, grid)
    if not real.any():
        return "wrong, with a warning" if grid.doubts else "silently wrong"
    if rest is None:
        truth = np.column_stack([np.zeros_like(corner), corner])[:, 2:]
        agreed, _ = agreeing(number[real], truth[real], NO_VIEW)
    else:
        before, there, _ = _numbers(case, None, rest)
        offset = np.median(there - before, axis=0)
        agreed = int((corner - number == offset).all(axis=1)[real].sum())
    good = agreed >= 0.98 * real.sum() and np.count_nonzero(~real) <= REFLECTED
    if grid.doubts:
        return ("right" if good else "wrong") + ", with a warning"
    return "right" if good else "silently wrong"


def _numbers(
    case: Case, mirror: Mirror | None, grid: Grid
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return measured nodes' numbers, the pattern's corners there, and which are no reflection."""
    answer = found(grid)
    x, y = answer.xy.T
    u, v = place(case, x, y)
    real = np.ones(len(x), bool) if mirror is None else mirror.reflected(x, y)[0] <= 1
    return answer.number, np.rint(np.stack([v, u], axis=1)).astype(int), real


NO_VIEW = View("", np.zeros((0, 0), np.uint8), np.zeros((0, 4)), np.zeros((0, 0), bool), 0.0, None)


def mirrors(first: int, count: int) -> list[dict[str, Any]]:
    """Return how many grids have each verdict, by the mirror's edge and by the print."""
    counts: dict[tuple[str, str, str], dict[str, int]] = {}
    for seed in range(first, first + count):
        edge, case, mirror = mirror_scene(seed)
        printed = "worn print" if case.wear else "perfect print"
        with Detector(shape=(SIDE, SIDE), config=DetectorConfig.for_cell(case.cell)) as detector:

            def numbered(
                seen: Mirror | None,
                noise: int,
                rest: Grid | None = None,
                *,
                detector: Detector = detector,
                case: Case = case,
            ) -> Grid | None:
                image = picture(case, seen, noise)
                try:
                    return build_grid(detector(image), image, like=rest)
                except GridError:
                    return None

            rest = numbered(None, seed)
            answers = [
                (EDGES[edge], "alone", mirror, numbered(mirror, seed + 1), None),
                ("no mirror", "alone", None, rest, None),
            ]
            if rest is not None and rest.valid.any():
                liked = numbered(mirror, seed + 1, rest)
                answers.append((EDGES[edge], "like the frame at rest", mirror, liked, rest))
        for words, form, seen, grid, at_rest in answers:
            group = counts.setdefault((words, printed, form), dict.fromkeys(VERDICTS, 0))
            group[mirror_verdict(case, seen, grid, at_rest)] += 1
    order = sorted(counts, key=lambda key: ((*EDGES, "no mirror").index(key[0]), *key[1:]))
    head = ("mirror", "print", "numbered")
    return [{**dict(zip(head, key, strict=True)), **counts[key]} for key in order]


def show(rows: Sequence[dict[str, Any]]) -> None:
    words = [key for key in rows[0] if key not in VERDICTS]
    print("".join(f"{key:24}" for key in words) + "".join(f"{key:>23}" for key in VERDICTS))
    for row in rows:
        line = "".join(f"{row[key]:24}" for key in words)
        print(line + "".join(f"{row[key]:23}" for key in VERDICTS))


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="a fifth of the scenes")
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the first scene")
    parser.add_argument("--show", action="store_true", help="write no file")
    arguments = parser.parse_args(argv)
    reasons: dict[str, str] = {}
    fewer = QUICK if arguments.quick else 1
    result = {
        "kind": "surroundings",
        "environment": environment(),
        "boards": boards(arguments.first, BOARDS // fewer, reasons),
        "mirrors": mirrors(arguments.first, MIRRORS // fewer),
        "unavailable": reasons,
    }
    show(result["boards"])
    show(result["mirrors"])
    if not arguments.show:
        write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
