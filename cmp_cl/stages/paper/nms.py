"""Non-maximum suppression of the candidates' responses."""

from cmp_cl.opencl.launches import Launch
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper.criteria import of_candidates


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the lists of candidates to a bit for every maximum."""
    names = ("scatter", *(["score"] if keeps_keys(plan) else []), "maximum")
    return [of_candidates(plan, name) for name in names]


def keeps_keys(plan: PlanBase) -> bool:
    """Return whether the keys are stored; otherwise each is computed when it is needed.

    A key of the rapid criteria takes two bytes a pixel; computed anew, keys add a seventh to the
    processor time of a frame of 640 x 480. A key of the spectral criteria would take four, and
    would save little of the time that those criteria take.
    """
    return plan.types["SCORE"].itemsize == 2
