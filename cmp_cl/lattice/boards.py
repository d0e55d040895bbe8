"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import NONE, Board, Mask, Parts, Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import Placed, joined, units_of


class Stages(Protocol):
    """What the device, or the oracle, does for one frame."""

    def parts(self) -> Parts:
        """Return the parts of the lattice."""

    def votes(self, units: Units) -> Votes:
        """Return the ways across tears between the rims of parts."""

    def settled(self, board: Board) -> Board:
        """Return the board after rounds of dropping and attaching nodes."""


def boards(
    stages: Stages,
    shape: tuple[int, int],
    xy: NDArray[np.float32],
    torn: Mask,
    k: LatticeConstants,
) -> Iterator[Board]:
    """Yield the boards of a frame, that of the largest part first, without margins.

    shape: of the image. xy: (N, 2), px. torn: (N,), corners whose position is a rough one. A corner
    is a node of one board at most.
    """
    parts = stages.parts()
    units, faces = units_of(
        parts.root,
        parts.column,
        parts.row,
        parts.direction,
        parts.contradicted,
        xy,
        k,
    )
    if not len(faces):
        return
    votes = stages.votes(units)
    taken = np.zeros(len(xy), np.bool_)
    for main in range(len(faces)):
        own = units.corner[units.part == main]
        if 2 * np.count_nonzero(taken[own]) > len(own):
            continue
        placed = joined(units, votes, len(xy), k, main)
        placed.part[taken] = -1
        board = trimmed(stages.settled(board_of(placed, xy, torn, k)), shape, k)
        owner = board.owner[board.owner >= 0]
        if np.count_nonzero(board.there) < k.least_board:
            continue
        taken[owner] = True
        yield board


def board_of(placed: Placed, xy: NDArray[np.float32], torn: Mask, k: LatticeConstants) -> Board:
    """Return numbered corners as an array of nodes, with a margin of missing ones."""
    corner = np.flatnonzero(placed.there)
    column, row = (
        np.rint(each).astype(np.int64)
        for each in (placed.number[corner].real, placed.number[corner].imag)
    )
    margin = k.rounds + 3
    column, row = column - column.min() + margin, row - row.min() + margin
    shape = int(row.max()) + margin + 1, int(column.max()) + margin + 1
    colour = (1 - 2 * (placed.rotation[corner] % 2)) * (1 - 2 * ((row + column) % 2))
    board = Board(
        x=np.full(shape, np.nan, np.float32),
        y=np.full(shape, np.nan, np.float32),
        owner=np.full(shape, NONE),
        torn=np.zeros(shape, np.bool_),
        sign=1 if colour.sum() >= 0 else -1,
    )
    board.x[row, column], board.y[row, column] = xy[corner].T
    board.owner[row, column], board.torn[row, column] = corner, torn[corner]
    return board


def cropped(board: Board) -> Board:
    """Return the board without the empty rows and columns around it."""
    row, column = (np.flatnonzero(board.there.any(axis)) for axis in (1, 0))
    if not len(row):
        return board
    box = np.s_[row[0] : row[-1] + 1, column[0] : column[-1] + 1]
    return Board(
        x=board.x[box],
        y=board.y[box],
        owner=board.owner[box],
        torn=board.torn[box],
        sign=board.sign * (1 - 2 * int((row[0] + column[0]) % 2)),
    )


def trimmed(board: Board, shape: tuple[int, int], k: LatticeConstants) -> Board:
    """Return the board without outer lines that hold too few of their places in view.

    shape: of the image. Things beside a pattern continue some of its columns, a further line of the
    pattern continues all of them.
    """
    height, width = shape
    while True:
        board = cropped(board)
        z = np.where(board.there, board.x + 1j * board.y, np.nan)
        worst, line = 0.0, None
        for number, way in enumerate((z, z[::-1], z.T, z.T[::-1])):
            if len(way) < 3:
                continue
            place = 2 * way[1] - way[2]
            inside = (place.real > k.edge_px) & (place.real < width - 1 - k.edge_px)
            inside &= (place.imag > k.edge_px) & (place.imag < height - 1 - k.edge_px)
            there = ~np.isnan(way[0].real)
            lack = k.least_line * np.count_nonzero(there | inside) - np.count_nonzero(there)
            if lack > worst:
                worst, line = lack, number
        if line is None:
            return board
        cut = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])[line]
        board.owner[cut], board.x[cut], board.y[cut] = NONE, np.nan, np.nan
