"""The noise of an image, for the grey-level rule and for the contrast gate."""

import numpy as np

from cmp_cl.opencl.launches import GROUP, Launch
from cmp_cl.stages.layout import PlanBase

NOISE_BAND = 8  # rows of a work-item


def bands(plan: PlanBase, octave: int = 0) -> int:
    """Return the number of bands of an octave of a frame, each of which has a sum."""
    return -(-(plan.shape[0] >> octave) // NOISE_BAND)


def scratch(plan: PlanBase) -> dict[str, int]:
    return {"noise_sums": plan.types["NOISE"].itemsize * plan.frames * bands(plan) * plan.step}


def launches(plan: PlanBase, octave: int = 0) -> list[Launch]:
    """Return the launches from the image of an octave to the sums of its bands."""
    count, sums = bands(plan, octave), plan.arrays["noise_sums"]
    return [
        plan.dense("noise", count, octave, zero=plan.types["CURVATURE"].type(0), sums=sums),
        plan.stage(
            "sum_bands",
            (GROUP * count, plan.frames),
            (GROUP, 1),
            octave,
            octave=np.uint32(octave),
            bands=np.uint32(bands(plan)),
            sums=sums,
        ),
    ]
