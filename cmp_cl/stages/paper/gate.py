"""The contrast gate, which keeps maxima whose four sectors differ clearly in grey level."""

import math

import numpy as np

from cmp_cl.config import SectorContrast
from cmp_cl.opencl.launches import GROUP, Launch
from cmp_cl.stages import noise
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper.criteria import of_candidates

BINS = 256  # bins of the histograms of contrasts
CONTRASTS = ("inner_contrast", "contrast", "mean_difference")
NOISE_FACTOR = 6.68  # Immerkaer's estimate sums 6 sqrt(pi / 2) standard deviations; less 11 %


def sizes(plan: PlanBase) -> dict[str, int]:
    return {
        "noise": 8 * plan.frames * noise.bands(plan),
        "found": 8 * plan.frames,
        "bounds": 8 * plan.frames,
        "bins": 4 * plan.frames * BINS,
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
        plan.stage("clear_bins", (BINS, plan.frames), (GROUP, 1)),
        of_candidates(plan, "sector_contrast"),
        *_percentile(plan, gate),
        of_candidates(plan, "pass_gate"),
    ]


def _percentile(plan: PlanBase, gate: SectorContrast) -> list[Launch]:
    """Return the launches from the histogram of the inner contrasts to the bounds."""
    deep = plan.dtype == np.uint16
    levels = np.arange(2**16 if deep else 2**8)
    floor = math.ceil(gate.minimum * plan.config.grey_levels(plan.dtype) / 255)
    limit = np.maximum(np.ceil(np.float64(gate.relative) * levels), floor).astype(np.int32)
    given = {
        "noise_sums": plan.arrays["noise"],
        "limit": plan.constant(limit),
        "bands": np.uint32(noise.bands(plan)),
        "noise_factor": np.uint32(math.floor(NOISE_FACTOR * gate.noise + 0.5)),
    }

    def percentile(shift: int) -> Launch:
        return plan.few("percentile", plan.frames, 1, **given, shift=np.uint32(shift))

    if not deep:
        return [percentile(0)]
    return [percentile(8), of_candidates(plan, "histogram"), percentile(0)]
