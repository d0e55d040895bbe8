"""Ways across tears, which vote for where parts lie: what kernels/votes.cl needs."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

FIELDS = 6  # of a vote
ROOM = 16  # votes for each node of a rim, more than most tears have


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers. That of the votes is made for the first torn frame."""
    return {"step": 4 * plan.capacity, "rims": 8 * 4 * plan.capacity, "rims_and_votes": 8}


def launches(plan: "LatticePlan", room: int) -> list[Launch]:
    """Return the launches that find so many votes."""
    k, b = plan.constants, plan.buffers
    b["votes"] = plan.buffer("votes", 4 * FIELDS * room)
    return [
        plan.of_corners("mean_steps", **plan.corners, twin=b["twin"], step=b["step"]),
        plan.of_half_edges(
            "find_votes",
            **plan.corners,
            lines=b["lines"],
            contrast=b["contrast"],
            **plan.levels,
            step=b["step"],
            rims=b["rims"],
            ways=plan.constant(ways(plan)),
            reach=np.float32(k.span + 0.5),
            depth=np.float32(k.side_depth_cells),
            depth_px=np.float32(k.side_depth_px),
            room=np.int32(room),
            rims_and_votes=b["rims_and_votes"],
            votes=b["votes"],
        ),
    ]


def ways(plan: "LatticePlan") -> NDArray[np.float32]:
    """Return what a way of so many steps must have, (span, 4), see kernels/votes.cl."""
    k = plan.constants
    rows = [
        [
            k.least_cosine,
            1 / m,
            2 / (len(k.side_points) * m),
            1 / np.sqrt(m),
        ]
        for m in range(1, k.span + 1)
    ]
    return np.array(rows, np.float32)


def votes(plan: "LatticePlan", units: Units) -> Votes:
    """Return the votes between the rims of parts, in order of both units and of the steps."""
    rim = np.flatnonzero(units.rim)
    found = np.zeros((0, FIELDS), np.int32)
    if len(rim) and units.part[rim[0]] < units.part[rim[-1]]:
        part = units.part[rim]
        after = np.searchsorted(part, part, side="right")
        rims = np.stack([units.corner[rim], after], axis=1).astype(np.int32)
        found = _found(plan, rims, ROOM * len(rims))
    first, second, _, _, steps, weight = found.T
    order = np.lexsort((second, first, steps))
    first, second, boundary, other, steps = found[order, :5].astype(np.int64).T
    share = np.ascontiguousarray(weight[order]).view(np.float32).astype(np.float64)
    return Votes(rim[first], rim[second], boundary, other, steps, share)


def _found(plan: "LatticePlan", rims: NDArray[np.int32], room: int) -> NDArray[np.int32]:
    """Return the votes between nodes of rims, in any order."""
    if "votes" not in plan.buffers or plan.buffers["votes"].size < 4 * FIELDS * room:
        plan.find_votes = launches(plan, 1 << (room - 1).bit_length())
    plan.write("rims", rims)
    plan.write("rims_and_votes", np.array([len(rims), 0], np.int32))
    plan.enqueue(plan.find_votes)
    count = int(plan.read("rims_and_votes", np.int32)[1])
    if 4 * FIELDS * count > plan.buffers["votes"].size:
        return _found(plan, rims, count)
    return plan.read("votes", np.int32, FIELDS * count).reshape(count, FIELDS)
