"""Numbering by the frame at rest, without a border of the pattern in view.

    python bench/open_patterns.py           writes results/open_patterns.json
    python bench/open_patterns.py --drawn 200 --seed 900000         other frames, drawn by chance

The rendered checkerboards continue beyond all four edges of the image. They are zoomed, rotated,
moved or bent by a wave, with a hole in the print or an object in front of it. Half of the prints
are perfect; the others have printing errors, which move with the pattern. Each frame is numbered
like the frame at rest, alone and with the help of the previous frame. A frame is wrong if more than
one measured node in 500 has a wrong number, and silently wrong if the grid is not marked ambiguous.
No peer can use a frame at rest. On some frames two results of the peers are compared: whether their
nodes are corners, and whether their numbers fit one lattice.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import environment, parser_of, write_result
from partial_views import Found, View, agreeing, each_answer

from cmp_cl import Detector, DetectorConfig, build_grid
from cmp_cl.errors import GridError
from cmp_cl.grid import Grid
from cmp_cl.grid.grid import MEASURED
from cmp_cl.image import GreyImage

SIDE = 400  # px, of the pictures
SAMPLES = 3  # of a pixel, along each axis
NOISE = 2.0  # grey levels
PERIOD = 256  # cells, after which the printing errors repeat
WEAR = 0.03  # cells: standard deviation of the errors of a worn print
EACH = 14  # the peers get one frame in so many
NEAR = 0.25  # cells: a node that is farther from all corners is false


class Case(NamedTuple):
    """A frame: cell at rest, px; zoom; rotation, degrees; shift, cells of the frame at rest; wave,
    cells; hole: 6 cells wide, none, of the print or in front of it; wear: standard deviation of
    the printing errors, cells; noise: grey levels; print_seed: of the printing errors."""

    cell: float = 10.0
    zoom: float = 1.0
    rotation: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    wave: float = 0.0
    hole: str = "none"
    wear: float = 0.0
    noise: float = NOISE
    print_seed: int = 1

    @property
    def group(self) -> str:
        if np.hypot(*self.shift):
            alias = self.shift[0] % 1 == 0 and self.shift[1] % 1 == 0 and not sum(self.shift) % 2
            kind = "shifted by a period" if alias else "shifted"
        elif self.rotation:
            kind = "turned"
        elif self.wave:
            kind = "waved"
        else:
            kind = "zoomed" if self.zoom != 1 else "still"
        return kind + (", worn print" if self.wear else "")


def cases(*, quick: bool = False) -> Iterator[Case]:
    """Yield the frames of the report."""
    for wear in (0.0, WEAR):
        for cell in (10.0,) if quick else (9.0, 10.0, 13.0):
            yield Case(cell, wear=wear)
            for hole in ("none",) if quick else ("none", "print" if cell == 9 else "front"):
                for zoom in (0.9, 0.91, 0.94, 0.97, 1.03, 1.06, 1.08, 1.1):
                    yield Case(cell, zoom, hole=hole, wear=wear)
                for rotation in (2, 4, 5, 15, 30):
                    yield Case(cell, 1.0, rotation, hole=hole, wear=wear)
                for length in (0.2, 0.4, 0.6, 0.8, 1.2, 1.6, 2.3, 3.7):
                    yield Case(cell, shift=(length, 0), hole=hole, wear=wear)
                    yield Case(cell, shift=(length, 0.7 * length), hole=hole, wear=wear)
            yield Case(cell, 0.96, 4, wear=wear)
            yield Case(cell, 1.05, -10, (0.7, -0.4), wear=wear)
            for wave in (0.5, 1.5):
                yield Case(cell, wave=wave, wear=wear)
                yield Case(cell, 0.97, wave=wave, wear=wear)
                yield Case(cell, wave=wave, shift=(1.3, 0.4), wear=wear)
            for shift in ((1, 1), (2, 0), (3, 1)):
                yield Case(cell, shift=shift, wear=wear)


def drawn(count: int, seed: int) -> Iterator[Case]:
    """Return other frames, drawn by chance: cells, zooms, rotations, shifts, waves, holes and
    prints."""
    draw = np.random.default_rng(seed)
    for number in range(count):
        kind = draw.integers(4)  # a shift by a period, a small one, a large one, none
        across, down = draw.integers(-6, 7, 2)
        length = (0, draw.uniform(0, 0.7), draw.uniform(0, 6), 0)[kind]
        turn = np.exp(1j * draw.uniform(0, 2 * np.pi))
        period = (float(across), float(down + (across + down) % 2))
        yield Case(
            cell=float(draw.uniform(6.5, 20)),
            zoom=float(draw.choice([1, draw.uniform(0.88, 1.12)])),
            rotation=float(draw.choice([0, draw.uniform(-12, 12), draw.uniform(-60, 60)])),
            shift=period if kind == 0 else (float(length * turn.real), float(length * turn.imag)),
            wave=float(draw.choice([0, draw.uniform(0, 1.2)])),
            hole=str(draw.choice(["none", "print", "front"])),
            wear=float(draw.choice([0, draw.uniform(0, 0.05)])),
            noise=float(draw.uniform(0.5, 6)),
            print_seed=seed + number,
        )


class Print:
    """A checkerboard without end, with the errors of its print: (u, v) are cells."""

    def __init__(self, seed: int, wear: float) -> None:
        error = np.random.default_rng(seed).normal(0, wear, (2, PERIOD, PERIOD))
        across, down = (np.pad(each, ((0, 1), (0, 1)), mode="wrap") for each in error)
        self._error = np.dstack([across, down]).astype(np.float32)
        self._perfect = wear == 0

    def printed(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the position of the ink of (u, v), moved by printing errors that are linear within
        cells."""
        if self._perfect:
            return u, v
        around = u - PERIOD * np.floor(u / PERIOD), v - PERIOD * np.floor(v / PERIOD)
        off = cv2.remap(self._error, *around, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return u + off[..., 0], v + off[..., 1]


def place(case: Case, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the point (u, v) of the pattern, cells, that a pixel shows."""
    across, down = (
        x - SIDE / 2 - case.shift[0] * case.cell,
        y - SIDE / 2 - case.shift[1] * case.cell,
    )
    if case.wave:
        phase = 2 * np.pi * ((x - SIDE / 2) / 210 + (y - SIDE / 2) / 330 + 0.13)
        wave = case.wave * case.cell * np.sin(phase)
        across, down = across - wave, down - 0.4 * wave
    turned = np.exp(-1j * np.deg2rad(case.rotation)) / (case.zoom * case.cell)
    back, aside = float(turned.real), float(turned.imag)
    return back * across - aside * down + 0.37, aside * across + back * down + 0.21


def clean_picture(case: Case) -> np.ndarray:
    """Return the grey levels of a frame without noise, (SIDE, SIDE) float32."""
    steps = (np.arange(SIDE * SAMPLES, dtype=np.float32) + np.float32(0.5)) / SAMPLES - 0.5
    x, y = steps[None].astype(np.float32), steps[:, None].astype(np.float32)
    if case.wave:  # else rows and columns broadcast
        x, y = np.broadcast_arrays(x, y)
    u, v = (each.astype(np.float32) for each in place(case, x, y))
    across, down = Print(case.print_seed, case.wear).printed(u, v)
    black = (np.floor(across).astype(np.int32) + np.floor(down).astype(np.int32)) & 1 == 0
    level = np.where(black, np.float32(45), np.float32(205))
    if case.hole == "print":
        level[np.square(u - 6) + np.square(v + 4) < 9] = 120
    elif case.hole == "front":
        level[np.square(x - 240) + np.square(y - 160) < (3 * case.cell) ** 2] = 30
    return cv2.resize(level, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def noisy(level: np.ndarray, case: Case, seed: int) -> GreyImage:
    """Return the frame, (SIDE, SIDE) uint8."""
    noise = np.random.default_rng(seed).standard_normal(level.shape, dtype=np.float32)
    return np.clip(np.rint(level + np.float32(case.noise) * noise), 0, 255).astype(np.uint8)


def picture(case: Case, seed: int) -> GreyImage:
    """Return the frame, (SIDE, SIDE) uint8."""
    return noisy(clean_picture(case), case, seed)


def rest_of(case: Case) -> Case:
    return Case(
        case.cell,
        hole=case.hole,
        wear=case.wear,
        noise=case.noise,
        print_seed=case.print_seed,
    )


def true_numbers(grid: Grid, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers (M, 2) of the measured nodes, and the nearest corners (M, 2) of the pattern
    there."""
    row, column = np.nonzero(np.isin(grid.status, MEASURED))
    u, v = place(case, *grid.xy[row, column].astype(np.float64).T)
    number = np.stack([row + grid.origin[0], column + grid.origin[1]], axis=1)
    return number, np.rint(np.stack([v, u], axis=1)).astype(int)


def verdict(rest: Grid, rest_case: Case, grid: Grid | None, case: Case) -> str:
    """Return right or wrong, and whether the grid is ambiguous; refused without a grid."""
    if grid is None or not grid.valid.any():
        return "refused"
    number, corner = true_numbers(rest, rest_case)
    offset = np.median(corner - number, axis=0)
    number, corner = true_numbers(grid, case)
    wrong = np.any(corner - number != offset, axis=1).mean()
    if grid.ambiguous:
        return "right, ambiguous" if wrong < 0.002 else "wrong, ambiguous"
    return "right" if wrong < 0.002 else "silently wrong"


def attempt(**given: Any) -> Grid | None:
    try:
        return build_grid(**given)
    except GridError:
        return None


def answers(every: Sequence[Case]) -> list[dict[str, Any]]:
    """Return each frame's verdict: by the frame at rest alone, and after frames that lead to it."""
    rows = []
    rests: dict[Case, Grid] = {}
    for number, case in enumerate(every):
        config = DetectorConfig.for_cell(case.cell)
        with Detector(shape=(SIDE, SIDE), config=config) as detector:
            at_rest = rest_of(case)
            if at_rest not in rests:
                image = picture(at_rest, 5000)
                grid = attempt(corners=detector(image), image=image)
                if grid is None:
                    rows.append({**case._asdict(), "group": "no frame at rest", **NO_REST})
                    continue
                rests[at_rest] = grid
            rest = rests[at_rest]
            level = clean_picture(case)
            image = noisy(level, case, 6000 + number)
            corners = detector(image)
            alone = attempt(corners=corners, image=image, like=rest)
            rows.append(
                {
                    **case._asdict(),
                    "group": case.group,
                    "corners": len(corners),
                    "nodes": 0 if alone is None else int(alone.valid.sum()),
                    "alone": verdict(rest, at_rest, alone, case),
                    "followed": followed(detector, rest, case, level, 7000 + number),
                }
            )
    return rows


def followed(detector: Detector, rest: Grid, case: Case, level: np.ndarray, seed: int) -> str:
    """Return the verdict on the last of frames between which the pattern moves by 0.3 cells at
    most.

    level: grey levels of the last one, without noise.
    """
    steps = max(1, int(np.ceil(np.hypot(*case.shift) / 0.3)))
    before = rest
    grid: Grid | None = None
    for step in range(1, steps + 1):
        part = step / steps
        now = case._replace(
            zoom=1 + (case.zoom - 1) * part,
            rotation=case.rotation * part,
            shift=(case.shift[0] * part, case.shift[1] * part),
            wave=case.wave * part,
        )
        clean = level if step == steps else clean_picture(now)
        image = noisy(clean, now, seed + 1000 * step)
        grid = attempt(corners=detector(image), image=image, like=rest, previous=before)
        if grid is not None and grid.valid.any():
            before = grid
    return verdict(rest, rest_of(case), grid, case)


def visible(case: Case) -> int:
    """Count the corners of the pattern that a frame shows."""
    y, x = np.indices((SIDE, SIDE), np.float32)
    u, v = place(case, x, y)
    seen = np.hypot(u - np.rint(u), v - np.rint(v)) * case.cell * case.zoom < 0.75
    if case.hole == "print":
        seen &= np.hypot(u - 6, v + 4) >= 3
    elif case.hole == "front":
        seen &= np.hypot(x - 240, y - 160) >= 3 * case.cell
    return len(np.unique(np.rint([u[seen], v[seen]]), axis=1).T)


def lattices(every: Sequence[Case]) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return the answer of each method to single frames, and why some methods did not run."""
    totals: dict[str, dict[str, int]] = {}
    reasons: dict[str, str] = {}
    for number, case in enumerate(every):
        view = View(
            str(number),
            picture(case, 6000 + EACH * number),
            np.zeros((0, 4)),
            np.ones((SIDE, SIDE), np.bool_),
            case.cell * case.zoom,
            None,
        )
        for name, answer in each_answer(view, reasons):
            total = totals.setdefault(name, {})
            for key, value in scored(case, answer).items():
                total[key] = total.get(key, 0) + value
    return [{"method": name, **total} for name, total in totals.items()], reasons


def scored(case: Case, answer: Found) -> dict[str, int]:
    """Return the frames right, refused and wrong, the corners in view, and the nodes right and
    false."""
    row = {"frames": 1, "corners": visible(case)}
    row |= dict.fromkeys(("right", "false", "frames right", "refused", "silently wrong"), 0)
    real = (np.abs(answer.xy) < 1e5).all(axis=1)
    if not real.any():
        return row | {"refused": 1}
    at = np.stack(place(case, *answer.xy[real].T), axis=1)[:, ::-1]
    corner = np.rint(at).astype(int)
    near = np.linalg.norm(at - corner, axis=1) < NEAR
    row["false"] = int(np.count_nonzero(~near) + np.count_nonzero(~real))
    number = np.asarray(answer.number)[real][near]
    row["right"], _ = agreeing(number, corner[near], NO_VIEW)
    kind = "frames right" if row["right"] >= 0.998 * len(answer.xy) else "silently wrong"
    return row | {kind: 1}


NO_VIEW = View("", np.zeros((0, 0), np.uint8), np.zeros((0, 4)), np.zeros((0, 0), bool), 0.0, None)
NO_REST = {"alone": "refused", "followed": "refused"}
VERDICTS = ("right", "right, ambiguous", "wrong, ambiguous", "refused", "silently wrong")


def counted(rows: Sequence[dict[str, Any]], form: str) -> dict[str, dict[str, int]]:
    """Return how many frames of each group have each verdict."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        group = found.setdefault(row["group"], dict.fromkeys(VERDICTS, 0))
        group[row[form]] += 1
    return found


def show(rows: Sequence[dict[str, Any]]) -> None:
    for form in ("alone", "followed"):
        print(f"\nlike the frame at rest, {form}")
        print(f"{'frames':34}" + "".join(f"{word:>19}" for word in VERDICTS))
        for group, count in counted(rows, form).items():
            print(f"{group:34}" + "".join(f"{count[word]:19}" for word in VERDICTS))


def show_peers(rows: Sequence[dict[str, Any]]) -> None:
    keys = [key for key in rows[0] if key != "method"]
    print(f"\n{'one lattice, single frames':34}" + "".join(f"{key:>14}" for key in keys))
    for row in rows:
        print(f"{row['method']:34}" + "".join(f"{row[key]:14}" for key in keys))


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="a third of the frames")
    parser.add_argument("--drawn", type=int, metavar="N", help="N frames drawn by chance instead")
    parser.add_argument("--seed", type=int, default=900_000, help="of what is drawn by chance")
    arguments = parser.parse_args(argv)
    asked = cases(quick=arguments.quick)
    if arguments.drawn is not None:
        asked = drawn(arguments.drawn, arguments.seed)
    asked = list(asked)
    rows = answers(asked)
    show(rows)
    if arguments.drawn is not None:
        return 0
    peers, reasons = lattices(asked[::EACH])
    show_peers(peers)
    result = {
        "kind": "open_patterns",
        "environment": environment(),
        "noise": NOISE,
        "wear": WEAR,
        "counts": {form: counted(rows, form) for form in ("alone", "followed")},
        "lattices": peers,
        "unavailable": reasons,
        "rows": rows,
    }
    write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
