"""The intermediate images of a frame, read from a plan in the portable form.

A stage of that form leaves its result on the device; each is read before a later stage takes its
buffer.
"""

import dataclasses
import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import BinaryRings, RapidCriteria, RingHarmonic
from cmp_cl.corners import HarmonicMaps, Maps
from cmp_cl.opencl.memory import copy
from cmp_cl.stages.layout import CORNER_COLUMNS, LISTS
from cmp_cl.stages.paper import spectral
from cmp_cl.stages.plan import Plan

_RAPID_MAPS = {
    "inner": np.uint16,
    "outer": np.uint16,
    "inner_transitions": np.uint8,
    "outer_transitions": np.uint8,
    "sector_difference": np.uint8,
    "ring_difference": np.uint8,
    "corrosion": np.int8,
}


def read_maps(plan: Plan) -> Maps | HarmonicMaps:
    """Run the stages on the frame on the device, and return the maps of each stage."""
    if isinstance(plan.rule, RingHarmonic):
        return HarmonicMaps(**_harmonic_maps(plan))
    return Maps(**_ring_maps(plan, plan.rule))


def _plane(plan: Plan, buffer: cl.Buffer, dtype: Any) -> NDArray[Any]:
    """Return a plane without its padding, (H, W)."""
    rows, columns = plan.shape
    padded = np.empty((rows + 2, plan.step), dtype)
    copy(plan.queue, padded, buffer)
    return np.ascontiguousarray(padded[1:-1, plan.pad : plan.pad + columns])


def _bits(plan: Plan, name: str) -> NDArray[np.bool_]:
    """Return a buffer of bits as an image."""
    rows, columns = plan.shape
    bits = np.empty((rows, plan.step // 8), np.uint8)
    copy(plan.queue, bits, plan.arrays[name])
    padded = np.unpackbits(bits, axis=1, bitorder="little")
    return padded[:, plan.pad : plan.pad + columns] > 0


def _harmonic_maps(plan: Plan) -> dict[str, Any]:
    values: dict[str, Any] = {"fine_response": None}
    for launch in plan.launches:
        plan.launch([launch])
        if launch.stage in ("coarse_response", "fine_response"):
            response = _plane(plan, plan.arrays["response"], np.int16)
            values[launch.stage] = response.astype(np.int32)
        elif launch.stage == "coarse_maxima":
            for name in ("fine", "coarse"):
                values[name] = _plane(plan, plan.arrays[name], np.uint16)
        elif launch.stage == "decide":
            values["maximum"] = _at_corners(plan)
    return values


def _at_corners(plan: Plan) -> NDArray[np.bool_]:
    """Return an image that is True at the pixel of the frame nearest to each corner."""
    counts = np.empty(LISTS + 1, np.uint32)
    copy(plan.queue, counts, plan.arrays["counts"])
    columns = np.zeros((CORNER_COLUMNS, plan.corner_capacity), np.int32)
    copy(plan.queue, columns, plan.arrays["corners"])
    x, y, *_, octave = columns[:, : counts[-1]]
    image = np.zeros(plan.shape, np.bool_)
    image[(y << octave) + (1 << octave >> 1), (x << octave) + (1 << octave >> 1)] = True
    return image


def _ring_maps(plan: Plan, rule: BinaryRings) -> dict[str, Any]:
    values: dict[str, Any] = dict.fromkeys(field.name for field in dataclasses.fields(Maps))
    for launch in plan.launches:
        plan.launch([launch])
        if launch.stage == "repeat_border_binary":
            values["binary"] = _plane(plan, plan.arrays["binary"], np.uint8) > 0
            rapid = isinstance(rule.criteria, RapidCriteria)
            values |= (_rapid_maps if rapid else _spectral_maps)(plan)
            if rule.criteria.corrosion_threshold is None:
                values["corrosion"] = None
        elif launch.stage == "list_candidates":
            values["candidate"] = _at_candidates(plan, np.bool_, None)
        elif launch.stage == "sector_contrast":
            contrast = _at_candidates(plan, np.int32, "contrast")
            none = np.iinfo(plan.types["CONTRAST"]).min
            values["contrast"] = np.where(contrast == none, 0, contrast)
        elif launch.stage == "maximum":
            response = _plane(plan, plan.arrays["response"], plan.types["RESPONSE"])
            (score,) = _per_pixel(plan, "score_map", [np.int32], plan.arrays["response"])
            values |= {"response": response.astype(np.int32), "score": score}
    return values | {"maximum": _bits(plan, "maxima" if rule.contrast is None else "passed")}


def _per_pixel(plan: Plan, name: str, outputs: list[Any], *inputs: Any) -> list[NDArray[Any]]:
    """Run a kernel that writes maps with one work-item per pixel."""
    rows = plan.shape[0]
    size = (rows + 2) * plan.step
    buffers = [
        cl.Buffer(plan.queue.context, cl.mem_flags.WRITE_ONLY, size * np.dtype(dtype).itemsize)
        for dtype in outputs
    ]
    kernel = plan.kernels.bind(name, *inputs, np.uint32(rows), np.uint32(plan.step), *buffers)
    items, group = (plan.step, rows, 1), (plan.width, 1, 1)
    cl.enqueue_nd_range_kernel(plan.queue, kernel, items, group)
    return [_plane(plan, buffer, dtype) for buffer, dtype in zip(buffers, outputs, strict=True)]


def _rapid_maps(plan: Plan) -> dict[str, NDArray[Any] | None]:
    found = _per_pixel(plan, "ring_maps", list(_RAPID_MAPS.values()), plan.arrays["binary"])
    return dict(zip(_RAPID_MAPS, found, strict=True))


def _spectral_maps(plan: Plan) -> dict[str, NDArray[Any] | None]:
    dtypes = [np.uint16, np.uint16, np.int8, np.uint8, np.uint8]
    inner, outer, corrosion, best, half_samples = _per_pixel(
        plan, "spectral_maps", dtypes, plan.arrays["binary"]
    )
    margins = spectral.margins()
    smaller = np.minimum(margins[inner], margins[outer]).astype(np.float32)
    black = np.bitwise_count(np.stack([inner, outer])).astype(np.float64)
    product = np.sqrt(black[0] * black[1])
    correlation = np.divide(best, product, out=np.zeros_like(product), where=product > 0)
    return {
        "inner": inner,
        "outer": outer,
        "corrosion": corrosion,
        "spectrum_12": smaller[..., 0],
        "spectrum_23": smaller[..., 1],
        "correlation": correlation.astype(np.float32),
        "phase": (half_samples * math.radians(11.25)).astype(np.float32),
    }


def _at_candidates(plan: Plan, dtype: Any, name: str | None) -> NDArray[Any]:
    """Return an image of a number for each candidate, 1 if no list is named, and 0 elsewhere."""
    rows, capacity = plan.shape[0], plan.list_capacity
    counts = np.empty(2, np.uint32)
    index = np.empty(capacity, np.uint32)
    numbers = np.ones(capacity, plan.types["CONTRAST"])
    copy(plan.queue, counts, plan.arrays["counts"])
    copy(plan.queue, index, plan.arrays["candidates"])
    if name is not None:
        copy(plan.queue, numbers, plan.arrays[name])
    image = np.zeros(rows * plan.step, dtype)
    image[index[: counts[0]]] = numbers[: counts[0]]
    return image.reshape(rows, plan.step)[:, plan.pad :][:, : plan.shape[1]]
