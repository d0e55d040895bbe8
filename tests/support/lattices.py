"""Drawn boards, and some of the corners of an image."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners


def keep(corners: Corners, which: NDArray[np.bool_] | NDArray[np.int64]) -> Corners:
    """Return some of the corners: those of a mask, (N,), or of indices."""
    fields = {
        field.name: getattr(corners, field.name)[which]
        for field in dataclasses.fields(corners)
        if field.name not in ("device", "edge_radius")
    }
    return dataclasses.replace(corners, **fields)


def drawn(
    rows: int, columns: int, *, cell: int = 20, origin: tuple[int, int] = (40, 40)
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return an image of a board on white paper, and its inner corners, (rows, columns, 2) px.

    cell: px. origin: (x, y) of the first square's corner, px. The image has room for two more
    cells.
    """
    high, wide = (rows + 1) * cell + 80 + 2 * cell, (columns + 1) * cell + 80 + 2 * cell
    y, x = np.mgrid[:high, :wide]
    v, u = (y - origin[1]) // cell, (x - origin[0]) // cell
    inside = (v >= 0) & (u >= 0) & (v <= rows) & (u <= columns)
    level = np.where(inside & ((u + v) % 2 == 0), 40.0, 210.0)
    for axis in (0, 1):  # blur of a lens
        level = (np.roll(level, 1, axis) + 2 * level + np.roll(level, -1, axis)) / 4
    level += np.random.default_rng(rows).normal(0, 2, level.shape)
    row, column = np.mgrid[1 : rows + 1, 1 : columns + 1]
    at = np.stack([origin[0] + column * cell, origin[1] + row * cell], axis=-1) - 0.5
    return np.clip(np.rint(level), 0, 255).astype(np.uint8), at
