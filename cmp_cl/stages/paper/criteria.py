"""The four criteria on the two rings of a binary image: the candidates."""

from typing import Any, cast

import numpy as np

from cmp_cl.config import BinaryRings, RapidCriteria, SpectralCriteria
from cmp_cl.opencl.launches import GROUP, Launch
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper import spectral


def launches(plan: PlanBase, rule: BinaryRings) -> list[Launch]:
    """Return the launches from the binary image to the list of candidates."""
    rapid = isinstance(rule.criteria, RapidCriteria)
    return [(_rapid if rapid else _spectral)(plan, rule), _collect(plan)]


def _rapid(plan: PlanBase, rule: BinaryRings) -> Launch:
    criteria, b = cast(RapidCriteria, rule.criteria), plan.arrays
    return plan.dense(
        "rapid_criteria",
        binary=b["binary"],
        rows=plan.size["rows"],
        step=plan.size["step"],
        sector_threshold=np.uint8(criteria.sector_threshold),
        ring_threshold=np.uint8(criteria.ring_threshold),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
        zero=np.uint8(0),
        response=b["response"],
    )


def _spectral(plan: PlanBase, rule: BinaryRings) -> Launch:
    criteria, b = cast(SpectralCriteria, rule.criteria), plan.arrays
    inner_response, outer_passes = spectral.response_tables()
    least = spectral.least_correlation(criteria.correlation)
    return plan.dense(
        "spectral_criteria",
        binary=b["binary"],
        area=b["area"],
        inner_response=plan.constant(inner_response),
        outer_passes=plan.constant(outer_passes),
        least_correlation=plan.constant(least),
        rows=plan.size["rows"],
        step=plan.size["step"],
        phase_bound=np.int32(spectral.phase_bound(criteria.phase)),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
        response=b["response"],
    )


def _collect(plan: PlanBase) -> Launch:
    b = plan.arrays
    return plan.stage(
        "list_candidates",
        (plan.step // 8, plan.working[0], plan.frames),
        (plan.width // 8, 1, 1),
        response=b["response"],
        area=b["area"],
        rows=plan.size["rows"],
        step=plan.size["step"],
        capacity=np.uint32(plan.list_capacity),
        list=b["candidates"],
        list_of_responses=b["responses"],
        counts=b["counts"],
    )


def of_candidates(plan: PlanBase, name: str, **arguments: Any) -> Launch:
    """Bind a kernel with one work-item per entry of the list of candidates."""
    items = (plan.list_capacity, plan.frames)
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
