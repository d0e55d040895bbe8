"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Board, Mask
from cmp_cl.lattice.joins import Joining
from cmp_cl.lattice.kernels import TAKEN
from cmp_cl.lattice.plan import LatticePlan


def boards(plan: LatticePlan, xy: NDArray[np.float32]) -> Iterator[Board]:
    """Yield the boards of a frame that was started, upright, with their borders, the largest part's
    first.

    xy: (N, 2), the corners of the plan, px. A corner is a node of one board at most. If no part has
    `least_part` faces, the largest one is enough.
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
    left = list(range(int(units.part.max(initial=-1)) + 1))
    while left:
        main, *left = left
        numbers = joining.run(main, left)
        numbers[taken] = TAKEN
        board = plan.settle(numbers)
        owner = board.owner[board.owner >= 0]
        if np.count_nonzero(board.there) < k.least_board:
            continue
        taken[owner] = True
        left = [part for part in left if _is_free(taken[units.corner[joining.members[part]]])]
        yield board


def _is_free(taken: Mask) -> bool:
    """Return whether no more than half of a part's corners are taken."""
    return 2 * int(np.count_nonzero(taken)) <= len(taken)
