"""The paper's rule, from the image to the list of its corners.

The order is binarize, criteria, nms, gate, and the list of the corners with the moments of the
response.
"""

from typing import cast

import numpy as np

from cmp_cl.config import BinaryRings, RapidCriteria
from cmp_cl.opencl.launches import Launch
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper import binarize, criteria, gate, nms


def files(plan: PlanBase) -> list[str]:
    rule = _rule(plan)
    rapid = isinstance(rule.criteria, RapidCriteria)
    gated = ["noise", "gate"] if rule.contrast is not None else []
    kind = "criteria" if rapid else "spectral"
    return ["border", "binarize", kind, "collect", "nms", *gated, "centroid"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    rule = _rule(plan)
    return {
        "OUTER_RADIUS": rule.outer_radius,
        "RAPID": int(isinstance(rule.criteria, RapidCriteria)),
        "GATE": int(rule.contrast is not None),
        "KEYS": int(nms.keeps_keys(plan)),
        "CORROSION": int(rule.criteria.corrosion_threshold is not None),
    }


def macros(plan: PlanBase) -> dict[str, str]:
    return binarize.macros(plan, _rule(plan))


def sizes(plan: PlanBase) -> dict[str, int]:
    plane = plan.shape[0] * plan.step
    image = plan.frames * plane + 2 * plan.step
    rule = _rule(plan)
    return {
        "area": plane // 8,
        "binary": image,
        "candidates": 4 * plan.frames * plan.list_capacity,
        "maxima": plan.frames * plane // 8,
        "row_counts": 4 * plan.frames * plan.shape[0],
        **(gate.sizes(plan) if rule.contrast is not None else {}),
    }


def scratch(plan: PlanBase) -> list[dict[str, int]]:
    """Return the bytes of the temporary arrays, layout by layout.

    The sums of binarization are not needed any more when there are responses. These lie at the
    start of every other layout, and so stay.
    """
    rule = _rule(plan)
    element = plan.types["RESPONSE"].itemsize
    plane = (plan.frames * plan.shape[0] + 2) * plan.step
    lists = {"responses": element * plan.frames * plan.list_capacity}
    keys = {"key": plan.types["SCORE"].itemsize * plane} if nms.keeps_keys(plan) else {}
    gated = {} if rule.contrast is None else gate.scratch(plan)
    response = {"response": element * plane}
    return [
        {"sums": plan.types["SUM_OF_COLUMN"].itemsize * plane},
        *({**response, **later} for later in (lists, keys, gated)),
    ]


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to the list of corners."""
    rule = _rule(plan)
    gated = [] if rule.contrast is None else gate.launches(plan, rule.contrast)
    kept = {
        "capacity": np.uint32(plan.corner_capacity),
        "maxima": plan.arrays["passed" if gated else "maxima"],
    }
    return [
        *binarize.launches(plan, rule),
        *criteria.launches(plan, rule),
        *nms.launches(plan),
        *gated,
        plan.few("list_maxima", plan.shape[0], plan.frames, **kept),
        plan.of_corners("centroid"),
    ]


def _rule(plan: PlanBase) -> BinaryRings:
    return cast(BinaryRings, plan.rule)
