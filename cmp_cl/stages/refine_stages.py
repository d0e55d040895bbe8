"""The stages from the maxima of the response to positions: corner by corner from a list of them, or
for CPUs eight at a time in a vector.
"""

import math
from typing import Any

import numpy as np
import pyopencl as cl

from cmp_cl.config import EdgeLines, EdgeStep, Midlines
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.stages.plan_base import GROUP, Launch, PlanBase

RESULT_HEAD = 16  # numbers before the fields of a frame, like the next of kernels/refine.cl
RESULT_FIELDS = 12
POSITION, PIXEL, EDGES = slice(0, 2), slice(2, 4), slice(4, 8)
RESPONSE, METHOD, VARIANCE, CORRELATION = 8, 9, 10, 11
PLACE_FIELDS = START_FIELDS = 2
LINE_FIELDS = 6
LANES = 8
SHARES = 32  # for each of a device's units, of the corners
BANDS = 8  # for each of a device's units, of the rows that are listed
RADII = (3, 4, 5)  # of the rings, px of the working image
RING_SAMPLES = 32


def files(plan: PlanBase) -> list[str]:
    """The kernel files, in the order of the stages."""
    if not _by_eight(plan):
        return ["refine"]
    step = ["edge_step_eight"] if isinstance(plan.config.refinement, EdgeStep) else []
    return ["refine", "refine_eight", *step]


def lanes(plan: PlanBase) -> int:
    """Corners that a work-item takes."""
    return LANES if _by_eight(plan) else 1


def layout(plan: PlanBase) -> dict[str, int]:
    """Bytes of what the kernels leave to one another, see `Plan._layouts`."""
    refinement = plan.config.refinement
    step = isinstance(refinement, EdgeStep)
    fields = {}
    if not _by_eight(plan):
        fields["corners"] = PLACE_FIELDS
    if step or not _by_eight(plan):
        fields["start"] = START_FIELDS
    if step:
        fields["lines"] = LINE_FIELDS
    return {name: 4 * n * plan.frames * plan.corner_room for name, n in fields.items()}


def result_size(plan: PlanBase) -> int:
    """Bytes of the result of a frame."""
    return 4 * (RESULT_HEAD + RESULT_FIELDS * plan.corner_room)


def launches(plan: PlanBase) -> list[Launch]:
    """From the maxima to positions."""
    refinement, b = plan.config.refinement, plan.arrays
    given = (b["totals"], np.uint32(plan.working[0]), np.uint32(plan.step), *_rows(plan))
    if _by_eight(plan):
        found = (plan.response, b["image"], b["maxima"], b["row_counts"])
        arguments = (*found, *given, _largest_shift(plan), *_scaled(plan))
        between = (b["start"], b["lines"]) if isinstance(refinement, EdgeStep) else ()
        stages = [_of_corners(plan, "refine_eight", *arguments, *between, b["result"])]
    else:
        scale, size = np.float32(plan.scale or 1), (np.uint32(n) for n in plan.shape)
        places = (scale, *size, b["start"], b["result"])
        listed = (plan.response, b["corners"], *given, *places)
        stages = [_list(plan), _of_corners(plan, "centroid", *listed)]
        if refinement is not None:
            stages.append(_lines(plan, refinement))
    if isinstance(refinement, EdgeStep):
        stages.append(_step(plan, refinement))
    return stages


def _list(plan: PlanBase) -> Launch:
    """The list of the corners."""
    rows, b = plan.working[0], plan.arrays
    band = 1
    if plan.device.kind is DeviceKind.CPU:
        band = -(-rows // (BANDS * plan.device.handle.max_compute_units))
    sizes = (rows, plan.step, plan.corner_room, plan.frames * plan.masks, band)
    counts = (np.uint32(n) for n in sizes)
    given = (b["maxima"], b["row_counts"], *counts, b["corners"], b["totals"])
    return plan.rows("list_maxima", -(-rows // band), plan.frames, *given)


def _by_eight(plan: PlanBase) -> bool:
    lines = isinstance(plan.config.refinement, EdgeLines | EdgeStep)
    return lines and plan.device.kind is DeviceKind.CPU


def _of_corners(plan: PlanBase, name: str, *arguments: Any) -> Launch:
    """A kernel over the list of corners: one each, or some work-items that share them out."""
    if not _by_eight(plan):
        return plan.stage(name, (plan.corner_room, plan.frames), (GROUP, 1), *arguments)
    shares = min(SHARES * plan.device.handle.max_compute_units, plan.corner_room // LANES)
    return plan.stage(name, (shares, plan.frames), (1, 1), *arguments)


def _scaled(plan: PlanBase) -> tuple[Any, ...]:
    """What rings around corners of a scaled image need: the scale, the full image's size, how far
    they reach from the start, and their samples."""
    if plan.scale is None:
        return ()
    sizes = (*plan.shape, plan.full_step, math.ceil(RADII[-1] / plan.scale) + 1)
    return np.float32(plan.scale), *(np.uint32(n) for n in sizes), _ring_samples(plan, plan.scale)


def _ring_samples(plan: PlanBase, scale: float) -> cl.Buffer:
    """(rings, 32, 8) float32, see RING_32 in kernels/refine.cl."""
    angle = np.arange(RING_SAMPLES) * (math.tau / RING_SAMPLES)
    circle = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    place = np.float32(np.array(RADII)[:, None, None] / scale * circle)
    pixel = np.floor(place)
    parts = (place, np.roll(place, -1, axis=1) - place, pixel, place - pixel)
    return plan.constant(np.concatenate(parts, axis=2))


def _lines(plan: PlanBase, refinement: EdgeLines | EdgeStep | Midlines) -> Launch:
    """From the starts to where the lines through the edge points meet, one by one."""
    b = plan.arrays
    rows, columns, step = (np.uint32(n) for n in (*plan.shape, plan.full_step))
    arguments = [b["image"], b["start"], b["totals"], rows, columns, step, *_rows(plan)]
    arguments.append(_largest_shift(plan))
    if plan.scale is not None:
        arguments.append(_ring_samples(plan, plan.scale))
    if isinstance(refinement, EdgeStep):
        arguments.append(b["lines"])
    name = "midlines" if isinstance(refinement, Midlines) else "edge_lines"
    return _of_corners(plan, name, *arguments, b["result"])


def _step(plan: PlanBase, refinement: EdgeStep) -> Launch:
    b, factor = plan.arrays, plan.scale or 1.0
    radius = np.float32(min(max(0.75 * refinement.cell * factor, 4.5), 9.0) / factor)
    given = (b["image"], b["start"], b["lines"], b["totals"])
    rows, columns, step = (np.uint32(n) for n in (*plan.shape, plan.full_step))
    lengths = (radius, np.float32(factor))
    arguments = (*given, rows, columns, step, *_rows(plan), *lengths, b["result"])
    name = "edge_step_eight" if _by_eight(plan) else "edge_step"
    return _of_corners(plan, name, *arguments)


def _rows(plan: PlanBase) -> tuple[np.uint32, np.uint32, np.uint32]:
    """What says where a corner's row is: room of a frame, place of its total, all rows."""
    frames, room = plan.frames, plan.corner_room
    return np.uint32(room), np.uint32(frames * plan.masks), np.uint32(frames * room)


def _largest_shift(plan: PlanBase) -> np.float32:
    """Of a refined position from its start, px of the image."""
    refinement = plan.config.refinement
    shift = refinement.max_shift if isinstance(refinement, EdgeLines | Midlines) else 2.0
    return np.float32(shift / (plan.scale or 1.0))
