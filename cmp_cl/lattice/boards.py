"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import NONE, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import Placed, joined, units_of
from cmp_cl.lattice.plan import LatticePlan

LEAST_FACES = 4  # of a part where no other is larger


def boards(plan: LatticePlan, xy: NDArray[np.float32]) -> Iterator[Board]:
    """Yield the boards of a frame that was started, without margins, the largest part's first.

    xy: (N, 2), the corners of the plan, px. A corner is a node of one board at most. If no part has
    `least_part` faces, four are enough, which 3 x 3 corners have.
    """
    k = plan.constants
    alone = plan.alone()
    if alone is not None and alone.there.any():
        board = trimmed(alone, plan.shape, k)
        if np.count_nonzero(board.there) >= k.least_board:
            yield board
        return
    parts = plan.parts()
    units = units_of(parts, xy, k)
    if not len(units.part):
        units = units_of(parts, xy, dataclasses.replace(k, least_part=LEAST_FACES))
    votes = plan.votes(units)
    taken = np.zeros(len(xy), np.bool_)
    for main in range(int(units.part.max(initial=-1)) + 1):
        own = units.corner[units.part == main]
        if 2 * np.count_nonzero(taken[own]) > len(own):
            continue
        placed = joined(units, votes, len(xy), k, main)
        placed.part[taken] = -1
        board = trimmed(plan.settle(numbers_of(placed)), plan.shape, k)
        owner = board.owner[board.owner >= 0]
        if np.count_nonzero(board.there) < k.least_board:
            continue
        taken[owner] = True
        yield board


def numbers_of(placed: Placed) -> NDArray[np.int32]:
    """Return column, row, quarter turn, and 1 of every corner that is placed, (N, 4)."""
    number = np.where(placed.there, placed.number, 0)
    column, row = np.rint(number.real), np.rint(number.imag)
    return np.stack([column, row, placed.rotation, placed.there], axis=1).astype(np.int32)


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
