"""The stages up to the corners with one work-item per pixel: what runs on any device.

From the image to the list of corners; `refine_stages` goes on from there. `band_stages` has the
same results in the form that is fastest on CPUs.
"""

import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl import spectrum
from cmp_cl.config import RapidCriteria, SectorContrast, SpectralCriteria
from cmp_cl.plan_base import GROUP, Launch, PlanBase, level_type
from cmp_cl.program import sum_of_terms

NOISE_BAND = 8  # rows that a work-item of the noise estimate takes
CHANNELS = 48  # samples that the gate copies per candidate: inner, outer, colours
CONTRASTS = ("inner_contrast", "contrast", "mean_difference", "sector_response")
BINS = 256


def files(plan: PlanBase) -> list[str]:
    """The kernel files, in the order of the stages."""
    rapid = isinstance(plan.config.criteria, RapidCriteria)
    gate = ["gate"] if plan.config.contrast is not None else []
    return ["binarize", "criteria" if rapid else "spectral", *gate, "nms", "collect"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    return {"IN_WORDS": 0, "NOISE_BAND": NOISE_BAND}


def macros(plan: PlanBase) -> dict[str, str]:
    """Those of binarize.cl: the sum over the window, and the one of sums of columns, as many of
    which are added in their own type as it can hold."""
    window = plan.config.threshold.window
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


def sizes(plan: PlanBase) -> dict[str, int]:
    """Bytes of the buffers."""
    planes = plan.frames * plan.masks
    plane, spare = plan.working[0] * plan.step, 2 * plan.step
    response, score = _bytes_of_results(plan)
    sizes = {
        "mask": plane + spare,
        "row_counts": 4 * planes * plan.working[0],
        "binary": planes * plane + spare,
        "responses": response * (planes * plane + spare),
        "zeros": score * plan.step,
    }
    if plan.masks == 3:
        sizes["response"] = response * (plan.frames * plane + spare)
    if plan.config.contrast is not None:
        sizes["candidates"] = 8 * planes * plan.candidate_room
        sizes |= percentile_sizes(plan, _bands(plan))
    return sizes


def layouts(plan: PlanBase) -> list[dict[str, int]]:
    """Bytes of the arrays that are needed only in passing, see `Plan._layouts`."""
    pixel = plan.dtype.itemsize
    plane = (plan.frames * plan.working[0] + 2) * plan.step
    score = _bytes_of_results(plan)[1]
    layouts = [{"sums": 2 * pixel * plane}]
    if plan.masks == 3:
        layouts[0]["squares"] = 4 * pixel * plane
    if plan.config.contrast is not None:
        layouts.append({"noise_sums": 2 * pixel * plan.frames * _bands(plan) * plan.step})
        room = plan.frames * plan.masks * plan.candidate_room
        lists = dict.fromkeys(CONTRASTS, 2 * pixel * room)
        if isinstance(plan.config.criteria, RapidCriteria):
            lists["samples"] = CHANNELS * pixel * room
        layouts.append(lists)
    return [*layouts, {"key": score * plane, "tent": score * plane}]


def allowed_places(plan: PlanBase, allowed: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The content of the buffer "mask"."""
    rows, columns = plan.working
    plane = np.zeros((rows + 2, plan.step), np.uint8)
    plane[1:-1, plan.pad : plan.pad + columns] = allowed
    return plane


def launches(plan: PlanBase) -> list[Launch]:
    """From the image at its working scale to the list of the corners."""
    stages = [*_binarize(plan), *_criteria(plan)]
    if plan.config.contrast is not None:
        stages += _list(plan, "candidates", plan.masks, plan.arrays["responses"], 0)
        stages += _gate(plan, plan.config.contrast)
    return stages + _suppress(plan)


def _bytes_of_results(plan: PlanBase) -> tuple[int, int]:
    """Of a response and of a key of suppression."""
    return (1, 2) if isinstance(plan.config.criteria, RapidCriteria) else (4, 4)


def _bands(plan: PlanBase) -> int:
    """Bands of rows of the noise estimate."""
    return -(-plan.working[0] // NOISE_BAND)


def _dense(plan: PlanBase, name: str, planes: int, *arguments: Any) -> Launch:
    """A kernel with one work-item per pixel of rows with their pads."""
    items = (plan.step, plan.working[0], planes)
    return plan.stage(name, items, (plan.width, 1, 1), *arguments)


def _of_candidates(plan: PlanBase, name: str, *arguments: Any) -> Launch:
    """A kernel with one work-item per entry of the list of candidates."""
    items = (plan.candidate_room, plan.frames * plan.masks)
    return plan.stage(name, items, (GROUP, 1), *arguments)


def _binarize(plan: PlanBase) -> list[Launch]:
    threshold = plan.config.threshold
    rows, columns, step = (np.uint32(n) for n in (*plan.working, plan.step))
    deep = plan.dtype == np.uint16
    column = np.uint32 if deep else np.uint16
    count = threshold.window**2
    planes, b = plan.frames * plan.masks, plan.arrays
    size, image = (rows, columns, step), (plan.image, rows, step)
    stages = [
        plan.rows("repeat_border", plan.frames * plan.working[0], 1, *size, plan.image),
        _dense(plan, "column_sums", plan.frames, *image, column(0), b["sums"]),
    ]
    if plan.masks == 1:
        level, offset = level_type(threshold, plan.dtype)
        levels = (level(count), level(offset), np.uint32(0))
        images = (plan.image, b["sums"], rows, step)
        stages.append(_dense(plan, "binarize", plan.frames, *images, *levels, b["binary"]))
    else:
        zero = np.uint64(0) if deep else np.uint32(0)
        both = (plan.image, b["sums"], b["squares"], rows, step)
        counts = (np.uint64(count), np.uint64(0))
        stages += [
            _dense(plan, "column_squares", plan.frames, *image, zero, b["squares"]),
            _dense(plan, "binarize_three", plan.frames, *both, *counts, b["binary"]),
        ]
    border = plan.rows("repeat_border_binary", planes * plan.working[0], 1, *size, b["binary"])
    return [*stages, border]


def _criteria(plan: PlanBase) -> list[Launch]:
    criteria = plan.config.criteria
    corrosion = np.int8(criteria.corrosion_threshold or 0)
    rows, step = np.uint32(plan.working[0]), np.uint32(plan.step)
    b = plan.arrays
    planes = plan.frames * plan.masks
    images = (b["binary"], b["mask"])
    if isinstance(criteria, SpectralCriteria):
        tables = (*spectrum.response_tables(), spectrum.least_correlation(criteria.correlation))
        bounds = (np.int32(spectrum.phase_bound(criteria.phase)), corrosion)
        constants = (plan.constant(table) for table in tables)
        arguments = (*images, *constants, rows, step, *bounds, b["responses"])
        return [_dense(plan, "spectral_criteria", planes, *arguments)]
    thresholds = (np.uint8(criteria.sector_threshold), np.uint8(criteria.ring_threshold), corrosion)
    arguments = (*images, rows, step, *thresholds, np.uint8(0), b["responses"])
    return [_dense(plan, "rapid_criteria", planes, *arguments)]


def _list(plan: PlanBase, what: str, masks: int, image: cl.Buffer, place: int) -> list[Launch]:
    """The two stages that list the pixels of an image that are not 0."""
    rows, columns, step = (np.uint32(n) for n in (*plan.working, plan.step))
    b, planes = plan.arrays, plan.frames * masks
    candidates = what == "candidates"
    room = np.uint32(plan.candidate_room if candidates else plan.corner_room)
    counts = (image, rows, columns, step, b["row_counts"])
    listed = (image, b["row_counts"], rows, columns, step, room, np.uint32(place))
    lists = (b["candidates" if candidates else "corners"], b["totals"])
    return [
        plan.rows(f"count_{what}", plan.working[0], planes, *counts),
        plan.rows(f"list_{what}", plan.working[0], planes, *listed, *lists),
    ]


def _gate(plan: PlanBase, gate: SectorContrast) -> list[Launch]:
    rows, columns, step = (np.uint32(n) for n in (*plan.working, plan.step))
    b, room = plan.arrays, np.uint32(plan.candidate_room)
    deep = plan.dtype == np.uint16
    signed, pixel = (np.int32, np.uint16) if deep else (np.int16, np.uint8)
    bands = _bands(plan)
    noise = (plan.image, rows, step, signed(0), b["noise_sums"])
    summed = (b["noise_sums"], columns, step, b["noise"], b["bins"])
    contrasts = [b[name] for name in CONTRASTS]
    listed = (b["candidates"], b["totals"], rows, step, room)
    stages = [
        plan.stage("noise", (plan.step, bands, plan.frames), (plan.width, 1, 1), *noise),
        plan.rows("noise_of_band", bands, plan.frames, *summed),
    ]
    criteria, images = plan.config.criteria, (plan.image, b["binary"])
    if isinstance(criteria, RapidCriteria):
        samples = (b["samples"], room, signed(criteria.sector_threshold), pixel(0), *contrasts)
        stages += [
            _of_candidates(plan, "sample_rings", *images, *listed, b["samples"]),
            _of_candidates(plan, "sector_contrast", *samples),
        ]
    else:
        arguments = (*images, *listed, *contrasts[:3])
        stages.append(_of_candidates(plan, "sector_contrast_any", *arguments))
    stages += percentile_stages(plan, gate, bands)
    keep = (*contrasts[1:], *listed[:2], b["bounds"], *listed[2:], b["responses"])
    return [*stages, _of_candidates(plan, "keep", *keep)]


def percentile_sizes(plan: PlanBase, bands: int, *, counted: bool = False) -> dict[str, int]:
    """Bytes of the buffers of `percentile_stages`."""
    planes = plan.frames * plan.masks
    sizes = {"noise": 8 * plan.frames * bands, "found": 8 * planes, "bounds": 8 * planes}
    if counted:
        sizes["bins_of_bands"] = 4 * planes * bands * BINS
    if plan.dtype == np.uint16 or not counted:
        sizes["bins"] = 4 * planes * BINS
    return sizes


def percentile_stages(
    plan: PlanBase, gate: SectorContrast, bands: int, *, counted: bool = False
) -> list[Launch]:
    """From the inner contrasts of the candidates to the bounds of the gate.

    bands: those of the noise; counted: for each of them the highest eight bits are in
    "bins_of_bands".
    """
    deep = plan.dtype == np.uint16
    levels = np.arange(2**16 if deep else 2**8)
    floor = math.ceil(gate.minimum * plan.config.grey_levels(plan.dtype) / 255)
    limit = plan.constant(
        np.maximum(np.ceil(np.float64(gate.relative) * levels), floor).astype(np.int32)
    )
    least_noise = gate.noise if plan.masks == 1 else max(gate.noise, 3)
    factor = np.uint32(math.floor(6.68 * least_noise + 0.5))
    rows, columns, room = (np.uint32(n) for n in (*plan.working, plan.candidate_room))
    b, planes = plan.arrays, plan.frames * plan.masks
    stages = []
    for shift in (8, 0) if deep else (0,):
        bins = b["bins" if "bins" in b else "bins_of_bands"]
        if not counted:
            listed = (b["inner_contrast"], b["totals"], b["found"], room, np.uint32(shift))
            stages.append(_of_candidates(plan, "histogram", *listed, bins))
        counts, parts = (b["bins_of_bands"], bands) if counted else (bins, 1)
        given = (counts, b["totals"], b["noise"], limit, rows, columns)
        sizes = (np.uint32(bands), room, np.uint32(shift), np.uint32(parts), factor)
        left = (bins, b["found"], b["bounds"])
        stages.append(plan.rows("percentile", planes, 1, *given, *sizes, *left))
        counted = False
    return stages


def _suppress(plan: PlanBase) -> list[Launch]:
    rows, step = np.uint32(plan.working[0]), np.uint32(plan.step)
    rapid = isinstance(plan.config.criteria, RapidCriteria)
    b, frames = plan.arrays, plan.frames
    stages = []
    if plan.masks == 3:
        stages.append(_dense(plan, "combine", frames, b["responses"], rows, step, b["response"]))
    response, key, rest = response_of(plan), b["key"], b["tent"]
    common = (rows, step, np.uint16(0) if rapid else np.int32(0))
    # What the binary image was needed for is over: the maxima take its place.
    return [
        *stages,
        _dense(plan, "tent_rows", frames, response, *common, rest),
        _dense(plan, "score", frames, response, rest, b["zeros"], *common, key),
        _dense(plan, "row_maximum", frames, key, *common, rest),
        _dense(plan, "maximum", frames, key, rest, b["zeros"], *common, b["binary"]),
        *_list(plan, "maxima", 1, b["binary"], frames * plan.masks),
    ]


def response_of(plan: PlanBase) -> cl.Buffer:
    """The response that suppression looks at."""
    return plan.arrays["response" if plan.masks == 3 else "responses"]
