"""From the image and its corners to links: what kernels/bins.cl and kernels/links.cl need."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cmp_cl.opencl.launches import Launch

if TYPE_CHECKING:
    from cmp_cl.lattice.plan import LatticePlan

DIRECTIONS = 1024  # unit vectors in a full turn


def sizes(plan: "LatticePlan") -> dict[str, int]:
    """Return the bytes of the buffers."""
    corners, (rows, columns) = plan.capacity, plan.shape
    # A bin is as large as a quarter of the area of a corner, or larger, and 4 px wide or wider.
    bins = 4 * corners + rows // 4 + columns // 4 + 2
    return {
        "levels": 2 * rows * plan.step,
        "lines": 16 * corners,
        "contrast": 4 * corners,
        "starts": 4 * bins,
        "binned": 4 * corners,
        "first": 16 * corners,
        "choice": 16 * corners,
        "twin": 16 * corners,
    }


def launches(plan: "LatticePlan") -> list[Launch]:
    """Return the launches from the image and the corners to the twins of half-edges."""
    k, b = plan.constants, plan.buffers
    rows, columns = plan.size["rows"], plan.size["columns"]
    corners, bins = plan.corners, {name: b[name] for name in ("layout", "starts", "binned")}
    price = {
        "least_cosine": np.float32(k.least_cosine),
        "turn_price": np.float32(k.turn_price),
    }
    side = {
        "depth": np.float32(k.side_depth_cells),
        "depth_px": np.float32(k.side_depth_px),
    }
    return [
        plan.stage(
            "smooth_levels",
            (plan.step, plan.shape[0]),
            (plan.width, 1),
            image=b["image"],
            step=np.uint32(plan.step),
            full_scale=np.uint32(plan.full_scale),
            **plan.size,
            levels=b["levels"],
        ),
        plan.of_corners(
            "direct_corners",
            **corners,
            **plan.levels,
            circle=plan.constant(circle()),
            radius=np.float32(k.contrast_radius_px),
            lines=b["lines"],
            contrast=b["contrast"],
        ),
        plan.one_group("fill_bins", **corners, rows=rows, columns=columns, **bins),
        plan.of_corners(
            "choose_near",
            **corners,
            lines=b["lines"],
            **bins,
            rows=rows,
            columns=columns,
            rings=np.int32(k.link_rings),
            **price,
            first=b["first"],
        ),
        plan.of_half_edges(
            "choose_mutual",
            **corners,
            **plan.levels,
            **side,
            first=b["first"],
            choice=b["choice"],
        ),
        plan.of_corners(
            "choose_far",
            **corners,
            lines=b["lines"],
            **bins,
            **plan.levels,
            neighbours=np.int32(k.link_neighbours),
            rings=np.int32(k.link_rings),
            **price,
            **side,
            choice=b["choice"],
        ),
        plan.of_half_edges("keep_mutual", **corners, choice=b["choice"], twin=b["twin"]),
    ]


def circle() -> NDArray[np.float32]:
    """Return the cosines of the directions, in steps of 2^-14."""
    cosine = np.cos(np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS))
    rounded: NDArray[np.float32] = (np.rint(16384 * cosine) / 16384).astype(np.float32)
    return rounded
