"""The sides of a board: from its nodes to what is seen at its sides, see kernels/borders.cl.

A side is read along squares that share the last two lines of nodes. Where the pattern ends, and how
far its last squares reach, tell one end of a pattern from another, and from an object before it.
"""

import cmath

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Border

# In what is found, see kernels/borders.cl.
ROWS, COLUMNS, SIGN, ROOM, FOLLOWS, REACH, STEPS, FURTHER = 0, 1, 2, 3, 7, 11, 15, 19
UNSEEN = -(2**31)
WHOLE = 4096  # a share of 1


def border_of(found: NDArray[np.int32]) -> Border:
    """Return the sides of a board from what the kernels found."""
    share = found[REACH:STEPS]
    reach = np.where(share == UNSEEN, np.nan, share / WHOLE)
    follows, room = (found[n : n + 4].astype(np.bool_) for n in (FOLLOWS, ROOM))
    return Border(reach, follows, room, found[FURTHER:].astype(np.int64))


def upright(found: NDArray[np.int32]) -> int:
    """Return the quarter turns after which the columns of a board follow the image's x axis, from
    what the kernels found."""
    x, y, x_down, y_down = found[STEPS:FURTHER].tolist()
    along, down = complex(x, y), complex(x_down, y_down)
    along, down = along or -1j * down, down or 1j * along
    away = [abs(cmath.phase(way)) for way in (along, down, -along, -down)]
    return away.index(min(away))
