"""The sides of a board: from its nodes to what is seen at its sides, see kernels/borders.cl.

A side is read along squares that share the last two lines of nodes. Where the pattern ends, how far
its last squares reach, tell one end of a pattern from another, and from the edge of an object
before it.
"""

import cmath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Border
from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

# In what is found, see kernels/borders.cl.
ROWS, COLUMNS, SIGN, ROOM, FOLLOWS, REACH, STEPS, FURTHER, FOUND = 0, 1, 2, 3, 7, 11, 15, 19, 23
UNSEEN = -(2**31)
WHOLE = 4096  # a share of 1


def border_of(found: NDArray[np.int32]) -> Border:
    """Return the sides of a board from what the kernels found."""
    share = found[REACH:STEPS]
    reach = np.where(share == UNSEEN, np.nan, share / WHOLE)
    follows, room = (found[n : n + 4].astype(np.bool_) for n in (FOLLOWS, ROOM))
    return Border(reach, follows, room, found[FURTHER:FOUND].astype(np.int64))


def upright(found: NDArray[np.int32]) -> int:
    """Return the quarter turns after which the columns of a board follow the image's x axis, from
    what the kernels found."""
    x, y, x_down, y_down = found[STEPS:FURTHER].tolist()
    along, down = complex(x, y), complex(x_down, y_down)
    along, down = along or -1j * down, down or 1j * along
    away = [abs(cmath.phase(way)) for way in (along, down, -along, -down)]
    return away.index(min(away))


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    places = plan.places
    return {
        "nodes": 8 * places,
        "node_owner": 4 * places,
        "node_rough": places,
        "border": 4 * FOUND,
    }


def cut(plan: "LatticePlan") -> Launch:
    """Return the launch from a board with margins to one without, see `trimmed` of the oracle."""
    k, b = plan.constants, plan.buffers
    names = ("layout", "result", "owner", "rough", "used")
    cut_to = ("nodes", "node_owner", "node_rough", "border")
    return plan.one_group(
        "cut_board",
        **plan.size,
        least_line=np.float32(k.least_line),
        edge=np.float32(k.contrast_radius_px),
        **{name: b[name] for name in names + cut_to},
    )


def measure(plan: "LatticePlan") -> Launch:
    """Return the launch from the nodes of a board to its sides."""
    k, b = plan.constants, plan.buffers
    return plan.one_group(
        "measure_border",
        image=b["image"],
        step=np.uint32(plan.step),
        **plan.size,
        **plan.corners,
        **{name: b[name] for name in ("lines", "layout", "starts", "binned", "used")},
        passing=np.float32(k.passing),
        least_line=np.float32(k.least_line),
        least_cosine=np.float32(k.least_cosine),
        beside=np.float32(k.reach_cells),
        nodes=b["nodes"],
        owner=b["node_owner"],
        border=b["border"],
    )
