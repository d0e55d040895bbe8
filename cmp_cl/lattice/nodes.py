"""From numbered parts to the nodes of a board: what kernels/nodes.cl needs."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.links import LEAST_CONTRAST
from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

# In the layout, see kernels/lattice.clh.
ROWS, COLUMNS, SIGN, DROPPED, ENTERED, STATE, PARTS = 3, 4, 5, 8, 9, 10, 11
LAYOUT = 12  # numbers in it
RUNS = 1
ANY = 2**31 - 1  # number of parts
TILES = 16  # places for each tile, at least: a board has margins
OUTSIDE = -9.0  # nats of a node outside the image


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    places, corners = plan.places, plan.capacity
    four = dict.fromkeys(("owner", "cell", "score", "candidate", "key"), 4 * places)
    eight = dict.fromkeys(("seen", "at", "result", "sides", "cells", "found"), 8 * places)
    return {
        **four,
        **eight,
        "layout": 4 * LAYOUT,
        "predictions": 16 * places,
        "torn": places,
        "rough": places,
        "sides_of": places,
        "tried": places,
        "changed": places // TILES,
        "fresh": places // TILES,
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
    """Return the launch from the numbers of corners to a board, empty if there are more parts."""
    b = plan.buffers
    return [
        plan.one_group(
            "lay_board",
            **plan.corners,
            numbers=b["numbers"],
            places=np.int32(plan.places),
            most_parts=np.int32(most_parts),
            nats=plan.nats,
            layout=b["layout"],
            **{name: b[name] for name in ("seen", "owner", "torn", "used", "tried", "changed")},
        )
    ]


def a_pass(plan: "LatticePlan") -> list[Launch]:
    """Return the launches of a pass: nodes are dropped, or if none is, nodes are found."""
    k, corners, image, nats = plan.constants, plan.corners, plan.levels, {"nats": plan.nats}

    def some(*names: str) -> dict[str, object]:
        return {name: plan.buffers[name] for name in names}

    nodes = some("seen", "owner", "torn", "used", "changed")
    return [
        plan.one_group(
            "begin_pass", rounds=np.int32(k.rounds), **some("layout", "changed", "fresh")
        ),
        plan.of_places(
            "blend_nodes",
            **corners,
            **nats,
            **some(
                "layout",
                "fresh",
                "seen",
                "torn",
                "at",
                "result",
                "rough",
                "predictions",
                "best_score",
                "best_place",
            ),
        ),
        plan.of_places(
            "measure_nodes",
            **image,
            **nats,
            **some("layout", "fresh", "at", "cell", "sides", "cells"),
        ),
        plan.of_places(
            "score_nodes",
            **image,
            **nats,
            **some("layout", "fresh", "seen", "at", "predictions", "cell", "sides", "cells"),
            **some("score", "sides_of"),
        ),
        plan.of_places(
            "drop_nodes",
            **nats,
            **some("layout", "score", "sides_of"),
            **nodes,
        ),
        plan.of_places(
            "find_nodes",
            **corners,
            **image,
            **nats,
            **some("layout", "starts", "binned", "at", "cells", "used", "tried"),
            **some("candidate", "found", "key", "best_score"),
        ),
        plan.of_places(
            "claim_corners", **some("layout", "candidate", "key", "best_score", "best_place")
        ),
        plan.of_places(
            "enter_nodes",
            **corners,
            **nats,
            **some("layout", "candidate", "found", "best_place"),
            **nodes,
            **some("tried"),
        ),
    ]


def nats(plan: "LatticePlan") -> NDArray[np.float32]:
    """Return the constants of the score, in the order of kernels/nodes.cl."""
    k = plan.constants
    firm, loose = (0.5 / sd**2 for sd in (k.firm_sd_cells, k.loose_sd_cells))
    return np.array(
        [
            *(k.side_depth_cells, k.side_depth_px, 1 / len(k.side_points), LEAST_CONTRAST),
            k.cell_depth,
            k.rough_weight_per_px2,
            *(k.side_nats, k.cells_nats, k.prior_nats),
            *(firm, loose),
            *(k.stay_nats, k.stay_nats - 1, k.enter_nats, OUTSIDE),
            *(k.reach_cells, k.near_cells, k.edge_px),
        ],
        np.float32,
    )
