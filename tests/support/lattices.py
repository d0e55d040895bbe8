"""Corners of warped checkerboards, made without an image."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method


class Board(NamedTuple):
    """Corners, their true rows and columns, (N, 2), -1 for false ones, and the true positions of
    the nodes, (R, C), x + 1j y px."""

    corners: Corners
    index: NDArray[np.int64]
    truth: NDArray[np.complex128]


def keep(corners: Corners, which: NDArray[np.bool_] | NDArray[np.int64]) -> Corners:
    """Return some of the corners: those of a mask, (N,), or of indices."""
    fields = {
        field.name: getattr(corners, field.name)[which]
        for field in dataclasses.fields(corners)
        if field.name not in ("device", "edge_radius")
    }
    return dataclasses.replace(corners, **fields)


def board(
    rows: int,
    columns: int,
    *,
    cell: float = 13.0,
    rotation: float = 0.1,
    pull: float = 1.5,
    twist: float = 0.35,
    jitter: float = 0.2,
    lost: float = 0.0,
    false: float = 0.0,
    black: bool = True,
    origin: complex = 60 + 50j,
    seed: int = 0,
) -> Board:
    """Return a rotated checkerboard that is pulled and twisted in the middle.

    cell: px. rotation, twist: rad. pull: cells. jitter: standard deviation of the positions, px.
    lost: share of the corners that are left out. false: number of false corners, as a share of the
    others. black: whether the cell between nodes (0, 0) and (1, 1) is black. origin: x + 1j y of
    node (0, 0), px, before the rotation about the middle.
    """
    draw = np.random.default_rng(seed)
    row, column = np.mgrid[-1 : rows + 1, -1 : columns + 1].astype(float)
    flat = (column + 1j * row) * cell
    middle = ((columns - 1) + 1j * (rows - 1)) * cell / 2
    near = np.exp(-(np.abs(flat - middle) ** 2) / (min(rows, columns) / 4 * cell) ** 2)
    shifted = flat + pull * cell * near * (1 + 0.5j) - middle
    ringed = shifted * np.exp(1j * (rotation + twist * near)) + middle + origin
    truth = ringed[1:-1, 1:-1]
    steps = np.stack([ringed[1:-1, 2:], ringed[2:, 1:-1], ringed[1:-1, :-2], ringed[:-2, 1:-1]], -1)
    # e0 lies along the row if the cell to the right of and below the node is black, else along the
    # column
    first = (np.indices((rows, columns)).sum(0) + (not black)) % 2
    first = first + 2 * draw.integers(0, 2, first.shape)
    angles = np.angle(steps - truth[..., None])
    angles = np.take_along_axis(angles, (np.arange(4) + first[..., None]) % 4, -1)
    z = truth + jitter * (draw.normal(size=truth.shape) + 1j * draw.normal(size=truth.shape))
    kept = draw.random(truth.shape) >= lost
    index = np.argwhere(kept)
    count = int(false * len(index))
    wild = draw.uniform(truth.real.min(), truth.real.max(), count) + 1j * draw.uniform(
        truth.imag.min(), truth.imag.max(), count
    )
    wild_angles = draw.uniform(-np.pi, np.pi, (count, 1)) + np.arange(4) * np.pi / 2
    return Board(
        *_sorted(
            np.concatenate([z[kept], wild]),
            np.concatenate([angles[kept] + draw.normal(0, 0.08, (len(index), 4)), wild_angles]),
            np.concatenate([index, np.full((count, 2), -1)]),
        ),
        truth,
    )


def endless(
    *,
    zoom: float = 1.0,
    rotation: float = 0.0,
    translation: complex = 0,
    cell: float = 10.0,
    side: int = 300,
    jitter: float = 0.05,
    errors: float = 0.0,
    seed: int = 0,
) -> Board:
    """Return the corners in an image of `side` px of a checkerboard that continues beyond it.

    It is zoomed and rotated about the middle of the image, then translated by so many cells.
    errors: standard deviation of the printing errors, cells; they are the same for every seed. The
    numbers are those of the pattern; `truth` is empty.
    """
    draw = np.random.default_rng(seed)
    reach = int(side / cell)
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    moved = zoom * np.exp(1j * rotation)
    error = np.random.default_rng(77).normal(0, errors, (2, *row.shape))
    place = column + error[0] + 0.37 + 1j * (row + error[1] + 0.21)
    z = place * cell * moved + translation * cell + side / 2 * (1 + 1j)
    seen = (np.abs(z.real - side / 2) < side / 2 - 3) & (np.abs(z.imag - side / 2) < side / 2 - 3)
    index = np.stack([row[seen], column[seen]], axis=1)
    z = z[seen] + jitter * (draw.normal(size=len(index)) + 1j * draw.normal(size=len(index)))
    first = index.sum(axis=1, keepdims=True) % 2
    angles = rotation + np.pi / 2 * ((np.arange(4) + first) % 4) + draw.normal(0, 0.05, (len(z), 4))
    return Board(*_sorted(z, angles, index), np.zeros((0, 0), np.complex128))


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


def joined(first: Board, second: Board) -> Corners:
    """Return the corners of two boards in one image."""
    z = [part.corners.xy @ np.array([1, 1j]) for part in (first, second)]
    edges = np.concatenate([first.corners.edges, second.corners.edges])
    return _sorted(np.concatenate(z), edges, np.full((len(edges), 2), -1))[0]


def _sorted(
    z: NDArray[np.complex128], angles: NDArray[np.floating], index: NDArray[np.int64]
) -> tuple[Corners, NDArray[np.int64]]:
    order = np.lexsort((np.rint(z.real), np.rint(z.imag)))
    z, angles = z[order], np.angle(np.exp(1j * angles[order]))
    xy = np.stack([z.real, z.imag], axis=1)
    corners = Corners(
        xy=xy.astype(np.float32),
        pixel=np.rint(xy).astype(np.int32),
        octave=np.zeros(len(z), np.uint8),
        response=np.ones(len(z), np.float32),
        method=np.full(len(z), Method.EDGE_LINES, np.uint8),
        sigma=np.linspace(0.1, 0.2, len(z), dtype=np.float32),
        edges=angles.astype(np.float32),
        doubtful=np.zeros(len(z), np.bool_),
        refusal=np.zeros(len(z), np.uint8),
        device="none",
    )
    return corners, index[order]
