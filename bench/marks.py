"""Counts the false corners that marks in the cells cause, before and after `drop_marks`.

    python bench/marks.py --quick       a third of the boards, a few seconds
    python bench/marks.py               writes results/marks.json, about ten seconds

Boards with a mark in most of their cells, seen at an angle, and worn gels without marks, which
must lose nothing.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import environment, parser_of, write_result
from scenes import TEST_SEED, rendered

from cmp_cl import Detector, DetectorConfig, detect
from cmp_cl.image import GreyImage
from cmp_cl.marks import drop_marks
from cmp_cl.synthetic import random_scene
from cmp_cl.synthetic.scoring import Score, score, total

FIRST_SEED = TEST_SEED + 800_000
MARKS = ("dot", "ring", "cross", "square", "code")
CELLS = (24, 36, 50)  # px
SHAPE = (480, 640)
GELS = (20, 30, 40, 44)
SEVERITIES = (0.5, 1.0, 1.5)
TEXELS = 48  # of a cell's side
MARKED = 0.85  # share of the cells that have a mark
BLUR, NOISE = 0.8, 3.0  # px; grey levels


class Board(NamedTuple):
    """image; truth, rim: (N, 2), px, the inner corners and where the border's cells end."""

    image: GreyImage
    truth: np.ndarray
    rim: np.ndarray


def inked(mark: str, draw: np.random.Generator) -> np.ndarray:
    """Return which texels of a cell a mark inks, (TEXELS, TEXELS) bool."""
    y, x = (np.mgrid[:TEXELS, :TEXELS] + 0.5) / TEXELS - 0.5
    size = draw.uniform(0.14, 0.24)
    far, near = np.hypot(x, y), np.minimum(np.abs(x), np.abs(y))
    box = np.maximum(np.abs(x), np.abs(y))
    if mark == "code":
        bits = draw.random((4, 4)) < 0.5
        place = np.clip(((np.stack([y, x]) + 0.3) / 0.15).astype(int), 0, 3)
        return bits[tuple(place)] & (box < 0.3)
    kinds = {
        "dot": far < size,
        "ring": (far < 1.5 * size) & (far > 0.9 * size),
        "cross": (near < 0.3 * size) & (box < 1.4 * size),
        "square": box < size,
    }
    return kinds[mark]


def board(mark: str, cell: float, seed: int) -> Board:
    """Render a board that fills most of the image, rotated and seen at an angle."""
    draw = np.random.default_rng(seed)
    rows, columns = int(0.75 * SHAPE[0] / cell), int(0.75 * SHAPE[1] / cell)
    white = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 1
    texture = np.kron(white, np.ones((TEXELS, TEXELS), np.bool_))
    for row, column in np.argwhere(draw.random(white.shape) < MARKED):
        here = np.s_[row * TEXELS :, column * TEXELS :]
        texture[here][:TEXELS, :TEXELS] ^= inked(mark, draw)
    sheet = np.pad(np.where(texture, 200, 35).astype(np.uint8), TEXELS, constant_values=200)

    high, wide = rows * cell, columns * cell
    corners = np.array([[0, 0], [wide, 0], [wide, high], [0, high]]) - (wide / 2, high / 2)
    angle = draw.uniform(-0.3, 0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    seen = corners @ turn + draw.uniform(-0.6, 0.6, (4, 2)) * cell
    seen += ((SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2)
    texels = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) * TEXELS + TEXELS - 0.5
    fine = 3  # samples a pixel, along each axis
    to_fine = cv2.getPerspectiveTransform(
        texels.astype(np.float32), (fine * (seen + 0.5) - 0.5).astype(np.float32)
    )
    size = (fine * SHAPE[1], fine * SHAPE[0])
    image = cv2.warpPerspective(sheet, to_fine, size, borderMode=cv2.BORDER_REPLICATE)
    image = cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), BLUR) + NOISE * draw.standard_normal(SHAPE)

    grid = np.stack(np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0)), axis=-1)
    flat = (grid * TEXELS + TEXELS - 0.5).reshape(1, -1, 2)
    at = (cv2.perspectiveTransform(flat, to_fine) + 0.5) / fine - 0.5
    at = at.reshape(rows + 1, columns + 1, 2)
    inner = at[1:-1, 1:-1].reshape(-1, 2)
    margin = 7  # px: nearer to the image's edge a corner is neither missed nor false
    inside = ((inner > margin) & (inner < np.array(SHAPE[::-1]) - 1 - margin)).all(axis=1)
    rim = np.concatenate([at[0], at[-1], at[:, 0], at[:, -1], inner[~inside]])
    return Board(np.rint(image).clip(0, 255).astype(np.uint8), inner[inside], rim)


def row_of(name: str, before: Sequence[Score], after: Sequence[Score]) -> dict[str, Any]:
    first, second = total(before), total(after)
    return {
        "images": name,
        "frames": first.frames,
        "corners": first.expected,
        "missed": first.missed,
        "false": first.false,
        "missed_after": second.missed,
        "false_after": second.false,
    }


def boards(mark: str, cells: Sequence[float]) -> dict[str, Any]:
    """Measure the boards with that mark, one for each size of cells."""
    before, after = [], []
    for cell in cells:
        seed = FIRST_SEED + 100 * MARKS.index(mark) + round(cell)
        seen = board(mark, cell, seed)
        config = DetectorConfig.for_cell(cell)
        found = detect(seen.image, config)
        for scores, corners in ((before, found), (after, drop_marks(found, seen.image))):
            scores.append(score(corners.xy, seen.truth, cell, seen.rim))
    return row_of(mark, before, after)


def gels(densities: Sequence[int]) -> dict[str, Any]:
    """Measure worn gels without marks."""
    before, after = [], []
    with Detector(shape=SHAPE, config=DetectorConfig()) as detector:
        for markers in densities:
            for k, severity in enumerate(SEVERITIES):
                scene = random_scene(
                    FIRST_SEED + 1000 + 10 * markers + k, markers=markers, severity=severity
                )
                frame = rendered(scene)
                found = detector(frame.image)
                before.append(frame.score(found.xy))
                after.append(frame.score(drop_marks(found, frame.image).xy))
    return row_of("none, worn gels", before, after)


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__, quick="a third of the boards").parse_args(argv)
    cells = CELLS[1:2] if arguments.quick else CELLS
    rows = [boards(mark, cells) for mark in MARKS]
    rows.append(gels(GELS[2:3] if arguments.quick else GELS))
    for row in rows:
        print(
            f"{row['images']:16} {row['corners']:6} corners: missed {row['missed']} -> "
            f"{row['missed_after']}, false {row['false']} -> {row['false_after']}"
        )
    result = {
        "kind": "marks",
        "environment": environment(),
        "first_seed": FIRST_SEED,
        "cells": cells,
        "rows": rows,
    }
    write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
