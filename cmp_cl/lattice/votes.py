"""Ways across tears, which vote for where parts lie: what kernels/votes.cl needs."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.opencl.launches import GROUP, Launch, multiple

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

FIELDS = 6  # of a vote
ROOM = 16  # votes for each corner, more than its rims can have in a tear


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    return {"step": 4 * plan.capacity}


def launches(plan: "LatticePlan") -> list[Launch]:
    """Return the launch that the votes of a frame begin with."""
    b = plan.buffers
    return [plan.of_corners("mean_steps", **plan.corners, twin=b["twin"], step=b["step"])]


def ways(plan: "LatticePlan") -> NDArray[np.float32]:
    """Return what a way of so many steps must have, (span, 7), see kernels/votes.cl."""
    k = plan.constants
    rows = [
        [
            k.least_cosine,
            0.5 * m,
            1.5 * m + 0.2,
            1 / m,
            2 / (len(k.side_points) * m),
            k.least_side,
            1 / np.sqrt(m),
        ]
        for m in range(1, k.span + 1)
    ]
    return np.array(rows, np.float32)


def votes(plan: "LatticePlan", units: Units) -> Votes:
    """Return the votes between the rims of parts, in order of both units and of the steps."""
    rim = np.flatnonzero(units.rim)
    if len(np.unique(units.part[rim])) < 2:
        rim = rim[:0]
    rim = rim[np.argsort(units.part[rim], kind="stable")]
    rims = np.stack([units.corner[rim], units.part[rim]], axis=1).astype(np.int32)
    room = ROOM * plan.capacity
    found = np.zeros((0, FIELDS), np.int32)
    if len(rims):
        found = _found(plan, rims, room)
    first, second, _, _, steps, weight = found.T
    order = np.lexsort((second, first, steps))
    first, second, boundary, other, steps = found[order, :5].astype(np.int64).T
    share = np.ascontiguousarray(weight[order]).view(np.float32).astype(np.float64)
    return Votes(rim[first], rim[second], boundary, other, steps, share)


def _found(plan: "LatticePlan", rims: NDArray[np.int32], room: int) -> NDArray[np.int32]:
    k, b, flags = plan.constants, plan.buffers, cl.mem_flags.READ_WRITE
    while True:
        listed = cl.Buffer(plan.queue.context, flags, 4 * FIELDS * room)
        number = plan.constant(np.zeros(1, np.int32))
        launch = plan.stage(
            "find_votes",
            (multiple(len(rims), GROUP),),
            (GROUP,),
            **plan.corners,
            lines=b["lines"],
            contrast=b["contrast"],
            **plan.levels,
            step=b["step"],
            rims=plan.constant(rims),
            count=np.int32(len(rims)),
            ways=plan.constant(ways(plan)),
            span=np.int32(k.span),
            reach=np.float32(k.span + 0.5),
            depth=np.float32(k.side_depth_cells),
            depth_px=np.float32(k.side_depth_px),
            room=np.int32(room),
            number=number,
            votes=listed,
        )
        plan.enqueue([*plan.find_votes, launch])
        total: Any = np.zeros(1, np.int32)
        cl.enqueue_copy(plan.queue, total, number)
        if total[0] <= room:
            found = np.zeros((int(total[0]), FIELDS), np.int32)
            if len(found):
                cl.enqueue_copy(plan.queue, found, listed)
            return found
        room = int(total[0])
