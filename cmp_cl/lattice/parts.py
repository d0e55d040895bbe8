"""From links to numbered parts: what kernels/faces.cl and kernels/parts.cl need."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units
from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

FULL = 4  # faces around a corner inside its part


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    half_edges = 4 * plan.capacity
    names = ("face", "beyond", "part", "waiting", "faces_of_part")
    return {
        **dict.fromkeys(names, 4 * half_edges),
        "apart": 8 * half_edges,
        "cut": half_edges,
        "steps": 16 * half_edges,
        "state": 16 * half_edges,
    }


def launches(plan: "LatticePlan") -> list[Launch]:
    """Return the launches from the twins of half-edges to the parts and the numbers in them."""
    k, b, corners = plan.constants, plan.buffers, plan.corners
    links = {**corners, "twin": b["twin"]}
    faces = {**links, "face": b["face"]}
    compared = {**faces, "steps": b["steps"], "apart": b["apart"]}
    return [
        plan.of_half_edges(
            "close_faces",
            **links,
            cuts=plan.constant(np.array(k.torn_cuts, np.int32)),
            face=b["face"],
            cut=b["cut"],
            steps=b["steps"],
        ),
        plan.of_half_edges("compare_faces", **compared),
        plan.one_group(
            "number_parts",
            **faces,
            apart=b["apart"],
            tolerances=plan.constant(k.face_tolerances()),
            most_cuts=np.int32(k.cuts),
            cut=b["cut"],
            beyond=b["beyond"],
            part=b["part"],
            waiting=b["waiting"],
            state=b["state"],
            size=b["faces_of_part"],
        ),
    ]


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
