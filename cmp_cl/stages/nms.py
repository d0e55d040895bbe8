"""Non-maximum suppression of the candidates' responses."""

from cmp_cl.stages.criteria import listed, of_candidates
from cmp_cl.stages.layout import Launch, PlanBase


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the lists of candidates to a bit for every maximum."""
    b, given = plan.arrays, listed(plan)
    response, key = {"response": b["response"]}, {"key": b["key"]}
    found = {"row_counts": b["row_counts"], "maxima": b["maxima"]}
    spread = {"list_of_responses": b["responses"], **response}
    return [
        of_candidates(plan, "spread", **given, **spread),
        of_candidates(plan, "score", **given, **response, **key),
        of_candidates(plan, "maximum", **given, **response, **key, **found),
    ]
