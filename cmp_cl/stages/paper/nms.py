"""Non-maximum suppression of the candidates' responses."""

from cmp_cl.opencl.launches import Launch
from cmp_cl.stages.layout import PlanBase
from cmp_cl.stages.paper.criteria import listed, of_candidates


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the lists of candidates to a bit for every maximum."""
    b, given = plan.arrays, listed(plan)
    response = {"response": b["response"]}
    key = {"key": b["key"]} if keeps_keys(plan) else {}
    found = {"row_counts": b["row_counts"], "maxima": b["maxima"]}
    scattered = {"list_of_responses": b["responses"], **response}
    score = [of_candidates(plan, "score", **given, **response, **key)] if key else []
    return [
        of_candidates(plan, "scatter", **given, **scattered),
        *score,
        of_candidates(plan, "maximum", **given, **response, **key, **found),
    ]


def keeps_keys(plan: PlanBase) -> bool:
    """Return whether the keys are stored; otherwise each is computed when it is needed.

    A key of the rapid criteria takes two bytes a pixel; computed anew, keys add a seventh to the
    processor time of a frame of 640 x 480. A key of the spectral criteria would take four, and
    would save little of the time that those criteria take.
    """
    return plan.types["SCORE"].itemsize == 2
