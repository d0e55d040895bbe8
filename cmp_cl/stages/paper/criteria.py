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
    items, group = (plan.step // 8, plan.shape[0], plan.frames), (plan.width // 8, 1, 1)
    return [
        (_rapid if rapid else _spectral)(plan, rule),
        plan.stage("list_candidates", items, group, **_lists(plan)),
    ]


def _rapid(plan: PlanBase, rule: BinaryRings) -> Launch:
    criteria = cast(RapidCriteria, rule.criteria)
    return plan.dense(
        "rapid_criteria",
        sector_threshold=np.uint8(criteria.sector_threshold),
        ring_threshold=np.uint8(criteria.ring_threshold),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
        zero=np.uint8(0),
    )


def _spectral(plan: PlanBase, rule: BinaryRings) -> Launch:
    criteria = cast(SpectralCriteria, rule.criteria)
    inner_response, outer_passes = spectral.response_tables()
    least = spectral.least_correlation(criteria.correlation)
    return plan.dense(
        "spectral_criteria",
        inner_response=plan.constant(inner_response),
        outer_passes=plan.constant(outer_passes),
        least_correlation=plan.constant(least),
        phase_bound=np.int32(spectral.phase_bound(criteria.phase)),
        corrosion_threshold=np.int8(criteria.corrosion_threshold or 0),
    )


def of_candidates(plan: PlanBase, name: str) -> Launch:
    """Bind a kernel with one work-item per entry of the list of candidates."""
    return plan.stage(name, (plan.list_capacity, plan.frames), (GROUP, 1), **_lists(plan))


def _lists(plan: PlanBase) -> dict[str, Any]:
    """Return the lists of the candidates and of their responses, by argument."""
    return {"list": plan.arrays["candidates"], "list_of_responses": plan.arrays["responses"]}
