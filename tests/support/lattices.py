"""Corners of warped checkerboards, made without an image."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method


class Board(NamedTuple):
    """Corners, the (row, column) each really has (-1 for false ones), and (R, C) positions."""

    corners: Corners
    index: NDArray[np.int64]
    truth: NDArray[np.complex128]


def board(
    rows: int,
    columns: int,
    *,
    cell: float = 13.0,
    turn: float = 0.1,
    pull: float = 1.5,
    twist: float = 0.35,
    jitter: float = 0.2,
    lost: float = 0.0,
    false: float = 0.0,
    black: bool = True,
    origin: complex = 60 + 50j,
    seed: int = 0,
) -> Board:
    """A checkerboard, pulled by `pull` cells and twisted in the middle, whole nodes `lost`.

    black: whether the cell right below node (0, 0) is black. false: extra corners, a share.
    """
    draw = np.random.default_rng(seed)
    row, column = np.mgrid[-1 : rows + 1, -1 : columns + 1].astype(float)
    flat = (column + 1j * row) * cell
    middle = ((columns - 1) + 1j * (rows - 1)) * cell / 2
    near = np.exp(-(np.abs(flat - middle) ** 2) / (min(rows, columns) / 4 * cell) ** 2)
    shifted = flat + pull * cell * near * (1 + 0.5j) - middle
    ringed = shifted * np.exp(1j * (turn + twist * near)) + middle + origin
    truth = ringed[1:-1, 1:-1]
    steps = np.stack([ringed[1:-1, 2:], ringed[2:, 1:-1], ringed[1:-1, :-2], ringed[:-2, 1:-1]], -1)
    # e0 lies along the row where the cell right below is black, else along the column
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


def joined(first: Board, second: Board) -> Corners:
    """The corners of two boards in one image."""
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
        response=np.ones(len(z), np.float32),
        method=np.full(len(z), Method.EDGE_LINES, np.uint8),
        sigma=np.linspace(0.1, 0.2, len(z), dtype=np.float32),
        edges=angles.astype(np.float32),
        doubtful=np.zeros(len(z), np.bool_),
        device="none",
    )
    return corners, index[order]
