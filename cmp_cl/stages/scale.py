"""The stage from the image to its working scale."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.opencl.launches import Launch
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.resampling import resampling_weights


def files(plan: PlanBase) -> list[str]:
    return [] if plan.scale is None else ["scale"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    """Return the macros that only this kernel needs. With loops of a fixed length, compilers take
    several pixels at a time."""
    if plan.scale is None:
        return {}
    return {
        f"TAPS_{axis}": weights.shape[1] for axis, (_, weights) in _inputs(plan, plan.scale).items()
    }


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to that at its working scale."""
    if plan.scale is None:
        return []
    (first_y, weight_y), (first_x, weight_x) = _inputs(plan, plan.scale).values()
    beside = (plan.pad, plan.step - plan.pad - plan.working[1])
    resample = plan.dense(
        "resample",
        image=plan.arrays["image"],
        first_y=plan.constant(first_y),
        weight_y=plan.constant(weight_y),
        first_x=plan.constant(np.pad(first_x, beside)),
        weight_x=plan.constant(np.pad(weight_x.T, ((0, 0), beside))),
        full_rows=np.uint32(plan.shape[0]),
        full_step=np.uint32(plan.full_step),
        scaled=plan.image,
    )
    return [resample]


def _inputs(plan: PlanBase, scale: float) -> dict[str, tuple[NDArray[np.int32], NDArray[np.int32]]]:
    """Return the first inputs and the weights of the pixels along each axis."""
    return {
        axis: resampling_weights(size, working, scale)
        for axis, size, working in zip("YX", plan.shape, plan.working, strict=True)
    }
