"""Binarization against the mean of a window."""

import numpy as np

from cmp_cl.config import BinaryRings
from cmp_cl.opencl.launches import Launch
from cmp_cl.opencl.program import sum_of_terms
from cmp_cl.stages.layout import PlanBase


def macros(plan: PlanBase, rule: BinaryRings) -> dict[str, str]:
    """Return the macros for the sum of a window's column and for the sum of column sums.

    As many terms are added in their own type as it can hold.
    """
    window = rule.threshold.window
    terms = [f"F({k})" for k in range(-(window // 2), window // 2 + 1)]
    fits = window if plan.dtype == np.uint16 else 65535 // (255 * window)
    groups = [
        f"(T)({sum_of_terms(terms[start : start + fits], 'SUM_OF_COLUMN')})"
        for start in range(0, window, fits)
    ]
    return {
        "WINDOW_SUM(T, F)": sum_of_terms(terms, "T"),
        "WIDE_SUM(T, F)": sum_of_terms(groups, "T"),
    }


def launches(plan: PlanBase, rule: BinaryRings) -> list[Launch]:
    """Return the launches from the image to the binary image, and to empty lists."""
    threshold, frame_rows = rule.threshold, plan.frames * plan.shape[0]
    column, level = plan.types["SUM_OF_COLUMN"].type, plan.types["LEVEL"].type
    # A mean of bytes is never above 255.
    offset = threshold.offset if plan.dtype == np.uint16 else min(threshold.offset, 255)
    levels = {"count": level(threshold.window**2), "offset": level(offset), "zero": np.uint32(0)}
    return [
        plan.few("repeat_border", frame_rows, 1),
        plan.dense("column_sums", zero=column(0)),
        plan.dense("binarize", **levels),
        plan.few("repeat_border_binary", frame_rows, 1),
    ]
