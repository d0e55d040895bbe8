"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Board
from cmp_cl.lattice.joins import Joining
from cmp_cl.lattice.kernels import TAKEN
from cmp_cl.lattice.plan import LatticePlan


def boards(plan: LatticePlan, xy: NDArray[np.float32]) -> Iterator[Board]:
    """Yield the boards of a frame that was started, upright, with their borders, the largest part's
    first.

    xy: (N, 2), the corners of the plan, px. A corner is a node of one board at most. A part of
    fewer than `least_board` faces begins no board, but for the largest one.
    """
    k = plan.constants
    alone = plan.alone()
    if alone is not None:
        if np.count_nonzero(alone.there) >= k.least_board:
            yield alone
        return
    units, votes = plan.parts(xy)
    joining = Joining(units, votes, len(xy), k)
    taken = np.zeros(len(xy), np.bool_)
    left = list(range(len(units.faces)))
    while left:
        main, *left = left
        if main and units.faces[main] < k.least_board:
            continue
        numbers = joining.run(main, left)
        numbers[taken] = TAKEN
        board = plan.settle(numbers)
        if np.count_nonzero(board.there) < k.least_board:
            continue
        taken[board.owner[board.owner >= 0]] = True
        left = [part for part in left if not taken[units.corner[joining.members[part]]].all()]
        yield board
