"""From numbered parts to the nodes of a board: what kernels/nodes.cl needs."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

PARTS, LAYOUT = 7, 8  # in the layout, see kernels/lattice.clh: the parts; numbers in all
ANY = 2**31 - 1  # number of parts
ROUNDS = 12  # times that nodes are looked for, three less than the margin in kernels/nodes.cl
LISTS = 8  # of places, see `settle_nodes`


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    places, corners = plan.places, plan.capacity
    names = ("owner", "cell", "score", "candidate", "key", "listed", "asked", "marks")
    four = dict.fromkeys(names, 4 * places)
    eight = dict.fromkeys(("seen", "at", "result", "sides", "cells", "found"), 8 * places)
    return {
        **four,
        **eight,
        "lists": 4 * LISTS * places,
        "layout": 4 * LAYOUT,
        "predictions": 16 * places,
        "torn": places,
        "rough": places,
        "tried": places,
        "numbers": 16 * corners,
        "used": corners,
        "best_score": 4 * corners,
        "best_place": 4 * corners,
    }


def first_board(plan: "LatticePlan") -> list[Launch]:
    """Return the launch from the parts to the numbers of the corners of the largest."""
    b = plan.buffers
    return [
        plan.one_group(
            "number_corners",
            **plan.corners,
            part=b["part"],
            state=b["state"],
            size=b["faces_of_part"],
            least_part=np.int32(plan.constants.least_part),
            numbers=b["numbers"],
            layout=b["layout"],
        )
    ]


def lay(plan: "LatticePlan", most_parts: int) -> list[Launch]:
    """Return the launches from the numbers of corners to a board whose nodes are settled, empty if
    there are more parts."""
    corners, image, nats = plan.corners, plan.levels, {"nats": plan.nats}

    def some(*names: str) -> dict[str, object]:
        return {name: plan.buffers[name] for name in names}

    nodes = some("seen", "owner", "torn", "used")
    positions = some("at", "result", "rough", "predictions")
    measures = some("cell", "sides", "cells")
    claims = some("best_score", "best_place")
    return [
        plan.one_group(
            "lay_board",
            **corners,
            **some("numbers"),
            places=np.int32(plan.places),
            most_parts=np.int32(most_parts),
            **nats,
            **some("layout"),
            **nodes,
            **claims,
            **some("tried", "marks"),
        ),
        plan.of_places("blend_nodes", **nats, **some("layout", "seen", "torn"), **positions),
        plan.of_places("measure_nodes", **image, **nats, **some("layout", "at"), **measures),
        plan.of_places(
            "score_nodes",
            **image,
            **nats,
            **some("layout", "seen", "at", "predictions"),
            **measures,
            **some("score"),
        ),
        plan.one_group(
            "settle_nodes",
            **corners,
            **image,
            **nats,
            rounds=np.int32(ROUNDS),
            **some("starts", "binned", "layout"),
            **nodes,
            **some("tried"),
            **positions,
            **measures,
            **some("score"),
            **some("candidate", "found", "key", "listed", "asked"),
            **claims,
            **some("marks", "lists"),
            places=np.int32(plan.places),
        ),
    ]


def nats(plan: "LatticePlan") -> NDArray[np.float32]:
    """Return the constants of the score, in the order of kernels/nodes.cl."""
    k = plan.constants
    firm = 0.5 / k.firm_sd_cells**2
    return np.array(
        [
            *(k.side_depth_cells, k.side_depth_px, 1 / len(k.side_points)),
            k.cell_depth,
            k.rough_weight_per_px2,
            *(k.side_nats, k.cells_nats, k.prior_nats),
            *(firm, firm / 4),  # an extrapolation is half as good
            *(k.stay_nats, 2 * k.stay_nats),
            *(k.reach_cells, k.near_cells, k.contrast_radius_px),
        ],
        np.float32,
    )
