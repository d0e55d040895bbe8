"""The stage from the image to its working scale."""

import numpy as np

from cmp_cl.stages.layout import GROUP, Launch, PlanBase, multiple
from cmp_cl.stages.resampling import resampling_weights


def files(plan: PlanBase) -> list[str]:
    """Return the kernel files."""
    return [] if plan.scale is None else ["scale"]


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to that at its working scale."""
    if plan.scale is None:
        return []
    (first_y, weight_y), (first_x, weight_x) = (
        resampling_weights(size, working, plan.scale)
        for size, working in zip(plan.shape, plan.working, strict=True)
    )
    resample = plan.stage(
        "resample",
        (multiple(plan.working[1], GROUP), plan.working[0], plan.frames),
        (GROUP, 1, 1),
        image=plan.arrays["image"],
        first_y=plan.constant(first_y),
        weight_y=plan.constant(weight_y),
        taps_y=np.uint32(weight_y.shape[1]),
        first_x=plan.constant(first_x),
        weight_x=plan.constant(weight_x.T),
        taps_x=np.uint32(weight_x.shape[1]),
        full_rows=np.uint32(plan.shape[0]),
        full_step=np.uint32(plan.full_step),
        **plan.size,
        scaled=plan.image,
    )
    return [resample]
