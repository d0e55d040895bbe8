"""Detector.maps: the intermediate images of a frame, read from the device."""

import dataclasses
import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import DetectorConfig, RapidCriteria
from cmp_cl.maps import Maps
from cmp_cl.stages import spectrum
from cmp_cl.stages.band_stages import RING_REACH, plane_words, words_margin
from cmp_cl.stages.plan import Plan

_RAPID_MAPS = (
    ("inner_transitions", np.uint8),
    ("outer_transitions", np.uint8),
    ("sector_difference", np.uint8),
    ("ring_difference", np.uint8),
    ("corrosion", np.int8),
)
_SPECTRAL_MAPS = ("spectrum_12", "spectrum_23", "correlation", "phase")


def read_maps(plan: Plan) -> Maps:
    """Run the stages on the frame that is on the device, and read each result before a later
    stage takes its place."""
    rapid = isinstance(plan.config.criteria, RapidCriteria)
    values: dict[str, Any] = {}
    values["contrast"] = None
    for launch in plan.front:
        plan.launch([launch])
        if launch.stage in ("repeat_border_binary", "binarize_bands"):
            if launch.stage == "binarize_bands":
                values["binary"] = _words(plan, "words", words_margin(plan))
            else:
                values["binary"] = _binary(plan)
            values |= (_rapid_maps if rapid else _spectral_maps)(plan, values["binary"])
            if plan.config.criteria.corrosion_threshold is None:
                values["corrosion"] = None
        elif launch.stage == "list_candidates":
            values["candidate"] = _at_candidates(plan, np.bool_, None)
        elif launch.stage == "rapid_criteria_words":
            values["candidate"] = _words(plan, "candidate_words", 0)
        elif launch.stage == "keep":
            if plan.config.contrast is not None:
                values["contrast"] = _at_candidates(plan, np.int32, "contrast")
        elif launch.stage == "suppress_bands":
            if plan.config.contrast is not None:
                values["contrast"] = _contrast_in_words(plan, values["candidate"])
            values |= _responses(plan)
            values["maximum"] = _maxima(plan)
        elif launch.stage == "maximum":
            values |= _responses(plan)
            values["maximum"] = _maxima(plan)
    return Maps(**values)


def _responses(plan: Plan) -> dict[str, NDArray[np.int32]]:
    rapid = isinstance(plan.config.criteria, RapidCriteria)
    kept = _plane(plan, plan.response, np.uint8 if rapid else np.uint16, planes=1)
    return {"response": kept.astype(np.int32), "score": _score_map(plan)}


def no_maps(shape: tuple[int, int], config: DetectorConfig) -> Maps:
    """The maps of an image of that shape, which has no pixel."""
    layers = (3, *shape) if config.threshold.masks == 3 else shape
    dtypes: dict[str, Any] = {"binary": np.bool_, "inner": np.uint16, "outer": np.uint16}
    dtypes["candidate"] = np.bool_
    if isinstance(config.criteria, RapidCriteria):
        dtypes |= dict(_RAPID_MAPS)
    else:
        dtypes |= {name: np.float32 for name in _SPECTRAL_MAPS} | {"corrosion": np.int8}
    if config.criteria.corrosion_threshold is None:
        del dtypes["corrosion"]
    if config.contrast is not None:
        dtypes["contrast"] = np.int32
    values: dict[str, Any] = dict.fromkeys(field.name for field in dataclasses.fields(Maps))
    values |= {name: np.empty(layers, dtype) for name, dtype in dtypes.items()}
    values |= {name: np.empty(shape, np.int32) for name in ("response", "score")}
    return Maps(**values | {"maximum": np.empty(shape, np.bool_)})


def _plane(plan: Plan, buffer: cl.Buffer, dtype: Any, planes: int) -> NDArray[Any]:
    """The planes of a buffer without their pads: (H, W), or (3, H, W)."""
    rows, columns = plan.working
    padded = np.empty((planes * rows + 2, plan.step), dtype)
    cl.enqueue_copy(plan.queue, padded, buffer)
    inside = padded[1:-1, plan.pad : plan.pad + columns].reshape(planes, rows, columns)
    return np.ascontiguousarray(inside[0] if planes == 1 else inside)


def _per_pixel(plan: Plan, name: str, outputs: list[Any], *inputs: Any) -> list[NDArray[Any]]:
    """Run a kernel that writes maps with one work-item per pixel of every mask."""
    rows = plan.working[0]
    size = (plan.masks * rows + 2) * plan.step
    buffers = [
        cl.Buffer(plan.queue.context, cl.mem_flags.WRITE_ONLY, size * np.dtype(dtype).itemsize)
        for dtype in outputs
    ]
    kernel = plan.kernels.bind(name, *inputs, np.uint32(rows), np.uint32(plan.step), *buffers)
    cl.enqueue_nd_range_kernel(plan.queue, kernel, (plan.step, rows, plan.masks), None)
    return [
        _plane(plan, buffer, dtype, plan.masks)
        for buffer, dtype in zip(buffers, outputs, strict=True)
    ]


def _binary(plan: Plan) -> NDArray[np.bool_]:
    """The masks, bit k of a pixel being its colour in mask k."""
    bits = _plane(plan, plan.arrays["binary"], np.uint8, 1)
    if plan.masks == 1:
        return bits > 0
    return np.stack([bits >> k & 1 for k in range(plan.masks)]) > 0


def _black(plan: Plan, binary: NDArray[np.bool_]) -> cl.Buffer:
    """The masks as planes of their own, with pads."""
    rows, columns = plan.working
    after = plan.step - plan.pad - columns
    planes = np.pad(
        binary.reshape(plan.masks, rows, columns), ((0, 0), (0, 0), (plan.pad, after)), "edge"
    )
    return plan.constant(np.pad(planes.reshape(-1, plan.step), ((1, 1), (0, 0))))


