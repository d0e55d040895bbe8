"""What the host reads of the parts of a frame: nodes, and the ways across tears between them."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.kernels import VOTE

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

FULL = 4  # faces around a corner inside its part
ROOM = 16  # votes for each node of a rim, more than most tears have


def units_of(numbered: list[NDArray[np.int32]], xy: NDArray[np.float32], least: int) -> Units:
    """Return the nodes of all parts of at least so many faces, part after part.

    numbered: parts, (4 N,), states, (16 N,), and faces, (4 N,), of `number_parts` in
        kernels/parts.cl. xy: (N, 2), px.
    """
    root, state, faces = numbered
    roots = np.flatnonzero(faces >= least)
    rank = np.full(len(faces) + 1, -1)  # the last one is of half-edges without a part
    rank[roots[np.argsort(-faces[roots], kind="stable")]] = np.arange(len(roots))
    part = np.ascontiguousarray(rank[root].reshape(-1, FULL).T)
    fresh = part >= 0  # at the first boundary of a corner in its part
    for s in range(1, FULL):
        fresh[s] &= (part[s] != part[:s]).all(axis=0)
    corner, boundary = np.nonzero(fresh.T)
    order = np.argsort(part[boundary, corner], kind="stable")
    corner, boundary = corner[order], boundary[order]
    column, row, direction, _ = state.reshape(-1, FULL, 4)[corner, boundary].T
    return Units(
        corner=corner,
        part=part[boundary, corner],
        number=column + 1j * row,
        rotation=(direction - boundary) % 4,
        rim=(part[1:] != part[0]).any(axis=0)[corner],
        at=xy[corner].astype(np.float64).view(np.complex128)[:, 0],
    )


def votes(plan: "LatticePlan", units: Units) -> Votes:
    """Return the votes between the rims of parts, in order of both units and of the steps."""
    rim = np.flatnonzero(units.rim)
    found = np.zeros((0, VOTE), np.int32)
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
    if "votes" not in plan.buffers or plan.buffers["votes"].size < 4 * VOTE * room:
        plan.find_votes = plan.votes_in(1 << (room - 1).bit_length())
    plan.write("rims", rims)
    plan.write("rims_and_votes", np.array([len(rims), 0], np.int32))
    plan.enqueue(plan.find_votes)
    count = int(plan.read("rims_and_votes", np.int32)[1])
    if 4 * VOTE * count > plan.buffers["votes"].size:
        return _found(plan, rims, count)
    return plan.read("votes", np.int32, VOTE * count).reshape(count, VOTE)
