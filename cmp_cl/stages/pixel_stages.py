"""The stages up to the corners with one work-item per pixel: what runs on any device.

From the image to the maxima of the response; `refine_stages` goes on from there. `band_stages`
has the same results in the form that is fastest on CPUs.
"""

import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import RapidCriteria, SectorContrast, SpectralCriteria
from cmp_cl.opencl.program import sum_of_terms
from cmp_cl.stages import spectrum
from cmp_cl.stages.plan_base import GROUP, Launch, PlanBase, level_type

NOISE_BAND = 8  # rows that a work-item of the noise estimate takes
CONTRASTS = ("inner_contrast", "contrast", "mean_difference")
BINS = 256
SLAB = 3  # bytes of sums a pixel: what three masks need is worked out slab by slab


def files(plan: PlanBase) -> list[str]:
    """The kernel files, in the order of the stages."""
    rapid = isinstance(plan.config.criteria, RapidCriteria)
    gate = ["gate"] if plan.config.contrast is not None else []
    return ["binarize", "criteria" if rapid else "spectral", "collect", *gate, "nms"]


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
    plane = plan.working[0] * plan.step
    image = plan.frames * plane + 2 * plan.step
    sizes = {
        "mask": plane // 8,
        "binary": image,
        "response": _bytes_of_results(plan)[0] * image,
        "candidates": 4 * planes * plan.candidate_room,
        "maxima": plan.frames * plane // 8,
        "row_counts": 4 * plan.frames * plan.working[0],
    }
    if plan.config.contrast is not None:
        sizes |= percentile_sizes(plan, _bands(plan))
    return sizes


def layouts(plan: PlanBase) -> list[dict[str, int]]:
    """Bytes of the arrays that are needed only in passing, see `Plan._layouts`."""
    pixel = plan.dtype.itemsize
    slab = (plan.frames * _slab_rows(plan) + 2) * plan.step
    binarization = {"sums": 2 * pixel * slab}
    if plan.masks == 3:
        binarization["squares"] = 4 * pixel * slab
    response, key = _bytes_of_results(plan)
    room = plan.frames * plan.masks * plan.candidate_room
    lists = {"responses": response * room}
    if plan.config.contrast is not None:
        lists["noise_sums"] = 2 * pixel * plan.frames * _bands(plan) * plan.step
        lists |= dict.fromkeys(CONTRASTS, 2 * pixel * room)
    return [binarization, lists, {"key": key * (plan.frames * plan.working[0] + 2) * plan.step}]


