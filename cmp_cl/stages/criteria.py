"""The four criteria on the two rings of a binary image: the candidates of each threshold layer."""

from typing import Any, cast

import numpy as np

from cmp_cl.config import BinaryRings, RapidCriteria, SpectralCriteria
from cmp_cl.opencl.launches import GROUP, Launch
from cmp_cl.stages import spectral
from cmp_cl.stages.layout import PlanBase


def launches(plan: PlanBase, rule: BinaryRings) -> list[Launch]:
    """Return the launches from the binary images to the lists of candidates."""
    stages = []
    for layer in range(rule.threshold.masks):
        rapid = isinstance(rule.criteria, RapidCriteria)
        stages.append((_rapid if rapid else _spectral)(plan, rule, layer))
        stages.append(_collect(plan, layer))
    return stages


def _rapid(plan: PlanBase, rule: BinaryRings, layer: int) -> Launch:
    criteria, b = cast(RapidCriteria, rule.criteria), plan.arrays
    return plan.dense(
        "rapid_criteria",
        binary=b["binary"],
        to_top=np.uint8(128 >> layer),
        rows=plan.size["rows"],
        step=plan.size["step"],
        sector_threshold=np.uint8(criteria.sector_threshold),
        ring_threshold=np.uint8(criteria.ring_threshold),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
        zero=np.uint8(0),
        response=b["response"],
    )


def _spectral(plan: PlanBase, rule: BinaryRings, layer: int) -> Launch:
    criteria, b = cast(SpectralCriteria, rule.criteria), plan.arrays
    inner_response, outer_passes = spectral.response_tables()
    least = spectral.least_correlation(criteria.correlation)
    return plan.dense(
        "spectral_criteria",
        binary=b["binary"],
        area=b["area"],
        layer=np.uint32(layer),
        inner_response=plan.constant(inner_response),
        outer_passes=plan.constant(outer_passes),
        least_correlation=plan.constant(least),
        rows=plan.size["rows"],
        step=plan.size["step"],
        phase_bound=np.int32(spectral.phase_bound(criteria.phase)),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
        response=b["response"],
    )


def _collect(plan: PlanBase, layer: int) -> Launch:
    b = plan.arrays
    return plan.stage(
        "list_candidates",
        (plan.step // 8, plan.working[0], plan.frames),
        (plan.width // 8, 1, 1),
        response=b["response"],
        area=b["area"],
        layer=np.uint32(layer),
        rows=plan.size["rows"],
        step=plan.size["step"],
        capacity=np.uint32(plan.list_capacity),
        list=b["candidates"],
        list_of_responses=b["responses"],
        counts=b["counts"],
    )


def of_candidates(plan: PlanBase, name: str, **arguments: Any) -> Launch:
    """Bind a kernel with one work-item per entry of the lists of candidates."""
    items = (plan.list_capacity, plan.frames * plan.lists)
    return plan.stage(name, items, (GROUP, 1), **arguments)


def listed(plan: PlanBase) -> dict[str, Any]:
    """Return the arguments of a kernel over the candidates, by name."""
    return {
        "list": plan.arrays["candidates"],
        "counts": plan.arrays["counts"],
        "rows": plan.size["rows"],
        "step": plan.size["step"],
        "capacity": np.uint32(plan.list_capacity),
    }
