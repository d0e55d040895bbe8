"""Attacks on the numbers that a frame takes from the one before it: what is accepted, and wrong.

    python bench/tracking.py --quick       some minutes
    python bench/tracking.py               2100 jumps, twenty minutes

A board of 24 x 24 corners is drawn at rest, once more after a small motion, and then after a jump
that no camera should see: the frames in between are missing. The detector finds the corners, so
there are false ones from the surround, and missing ones. Each kind of jump is made for a weakness
of tracking:

    jump            shift, turn and zoom of the whole board, up to three cells
    slip            each of the 40 of whole cells of the right colour, up to four, in turn: every
                    corner is where one was
    push            parts of the board, by up to three cells in their middle, steep
    wide push       the same, wider and less steep
    hidden slip     a slip, and an object hides one of its sides
    slip at squares a slip, and squares like those of the board appear beside it
"""

import collections
import dataclasses
import sys
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from environment import parser_of, write_table

from cmp_cl import DetectorConfig, GridError, NodeStatus, select_device
from cmp_cl.cli.messages import Progress
from cmp_cl.image import GreyImage
from cmp_cl.measure import OneView

NODES, CELL, SIZE, FINE = 24, 15.0, 480, 2
WRONG = 0.35  # cells from its node that a corner has the number of
KINDS = ("jump", "slip", "push", "wide push", "hidden slip", "slip at squares")
GROUPS, EACH = 14, 25  # frames at rest, and jumps from each
SLIPS = [
    (across, down)
    for across in range(-4, 5)
    for down in range(-4, 5)
    if (across + down) % 2 == 0 and (across or down)
]  # cells
y, x = (np.mgrid[: SIZE * FINE, : SIZE * FINE] + 0.5) / FINE - 0.5
Push = tuple[float, float, float, float, float]  # column, row, its motion, and its width, cells


