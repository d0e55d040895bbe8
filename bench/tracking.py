"""Attacks on the numbers that a frame takes from the one before it: what is accepted, and wrong.

    python bench/tracking.py --quick       some minutes
    python bench/tracking.py               1400 jumps, a quarter of an hour

A board of 24 x 24 corners is drawn at rest, once more after a small motion, and then after a jump
that no camera should see: the frames in between are missing. The detector finds the corners, so
there are false ones from the surround, and missing ones. Each kind of jump is made for a weakness
of tracking:

    jump            shift, turn and zoom of the whole board, up to three cells
    slip            each of the 40 of whole cells of the right colour, up to four, in turn: every
                    corner is where one was
    push            parts of the board, by up to three cells in their middle, steep or wide
    hidden slip     a slip, and an object hides one of its sides
"""

import argparse
import collections
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import main_of

from cmp_cl import DetectorConfig, GridError, NodeStatus
from cmp_cl.measure import OneView
from cmp_cl.synthetic.boards import View, drawn, samples

NODES, CELL, SIDE, FINE = 24, 15.0, 480, 2
SIZE = SIDE, SIDE
WRONG = 0.35  # cells from its node that a corner has the number of
KINDS = ("jump", "slip", "push", "hidden slip")
GROUPS, EACH = 14, 25  # frames at rest, and jumps from each
SLIPS = [
    (across, down)
    for across in range(-4, 5)
    for down in range(-4, 5)
    if (across + down) % 2 == 0 and (across or down)
]  # cells
Push = tuple[float, float, float, float, float]  # column, row, its motion, and its width, cells


class Pose(NamedTuple):
    """shift: of the middle, cells. turn: rad. pushes: of parts of the board."""

    shift: np.ndarray
    turn: float
    zoom: float
    pushes: tuple[Push, ...] = ()

    @property
    def middle(self) -> np.ndarray:
        """Where the middle of the board is, px."""
        return SIDE / 2 + self.shift * CELL

    def __call__(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return column and row of the board at pixels."""
        way = np.exp(-1j * self.turn) / (CELL * self.zoom)
        at = (x - self.middle[0] + 1j * (y - self.middle[1])) * way + (NODES - 1) / 2 * (1 + 1j)
        moved = np.zeros_like(at)
        for column, row, along, down, width in self.pushes:
            near = np.exp(-(np.abs(at - column - 1j * row) ** 2) / (2 * width**2))
            moved += (along + 1j * down) * near
        return (at - moved).real, (at - moved).imag


def seen(
    pose: Pose,
    surround: np.ndarray,
    rng: np.random.Generator,
    hidden: np.ndarray | None = None,
) -> View:
    """Return a view. hidden: samples behind an object."""
    front, (x, y) = np.nan, samples(SIZE, FINE)
    if hidden is not None:
        front = np.where(hidden, 90 + 30 * np.sin(x / 7) * np.sin(y / 9), np.nan)
    return drawn(
        pose,
        SIZE,
        (NODES, NODES),
        margin=0,
        ground=surround,
        front=front,
        blur=0.8,
        noise=2.5,
        seed=rng,
        count=FINE,
    )


def surround_of(rng: np.random.Generator) -> np.ndarray:
    """Return an even surround, or one with clouds or with a texture of corners."""
    rough = rng.choice([1, 22, 40], p=(0.4, 0.4, 0.2))
    cloud = rng.normal(0, 1, (rough, rough))
    return 120 + 40 * cv2.resize(cloud, (SIDE * FINE, SIDE * FINE), interpolation=cv2.INTER_CUBIC)


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
    elif kind == "push":
        for _ in range(rng.integers(1, 3)):
            width = rng.uniform(1.5, 14)
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
        x, y = samples(SIZE, FINE)
        place = (x, x, y, y)[side] - pose.middle[side // 2]
        inside = CELL * ((NODES + 1) / 2 - rng.uniform(1, 4))
        hidden = place < -inside if side % 2 == 0 else place > inside
        along, ends = (y if side < 2 else x), np.sort(rng.uniform(0, SIDE, 2))
        also["hidden"] = hidden & ((along > ends[0]) & (along < ends[1]) | (rng.random() < 0.5))
    return pose, also


def trials_of(kind: str, numbers: range, rng: np.random.Generator) -> Iterator[str | int]:
    """Yield for each jump from one frame at rest "not tracked" if the frame before is not,
    "refused", or how many nodes of the frame after it have a wrong position."""
    surround = surround_of(rng)
    at_rest = Pose(rng.uniform(-0.3, 0.3, 2), rng.normal() * 0.03, 1 + rng.normal() * 0.02)
    rest = seen(at_rest, surround, rng).image
    try:
        view = OneView(rest, shape=(NODES, NODES), config=DetectorConfig.for_cell(CELL))
    except GridError:
        yield from ["not tracked"] * len(numbers)
        return
    with view:
        for number in numbers:
            view(rest)
            step = rng.uniform(-0.2, 0.2, 2) * rng.integers(0, 2)
            before = at_rest._replace(shift=at_rest.shift + step)
            if not view(seen(before, surround, rng).image).tracked:
                yield "not tracked"
                continue
            pose, also = jump(kind, number, before, rng)
            shown = seen(pose, surround, rng, **also)
            measured = view(shown.image)
            if not measured.tracked:
                yield "refused"
                continue
            grid = measured.grids[0]
            row, column = shown.corners[:, 2:].astype(int).T
            off = np.full(grid.shape, np.inf)
            off[row, column] = np.linalg.norm(grid.xy[row, column] - shown.corners[:, :2], axis=1)
            there = grid.status != NodeStatus.MISSING
            yield int(np.count_nonzero((off > WRONG * CELL) & there))


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for number, kind in enumerate(KINDS):
        rng = np.random.default_rng(7000 + number)
        counts: collections.Counter[str] = collections.Counter()
        for group in range(1 if arguments.quick else GROUPS):
            for found in trials_of(kind, range(group * EACH, (group + 1) * EACH), rng):
                if isinstance(found, str):
                    counts[found] += 1
                else:
                    counts["accepted"] += 1
                    counts["wrong frames"] += found > 0
                    counts["wrong nodes"] += found
        names = ("not tracked", "refused", "accepted", "wrong frames", "wrong nodes")
        yield {"jump": kind, **{name: counts[name] for name in names}}


main = main_of(__doc__, {"tracking": rows}, quick="25 jumps of each kind")

if __name__ == "__main__":
    raise SystemExit(main())
