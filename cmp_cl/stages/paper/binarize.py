"""Binarization against the mean of a window."""

import numpy as np

from cmp_cl.config import BinaryRings
from cmp_cl.opencl.launches import Launch
from cmp_cl.opencl.program import sum_of_terms
from cmp_cl.stages.layout import PlanBase

SLAB = 2  # bytes of sums per pixel; larger sums are computed slab by slab


def macros(plan: PlanBase, rule: BinaryRings) -> dict[str, str]:
    """Return the macros for the sum of a window's column and for the sum of column sums.

    As many terms are added in their own type as it can hold.
    """
    window = rule.threshold.window
    terms = [f"F({k})" for k in range(-(window // 2), window // 2 + 1)]
    fits = window if plan.dtype == np.uint16 else 65535 // (255 * window)
    groups = [
        f"(T)({sum_of_terms(terms[start : start + fits], 'COLUMN')})"
        for start in range(0, window, fits)
    ]
    return {
        "WINDOW_SUM(T, F)": sum_of_terms(terms, "T"),
        "WIDE_SUM(T, F)": sum_of_terms(groups, "T"),
    }


def scratch(plan: PlanBase) -> dict[str, int]:
    """Return the bytes of the temporary arrays."""
    slab = (plan.frames * _slab_rows(plan) + 2) * plan.step
    return {"sums": plan.types["COLUMN"].itemsize * slab}


def launches(plan: PlanBase, rule: BinaryRings) -> list[Launch]:
    """Return the launches from the image to the binary image, and to empty lists."""
    frame_rows, b = plan.frames * plan.working[0], plan.arrays
    stages = [plan.few("repeat_border", frame_rows, 1, **plan.size, image=plan.image)]
    for first in range(0, plan.working[0], _slab_rows(plan)):
        stages += _slab(plan, rule, first)
    emptied = {"counts": b["counts"], "row_counts": b["row_counts"]}
    if rule.contrast is not None:
        emptied["passed"] = b["passed"]
    border = plan.few(
        "repeat_border_binary",
        frame_rows,
        1,
        **plan.size,
        binary=b["binary"],
        **emptied,
        maxima=b["maxima"],
    )
    return [*stages, border]


def _slab_rows(plan: PlanBase) -> int:
    return -(-plan.working[0] // (plan.types["COLUMN"].itemsize // SLAB))


def _slab(plan: PlanBase, rule: BinaryRings, first: int) -> list[Launch]:
    """Return the launches for the slab of rows from `first` on."""
    b, threshold, slab = plan.arrays, rule.threshold, _slab_rows(plan)
    height = min(slab, plan.working[0] - first)
    window = {
        "rows": plan.size["rows"],
        "step": plan.size["step"],
        "first": np.uint32(first),
        "slab": np.uint32(slab),
    }
    column, count = plan.types["COLUMN"].type, threshold.window**2
    image, sums = {"image": plan.image}, {"sums": b["sums"]}
    stages = [plan.dense("column_sums", height, **image, **window, zero=column(0), **sums)]
    level = plan.types["LEVEL"].type
    # A mean of bytes is never above 255.
    offset = threshold.offset if plan.dtype == np.uint16 else min(threshold.offset, 255)
    levels = {"count": level(count), "offset": level(offset), "zero": np.uint32(0)}
    given = {**image, **sums, **window, **levels, "binary": b["binary"]}
    return [*stages, plan.dense("binarize", height, **given)]
