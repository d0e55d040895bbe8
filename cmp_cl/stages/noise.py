"""The noise of an image, for the grey-level rule and for the contrast gate."""

from cmp_cl.opencl.launches import Launch
from cmp_cl.stages.layout import PlanBase

NOISE_BAND = 8  # rows of a work-item


def bands(plan: PlanBase) -> int:
    """Return the number of bands of a frame, each of which has a sum."""
    return -(-plan.working[0] // NOISE_BAND)


def scratch(plan: PlanBase) -> dict[str, int]:
    """Return the bytes of the temporary arrays."""
    return {"noise_sums": plan.types["NOISE"].itemsize * plan.frames * bands(plan) * plan.step}


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to the sums of its bands."""
    b, size = plan.arrays, plan.size
    return [
        plan.stage(
            "noise",
            (plan.step, bands(plan), plan.frames),
            (plan.width, 1, 1),
            image=plan.image,
            rows=size["rows"],
            step=size["step"],
            zero=plan.types["CURVATURE"].type(0),
            sums=b["noise_sums"],
        ),
        plan.few(
            "noise_of_band",
            bands(plan),
            plan.frames,
            sums=b["noise_sums"],
            columns=size["columns"],
            step=size["step"],
            noise=b["noise"],
        ),
    ]
