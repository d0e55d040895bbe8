"""The stages up to the corners for CPUs: a work-item takes a band of rows, criteria 32 pixels in
a word. The results are those of `pixel_stages` to the bit, for the rapid criteria only.

Memory in passing is that of the bands, not of the image.
"""

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import RapidCriteria, SectorContrast
from cmp_cl.stages.pixel_stages import CONTRASTS, percentile_sizes, percentile_stages
from cmp_cl.stages.plan_base import Launch, PlanBase, level_type, multiple

RING_REACH = 5  # rows above and below the image in a plane of words: what rings look at
WORDS = 64  # words of a group of the criteria: small enough to share them out evenly
BEYOND = 8  # elements behind a row's running sums that a vector may reach
BEHIND = 16  # entries behind a list of contrasts that a vector may reach


def plane_words(plan: PlanBase) -> int:
    """Words of a plane, with the rows above and below."""
    return multiple((plan.working[0] + 2 * RING_REACH) * plan.step // 32, WORDS)


def words_margin(plan: PlanBase) -> int:
    """Words before and after the planes that rings may look at."""
    return multiple(RING_REACH * plan.step // 32 + 8, 32)


def files(plan: PlanBase) -> list[str]:
    """The kernel files, in the order of the stages."""
    gate = ["gate", "gate_words"] if plan.config.contrast is not None else []
    return ["binarize_bands", "criteria", "criteria_words", *gate, "nms", "nms_bands"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    return {"IN_WORDS": 1, "WORDS_MARGIN": words_margin(plan), "BEYOND": BEYOND}


def macros(plan: PlanBase) -> dict[str, str]:
    return {}


def sizes(plan: PlanBase) -> dict[str, int]:
    """Bytes of the buffers."""
    planes, words = plan.frames * plan.masks, 4 * plane_words(plan)
    plane = plan.working[0] * plan.step
    sizes = {
        "mask": words,
        "words": planes * words + 8 * words_margin(plan),
        "candidate_words": planes * words,
        "row_starts": 4 * planes * plan.working[0],
        "row_counts": 4 * plan.frames * plan.working[0],
        "maxima": plan.frames * plane // 8,
        "response": plan.frames * plane + 2 * plan.step,
    }
    if plan.config.contrast is not None:
        sizes |= percentile_sizes(plan, _bands(plan), _bands(plan))
    return sizes


def layouts(plan: PlanBase) -> list[dict[str, int]]:
    """Bytes of the arrays that are needed only in passing, see `Plan._layouts`."""
    pixel, bands = plan.dtype.itemsize, plan.frames * _bands(plan)
    row, long_row = bands * plan.step, bands * (plan.step + BEYOND)
    binarization = {"sums": 2 * pixel * row, "prefix": 4 * long_row, "black": plan.masks * row}
    if plan.masks == 3:
        binarization |= {"squares": 4 * pixel * row, "square_prefix": 4 * pixel * long_row}
    gate = plan.config.contrast is not None
    if gate:
        binarization["curved"] = 2 * pixel * row
    room = plan.frames * plan.masks * plan.candidate_room + BEHIND
    lists = dict.fromkeys((*(CONTRASTS if gate else ()), "sector_response"), 2 * pixel * room)
    kept = 2 * (2 * plan.config.nms_radius + 3) + 1  # rows of a band
    return [binarization, {**lists, "kept": 2 * kept * row}]


def allowed_places(plan: PlanBase, allowed: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The content of the buffer "mask"."""
    bits = np.zeros(plane_words(plan) * 32, np.bool_)
    rows, columns = plan.working
    image = bits[: (rows + 2 * RING_REACH) * plan.step].reshape(-1, plan.step)
    image[RING_REACH:-RING_REACH, plan.pad : plan.pad + columns] = allowed
    return np.packbits(bits, bitorder="little")


def launches(plan: PlanBase) -> list[Launch]:
    """From the image at its working scale to the maxima of the response."""
    criteria, gate = cast(RapidCriteria, plan.config.criteria), plan.config.contrast
    contrasts = _contrasts(plan, criteria) if gate is None else _gate(plan, criteria, gate)
    return [_binarize(plan), _criteria(plan, criteria), *contrasts, _suppress(plan)]


def _bands(plan: PlanBase) -> int:
    return -(-plan.working[0] // _band_rows(plan))


def _band_rows(plan: PlanBase) -> int:
    """Rows of a band. Its start costs a share of the window and the rows beside it, and eight
    bands for each of a device's units share the work out evenly."""
    share = -(-plan.working[0] // (8 * plan.device.handle.max_compute_units))
    return max(share, plan.config.threshold.window // 4, 16)


def _banded(plan: PlanBase, name: str, planes: int, *arguments: Any) -> Launch:
    """A kernel with one work-item per band of rows."""
    return plan.stage(name, (_bands(plan), planes), (1, 1), *arguments)


def _binarize(plan: PlanBase) -> Launch:
    """To words, and the noise of the bands."""
    threshold, b = plan.config.threshold, plan.arrays
    sizes = (*plan.working, plan.step, _band_rows(plan), threshold.window, plane_words(plan))
    arguments = [plan.image, *(np.uint32(n) for n in sizes), b["sums"], b["prefix"]]
    if plan.masks == 1:
        level, offset = level_type(threshold, plan.dtype)
        arguments.append(level(offset))
    else:
        arguments += [b["squares"], b["square_prefix"]]
    if plan.config.contrast is not None:
        arguments += [b["curved"], b["noise"]]
    return _banded(plan, "binarize_bands", plan.frames, *arguments, b["black"], b["words"])


def _criteria(plan: PlanBase, criteria: RapidCriteria) -> Launch:
    words, b = plane_words(plan), plan.arrays
    thresholds = (criteria.sector_threshold, criteria.ring_threshold)
    bounds = (np.int32(n) for n in (*thresholds, criteria.corrosion_threshold or 0))
    arguments = (b["words"], b["mask"], np.uint32(plan.step), np.uint32(words), *bounds)
    found = (b["candidate_words"], b["totals"])
    items = (words // 8, plan.frames * plan.masks)
    return plan.stage("rapid_criteria_words", items, (WORDS // 8, 1), *arguments, *found)


def _found(plan: PlanBase, criteria: RapidCriteria) -> tuple[Any, ...]:
    """Where the candidates are, and the sector threshold."""
    b, signed = plan.arrays, np.int32 if plan.dtype == np.uint16 else np.int16
    sizes = (plan.working[0], plan.step, plane_words(plan), plan.candidate_room, _band_rows(plan))
    counts = (np.uint32(n) for n in sizes)
    return b["words"], b["candidate_words"], *counts, signed(criteria.sector_threshold)


def _contrasts(plan: PlanBase, criteria: RapidCriteria) -> list[Launch]:
    """Without the gate: the responses of the candidates alone."""
    b, planes = plan.arrays, plan.frames * plan.masks
    lists = (b["totals"], b["row_starts"], b["sector_response"])
    return [_banded(plan, "sector_responses", planes, *_found(plan, criteria), *lists)]


def _gate(plan: PlanBase, criteria: RapidCriteria, gate: SectorContrast) -> list[Launch]:
    b, planes, bands = plan.arrays, plan.frames * plan.masks, _bands(plan)
    contrasts = (*(b[name] for name in CONTRASTS), b["sector_response"])
    lists = (b["totals"], b["row_starts"], *contrasts, b["bins_of_bands"])
    return [
        _banded(plan, "gate_words", planes, plan.image, *_found(plan, criteria), *lists),
        *percentile_stages(plan, gate, bands, b["bins_of_bands"], bands),
    ]


def _suppress(plan: PlanBase) -> Launch:
    b = plan.arrays
    rows, step, band_rows = (np.uint32(n) for n in (plan.working[0], plan.step, _band_rows(plan)))
    sizes = (rows, step, np.uint32(plane_words(plan)), np.uint32(plan.candidate_room), band_rows)
    gated = ("contrast", "mean_difference", "bounds") if plan.config.contrast is not None else ()
    lists = (b[name] for name in ("candidate_words", "row_starts", *gated, "sector_response"))
    found = (b["kept"], b["response"], b["maxima"], b["row_counts"])
    return _banded(plan, "suppress_bands", plan.frames, *lists, *sizes, *found)
