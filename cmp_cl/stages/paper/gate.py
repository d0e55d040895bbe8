"""The contrast gate, which keeps maxima whose four sectors differ clearly in grey level."""

import math

import numpy as np

from cmp_cl.config import SectorContrast
from cmp_cl.opencl.launches import Launch
from cmp_cl.stages import noise
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper.criteria import of_candidates

RANK_GROUP = 256  # work-items that find the percentile
CONTRASTS = ("inner_contrast", "contrast", "mean_difference")
NOISE_FACTOR = 6.68  # Immerkaer's estimate sums 6 sqrt(pi / 2) standard deviations; less 11 %


def sizes(plan: PlanBase) -> dict[str, int]:
    return {
        "noise": 8 * plan.frames * noise.bands(plan),
        "bounds": 8 * plan.frames,
        "passed": plan.frames * plan.shape[0] * plan.step // 8,
    }


def scratch(plan: PlanBase) -> dict[str, int]:
    capacity = plan.frames * plan.list_capacity
    contrasts = dict.fromkeys(CONTRASTS, plan.types["CONTRAST"].itemsize * capacity)
    return {**noise.scratch(plan), **contrasts}


def launches(plan: PlanBase, gate: SectorContrast) -> list[Launch]:
    """Return the launches from the maxima to a bit for every maximum that passes."""
    return [
        *noise.launches(plan),
        of_candidates(plan, "sector_contrast"),
        _percentile(plan, gate),
        of_candidates(plan, "pass_gate"),
    ]


def _percentile(plan: PlanBase, gate: SectorContrast) -> Launch:
    """Return the launch from the inner contrasts to the bounds."""
    levels = np.arange(2**16 if plan.dtype == np.uint16 else 2**8)
    floor = math.ceil(gate.minimum * plan.config.grey_levels(plan.dtype) / 255)
    limit = np.maximum(np.ceil(np.float64(gate.relative) * levels), floor).astype(np.int32)
    given = {
        "noise_sums": plan.arrays["noise"],
        "limit": plan.constant(limit),
        "bands": np.uint32(noise.bands(plan)),
        "noise_factor": np.uint32(math.floor(NOISE_FACTOR * gate.noise + 0.5)),
    }
    return plan.of_groups("percentile", 1, RANK_GROUP, **given)