def allowed_places(plan: PlanBase, allowed: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The content of the buffer "mask"."""
    after = plan.step - plan.pad - plan.working[1]
    return np.packbits(np.pad(allowed, ((0, 0), (plan.pad, after))), bitorder="little")


def launches(plan: PlanBase) -> list[Launch]:
    """From the image at its working scale to the maxima of the response."""
    gate = plan.config.contrast
    stages = [*_binarize(plan)]
    for layer in range(plan.masks):
        stages += _criteria(plan, np.uint32(layer))
    if gate is not None:
        stages += _gate(plan, gate)
    return stages + _suppress(plan)


def _bytes_of_results(plan: PlanBase) -> tuple[int, int]:
    """Of a response and of a key of suppression."""
    return (1, 2) if isinstance(plan.config.criteria, RapidCriteria) else (2, 4)


def _slab_rows(plan: PlanBase) -> int:
    """Rows of a slab of the binarization."""
    if plan.masks == 1:
        return plan.working[0]
    return -(-plan.working[0] // (6 * plan.dtype.itemsize // SLAB))


def _bands(plan: PlanBase) -> int:
    """Bands of rows of the noise estimate."""
    return -(-plan.working[0] // NOISE_BAND)


def _dense(plan: PlanBase, name: str, *arguments: Any, rows: int | None = None) -> Launch:
    """A kernel with one work-item per pixel of rows with their pads."""
    items = (plan.step, rows or plan.working[0], plan.frames)
    return plan.stage(name, items, (plan.width, 1, 1), *arguments)


def _of_candidates(plan: PlanBase, name: str, *arguments: Any) -> Launch:
    """A kernel with one work-item per entry of the list of candidates."""
    items = (plan.candidate_room, plan.frames * plan.masks)
    return plan.stage(name, items, (GROUP, 1), *arguments)


def _listed(plan: PlanBase) -> tuple[Any, ...]:
    """What a kernel over the candidates is given first."""
    sizes = (plan.working[0], plan.step, plan.candidate_room)
    return plan.arrays["candidates"], plan.arrays["totals"], *(np.uint32(n) for n in sizes)


def _binarize(plan: PlanBase) -> list[Launch]:
    rows, columns, step = (np.uint32(n) for n in (*plan.working, plan.step))
    frame_rows, b = plan.frames * plan.working[0], plan.arrays
    stages = [plan.rows("repeat_border", frame_rows, 1, rows, columns, step, plan.image)]
    for first in range(0, plan.working[0], _slab_rows(plan)):
        stages += _binarize_slab(plan, first)
    emptied = (b["totals"], b["row_counts"], b["maxima"])
    border = (rows, columns, step, b["binary"], *emptied)
    return [*stages, plan.rows("repeat_border_binary", frame_rows, 1, *border)]


def _binarize_slab(plan: PlanBase, first: int) -> list[Launch]:
    """Rows from the first one on."""
    threshold, b = plan.config.threshold, plan.arrays
    deep = plan.dtype == np.uint16
    column = np.uint32 if deep else np.uint16
    count, slab = threshold.window**2, _slab_rows(plan)
    rows = min(slab, plan.working[0] - first)
    sizes = tuple(np.uint32(n) for n in (plan.working[0], plan.step, first, slab))
    stages = [_dense(plan, "column_sums", plan.image, *sizes, column(0), b["sums"], rows=rows)]
    if plan.masks == 1:
        level, offset = level_type(threshold, plan.dtype)
        levels = (level(count), level(offset), np.uint32(0))
        given = (plan.image, b["sums"], *sizes, *levels, b["binary"])
        return [*stages, _dense(plan, "binarize", *given, rows=rows)]
    zero = np.uint64(0) if deep else np.uint32(0)
    squared = (plan.image, *sizes, zero, b["squares"])
    counts = (np.uint64(count), np.uint64(0))
    given = (plan.image, b["sums"], b["squares"], *sizes, *counts, b["binary"])
    return [
        *stages,
        _dense(plan, "column_squares", *squared, rows=rows),
        _dense(plan, "binarize_three", *given, rows=rows),
    ]


def _criteria(plan: PlanBase, layer: np.uint32) -> list[Launch]:
    """The candidates of one mask."""
    criteria, b = plan.config.criteria, plan.arrays
    corrosion = np.int8(criteria.corrosion_threshold or 0)
    sizes = (np.uint32(plan.working[0]), np.uint32(plan.step))
    if isinstance(criteria, SpectralCriteria):
        tables = (*spectrum.response_tables(), spectrum.least_correlation(criteria.correlation))
        bounds = (np.int32(spectrum.phase_bound(criteria.phase)), corrosion)
        constants = (plan.constant(table) for table in tables)
        given = (b["binary"], b["mask"], layer, *constants, *sizes, *bounds, b["response"])
        dense = _dense(plan, "spectral_criteria", *given)
    else:
        both = (np.uint8(criteria.sector_threshold), np.uint8(criteria.ring_threshold))
        bounds_of_bytes = (*both, corrosion, np.uint8(0))
        given = (b["binary"], np.uint8(128 >> layer), *sizes, *bounds_of_bytes, b["response"])
        dense = _dense(plan, "rapid_criteria", *given)
    room = np.uint32(plan.candidate_room)
    lists = (b["candidates"], b["responses"], b["totals"])
    given = (b["response"], b["mask"], layer, *sizes, room, *lists)
    eights = (plan.step // 8, plan.working[0], plan.frames)
    return [dense, plan.stage("list_candidates", eights, None, *given)]


def _gate(plan: PlanBase, gate: SectorContrast) -> list[Launch]:
    rows, columns, step = (np.uint32(n) for n in (*plan.working, plan.step))
    b, bands = plan.arrays, _bands(plan)
    signed = np.int32 if plan.dtype == np.uint16 else np.int16
    noise = (plan.image, rows, step, signed(0), b["noise_sums"])
    summed = (b["noise_sums"], columns, step, b["noise"], b["bins"])
    contrasts = [b[name] for name in CONTRASTS]
    given = (plan.image, b["binary"], *_listed(plan), *contrasts, b["bins"])
    return [
        plan.stage("noise", (plan.step, bands, plan.frames), (plan.width, 1, 1), *noise),
        plan.rows("noise_of_band", bands, plan.frames, *summed),
        _of_candidates(plan, "sector_contrast", *given),
        *percentile_stages(plan, gate, bands, b["bins"], 1),
    ]


def percentile_sizes(plan: PlanBase, bands: int, parts: int = 0) -> dict[str, int]:
    """Bytes of the buffers of `percentile_stages`; parts: of the counts, beside the bins."""
    planes = plan.frames * plan.masks
    sizes = {"noise": 8 * plan.frames * bands, "found": 8 * planes, "bounds": 8 * planes}
    if parts:
        sizes["bins_of_bands"] = 4 * planes * parts * BINS
    if plan.dtype == np.uint16 or not parts:
        sizes["bins"] = 4 * planes * BINS
    return sizes


def percentile_stages(
    plan: PlanBase, gate: SectorContrast, bands: int, counts: cl.Buffer, parts: int
) -> list[Launch]:
    """From the inner contrasts of the candidates to the bounds of the gate.

    bands: those of the noise; counts: how often the highest eight bits of the contrasts occur, in
    so many parts for each plane.
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
    bins = b.get("bins", counts)

    def percentile(counts: cl.Buffer, parts: int, shift: int) -> Launch:
        given = (counts, b["totals"], b["noise"], limit, rows, columns)
        sizes = (np.uint32(bands), room, np.uint32(shift), np.uint32(parts), factor)
        left = (bins, b["found"], b["bounds"])
        return plan.rows("percentile", planes, 1, *given, *sizes, *left)

    if not deep:
        return [percentile(counts, parts, 0)]
    lower = (b["inner_contrast"], b["totals"], b["found"], room, bins)
    return [
        percentile(counts, parts, 8),
        _of_candidates(plan, "histogram", *lower),
        percentile(bins, 1, 0),
    ]


def _suppress(plan: PlanBase) -> list[Launch]:
    b, listed = plan.arrays, _listed(plan)
    gated = ("contrast", "mean_difference", "bounds") if plan.config.contrast is not None else ()
    kept = (*(b[name] for name in gated), b["responses"], b["response"])
    found = (b["response"], b["key"], b["maxima"], b["row_counts"])
    return [
        _of_candidates(plan, "keep", *listed, *kept),
        _of_candidates(plan, "score", *listed, b["response"], b["key"]),
        _of_candidates(plan, "maximum", *listed, *found),
    ]
