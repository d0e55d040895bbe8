"""From links to numbered parts: what kernels/faces.cl and kernels/parts.cl need."""

from typing import TYPE_CHECKING

import numpy as np

from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan


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
