"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Board
from cmp_cl.lattice.joins import joined
from cmp_cl.lattice.kernels import TAKEN
from cmp_cl.lattice.plan import LatticePlan


def boards(plan: LatticePlan, xy: NDArray[np.float32]) -> Iterator[Board]:
    """Yield the boards of a frame that was started, upright, with their borders, the largest part's
    first.

    xy: (N, 2), the corners of the plan, px. A corner is a node of one board at most. A part of
    fewer than `least_board` faces begins no board, but for the largest one; nor does one of fewer
    corners that no board has.
    """
    k = plan.constants
    alone = plan.alone()
    if alone is not None:
        if np.count_nonzero(alone.there) >= k.least_board:
            yield alone
        return
    units = joined(*plan.parts(xy), k)
    taken = np.zeros(len(xy), np.bool_)
    for part in np.unique(units.part).tolist():
        if part and units.faces[part] < k.least_board:
            continue
        nodes = slice(*np.searchsorted(units.part, (part, part + 1)))
        corner = units.corner[nodes]
        if np.count_nonzero(~taken[corner]) < k.least_board:
            continue
        number, turn = units.number[nodes], units.rotation[nodes]
        numbers = np.zeros((len(xy), 4), np.int32)
        columns = number.real, number.imag, turn, np.ones(len(corner))
        numbers[corner] = np.rint(np.stack(columns, axis=1))
        numbers[taken, 3] = TAKEN
        board = plan.settle(numbers)
        if np.count_nonzero(board.there) >= k.least_board:
            taken[board.owner[board.owner >= 0]] = True
            yield board