def _rapid_maps(plan: Plan, binary: NDArray[np.bool_]) -> dict[str, NDArray[Any] | None]:
    dtypes = [np.uint16, np.uint16, *(dtype for _, dtype in _RAPID_MAPS)]
    inner, outer, *rest = _per_pixel(plan, "ring_maps", dtypes, _black(plan, binary))
    values: dict[str, NDArray[Any] | None] = {"inner": inner, "outer": outer}
    values |= {name: values for (name, _), values in zip(_RAPID_MAPS, rest, strict=True)}
    return values | dict.fromkeys(_SPECTRAL_MAPS)


def _spectral_maps(plan: Plan, binary: NDArray[np.bool_]) -> dict[str, NDArray[Any] | None]:
    dtypes = [np.uint16, np.uint16, np.int8, np.uint8, np.uint8]
    inner, outer, corrosion, best, half_samples = _per_pixel(
        plan, "spectral_maps", dtypes, _black(plan, binary)
    )
    margins = spectrum.margins()
    smaller = np.minimum(margins[inner], margins[outer]).astype(np.float32)
    black = np.bitwise_count(np.stack([inner, outer])).astype(np.float64)
    product = np.sqrt(black[0] * black[1])
    correlation = np.divide(best, product, out=np.zeros_like(product), where=product > 0)
    return {
        **dict.fromkeys(name for name, _ in _RAPID_MAPS),
        "inner": inner,
        "outer": outer,
        "corrosion": corrosion,
        "spectrum_12": smaller[..., 0],
        "spectrum_23": smaller[..., 1],
        "correlation": correlation.astype(np.float32),
        "phase": (half_samples * math.radians(11.25)).astype(np.float32),
    }


def _at_candidates(plan: Plan, dtype: Any, name: str | None) -> NDArray[Any]:
    """A list of the candidates' numbers as an image, 0 elsewhere; 1 where no list is named."""
    rows, planes, room = plan.working[0], plan.masks, plan.candidate_room
    totals = np.empty(plan.frames * (planes + 1), np.uint32)
    places = np.empty((planes, room), np.uint32)
    numbers = np.ones((planes, room), np.int16 if plan.dtype == np.uint8 else np.int32)
    cl.enqueue_copy(plan.queue, totals, plan.arrays["totals"])
    cl.enqueue_copy(plan.queue, places, plan.arrays["candidates"])
    if name is not None:
        cl.enqueue_copy(plan.queue, numbers, plan.arrays[name])
    image = np.zeros((planes, rows * plan.step), dtype)
    for plane in range(planes):
        count = totals[plane]
        image[plane, places[plane, :count]] = numbers[plane, :count]
    inside = image.reshape(planes, rows, plan.step)[..., plan.pad :][..., : plan.working[1]]
    return inside[0] if planes == 1 else inside


def _contrast_in_words(plan: Plan, candidate: NDArray[np.bool_]) -> NDArray[np.int32]:
    """The same from the lists of the bands."""
    rows, planes, room = plan.working[0], plan.masks, plan.candidate_room
    starts = np.empty((planes, rows), np.uint32)
    contrast = np.empty((planes, room), np.int16 if plan.dtype == np.uint8 else np.int32)
    cl.enqueue_copy(plan.queue, starts, plan.arrays["row_starts"])
    cl.enqueue_copy(plan.queue, contrast, plan.arrays["contrast"])
    image = np.zeros(candidate.shape, np.int32)
    for plane in range(planes):
        at = (plane,) if planes == 3 else ()
        y, x = np.nonzero(candidate[at])
        place = starts[plane, y] + np.arange(len(y)) - np.searchsorted(y, y)
        image[(*at, y, x)] = contrast[plane, place]
    return image


def _maxima(plan: Plan) -> NDArray[np.bool_]:
    rows, columns = plan.working
    bits = np.empty((rows, plan.step // 8), np.uint8)
    cl.enqueue_copy(plan.queue, bits, plan.arrays["maxima"])
    padded = np.unpackbits(bits, axis=1, bitorder="little")
    return padded[:, plan.pad : plan.pad + columns] > 0


def _words(plan: Plan, name: str, margin: int) -> NDArray[np.bool_]:
    """Planes of words as pixels: bit k of word i is pixel 32 i + k. `margin` words come first."""
    rows, columns = plan.working
    words = np.empty(margin + plan.masks * plane_words(plan), "<u4")
    cl.enqueue_copy(plan.queue, words, plan.arrays[name])
    planes = words[margin:].reshape(plan.masks, -1).view(np.uint8)
    bits = np.unpackbits(planes, axis=1, bitorder="little")
    height = rows + 2 * RING_REACH
    padded = bits[:, : height * plan.step].reshape(plan.masks, height, plan.step)
    inside = padded[:, RING_REACH:-RING_REACH, plan.pad : plan.pad + columns] > 0
    return inside[0] if plan.masks == 1 else inside


def _score_map(plan: Plan) -> NDArray[np.int32]:
    rows, columns = plan.working
    scores = cl.Buffer(plan.queue.context, cl.mem_flags.WRITE_ONLY, 4 * rows * columns)
    sizes = (np.uint32(rows), np.uint32(plan.step))
    kernel = plan.kernels.bind("score_map", plan.response, *sizes, scores)
    cl.enqueue_nd_range_kernel(plan.queue, kernel, (columns, rows), None)
    image = np.empty((rows, columns), np.int32)
    cl.enqueue_copy(plan.queue, image, scores)
    return image