@dataclasses.dataclass(frozen=True)
class Pose:
    """shift: of the middle, cells. turn: rad. pushes: of parts of the board."""

    shift: np.ndarray
    turn: float
    zoom: float
    pushes: tuple[Push, ...] = ()

    @property
    def matrix(self) -> np.ndarray:
        """From cells to px."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return np.array([[c, -s], [s, c]]) * CELL * self.zoom

    @property
    def middle(self) -> np.ndarray:
        """Where the middle of the board is, px."""
        return SIZE / 2 + self.shift * CELL

    def pushed(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far the board has moved at these places of the image, in cells."""
        du, dv = np.zeros_like(u), np.zeros_like(v)
        for column, row, along, down, width in self.pushes:
            near = np.exp(-((u - column) ** 2 + (v - row) ** 2) / (2 * width**2))
            du, dv = du + along * near, dv + down * near
        return du, dv

    def cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Column and row of the board at each fine pixel."""
        u, v = (
            np.einsum(
                "ij,j...->i...",
                np.linalg.inv(self.matrix),
                np.stack([x - self.middle[0], y - self.middle[1]]),
            )
            + (NODES - 1) / 2
        )
        du, dv = self.pushed(u, v)
        return u - du, v - dv

    def nodes(self) -> np.ndarray:
        """Where the nodes are, (24, 24, 2) px."""
        row, column = np.mgrid[:NODES, :NODES].astype(float)
        u, v = column, row
        for _ in range(60):
            du, dv = self.pushed(u, v)
            u, v = column + du, row + dv
        return (np.stack([u, v], axis=2) - (NODES - 1) / 2) @ self.matrix.T + self.middle


def drawn(
    pose: Pose,
    surround: np.ndarray,
    rng: np.random.Generator,
    hidden: np.ndarray | None = None,
    squares: tuple[int, int] | None = None,
) -> GreyImage:
    """Return a picture. hidden: pixels behind an object. squares: a side, and the lines of squares
    that appear there."""
    u, v = pose.cells()
    black = (np.floor(u) + np.floor(v)) % 2 == 0
    shown = (u > -1) & (u < NODES) & (v > -1) & (v < NODES)
    if squares is not None:
        side, lines = squares
        away = (-1 - u, u - NODES, -1 - v, v - NODES)[side]
        along = v if side < 2 else u
        shown |= (away >= 0) & (away < lines) & (along > 2) & (along < NODES - 3)
    level = np.where(shown, np.where(black, 45.0, 205.0), surround)
    if hidden is not None:
        level = np.where(hidden, 90 + 30 * np.sin(x / 7) * np.sin(y / 9), level)
    level = level.reshape(SIZE, FINE, SIZE, FINE).mean(axis=(1, 3))
    level = cv2.GaussianBlur(level, (0, 0), 0.8) + rng.normal(0, 2.5, level.shape)
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


def surround_of(rng: np.random.Generator) -> np.ndarray:
    """Return an even surround, or one with clouds or with a texture of corners."""
    size = SIZE * FINE, SIZE * FINE
    kind = rng.choice(3, p=(0.4, 0.4, 0.2))
    if kind == 0:
        return np.full(size, 120.0)
    rough = 22 if kind == 1 else 40
    cloud = cv2.resize(rng.normal(0, 1, (rough, rough)), size, interpolation=cv2.INTER_CUBIC)
    return 120 + 40 * cloud


def jump(
    kind: str, number: int, before: Pose, rng: np.random.Generator
) -> tuple[Pose, dict[str, Any]]:
    """Return the pose after the jump of that number, and what else `drawn` needs."""
    shift, turn, zoom, pushes = before.shift, before.turn, before.zoom, []
    also: dict[str, Any] = {}
    if kind == "jump":
        size = rng.choice([0.5, 1.5, 3.0])
        shift = shift + rng.uniform(-size, size, 2)
        turn, zoom = turn + rng.normal() * 0.02 * size, zoom * (1 + rng.normal() * 0.01 * size)
    elif "push" in kind:
        for _ in range(rng.integers(1, 3)):
            width = rng.uniform(6, 14) if kind == "wide push" else rng.uniform(1.5, 4.5)
            far = rng.uniform(0.2, min(3.2, width / 0.62))
            way = rng.uniform(0, 2 * np.pi)
            column, row = rng.uniform(-1, NODES, 2)
            pushes.append((column, row, far * np.cos(way), far * np.sin(way), width))
    else:
        cells = np.array(SLIPS[number % len(SLIPS)]) if kind == "slip" else rng.integers(-3, 4, 2)
        cells[0] += cells.sum() % 2
        shift = shift + cells + rng.normal(0, 0.05, 2)
        turn, zoom = turn + rng.normal() * 0.004, zoom * (1 + rng.normal() * 0.002)
    pose = Pose(shift, turn, zoom, tuple(pushes))
    side = int(rng.integers(4))
    if kind == "hidden slip":
        place = (x, x, y, y)[side] - pose.middle[side // 2]
        inside = CELL * ((NODES + 1) / 2 - rng.uniform(1, 4))
        hidden = place < -inside if side % 2 == 0 else place > inside
        along, ends = (y if side < 2 else x), np.sort(rng.uniform(0, SIZE, 2))
        also["hidden"] = hidden & ((along > ends[0]) & (along < ends[1]) | (rng.random() < 0.5))
    elif kind == "slip at squares":
        also["squares"] = side, int(rng.integers(1, 5))
    return pose, also


def trials_of(
    kind: str, numbers: range, rng: np.random.Generator, config: DetectorConfig, device: Any
) -> Iterator[str | int]:
    """Yield for each jump from one frame at rest "not tracked" if the frame before is not,
    "refused", or how many nodes of the frame after it have a wrong position."""
    surround = surround_of(rng)
    at_rest = Pose(rng.uniform(-0.3, 0.3, 2), rng.normal() * 0.03, 1 + rng.normal() * 0.02)
    rest = drawn(at_rest, surround, rng)
    try:
        view = OneView(rest, shape=(NODES, NODES), config=config, device=device)
    except GridError:
        yield from ["not tracked"] * len(numbers)
        return
    with view:
        for number in numbers:
            view(rest)
            step = rng.uniform(-0.2, 0.2, 2) * rng.integers(0, 2)
            before = dataclasses.replace(at_rest, shift=at_rest.shift + step)
            if not view(drawn(before, surround, rng)).tracked:
                yield "not tracked"
                continue
            pose, also = jump(kind, number, before, rng)
            measured = view(drawn(pose, surround, rng, **also))
            if not measured.tracked:
                yield "refused"
                continue
            grid = measured.grids[0]
            off = np.linalg.norm(grid.xy - pose.nodes(), axis=2)
            there = grid.status != NodeStatus.MISSING
            yield int(np.count_nonzero((off > WRONG * CELL) & there))


def main() -> int:
    parser = parser_of(__doc__, quick="25 jumps of each kind")
    parser.add_argument("--device")
    options = parser.parse_args()
    config, device = DetectorConfig.for_cell(CELL), select_device(options.device)
    groups, rows = 1 if options.quick else GROUPS, []
    with Progress(groups * len(KINDS), "frames at rest") as progress:
        for number, kind in enumerate(KINDS):
            rng = np.random.default_rng(7000 + number)
            counts: collections.Counter[str] = collections.Counter()
            for group in range(groups):
                numbers = range(group * EACH, (group + 1) * EACH)
                for found in trials_of(kind, numbers, rng, config, device):
                    if isinstance(found, str):
                        counts[found] += 1
                    else:
                        counts["accepted"] += 1
                        counts["wrong frames"] += found > 0
                        counts["wrong nodes"] += found
                progress.step()
            names = ("not tracked", "refused", "accepted", "wrong frames", "wrong nodes")
            rows.append({"jump": kind, **{name: counts[name] for name in names}})
            print(rows[-1], flush=True)
    write_table("tracking", rows, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
