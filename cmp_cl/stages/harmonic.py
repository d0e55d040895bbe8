"""The grey-level rule, from the image to the list of its corners."""

from typing import Any, cast

import numpy as np

from cmp_cl.config import RingHarmonic
from cmp_cl.opencl.launches import Launch
from cmp_cl.stages import noise
from cmp_cl.stages.layout import LIST_COLUMNS, MOST_OCTAVES, PlanBase

TILE = 32  # px, see kernels/decide.clh
DECIDING = 256  # work-items of a group that decides about a frame; 1 in the form for CPUs


def files(plan: PlanBase) -> list[str]:
    if plan.for_cpu:
        return ["cpu/harmonic"]
    return [*(["halve"] if plan.octaves else []), "border", "noise", "harmonic", "decide"]


def defines(plan: PlanBase) -> dict[str, str | int]:
    whole = plan.dtype == np.uint8 and _full_scale(plan) == 255
    rule = _rule(plan)
    return {
        "FINE": int(rule.fine),
        "DECIDING": 1 if plan.for_cpu else DECIDING,
        "WHOLE_LEVELS": int(whole),
    }


def sizes(plan: PlanBase) -> dict[str, int]:
    frames, plane = plan.frames, plan.shape[0] * plan.step
    lists, sums = frames * plan.kinds, frames * (1 + MOST_OCTAVES)
    cpu = plan.for_cpu
    bands = plan.bands if cpu else noise.bands(plan)
    starts = plan.octave_starts
    return {
        "halves": plan.dtype.itemsize * max(starts[-1] - starts[1], 1) if cpu else 0,
        "area": plane // 8,
        "lists": 4 * lists * LIST_COLUMNS * plan.list_capacity,
        "counters": 4 * frames * _counters(plan),
        "noise": 8 * sums * bands,
        "levels": 8 * lists,
        "maxima": frames * plane // 8,
        "row_counts": 4 * frames * plan.shape[0],
        "row_columns": 4 * frames * plan.corner_capacity,
        "work": 2 * frames * plan.bands * _work_rows(plan) * plan.step if cpu else 0,
    }


def scratch(plan: PlanBase) -> list[dict[str, int]]:
    """Return the bytes of the temporary arrays, layout by layout."""
    tiles = -(-plan.shape[0] // TILE) * (plan.step // TILE)
    of_frame = 3 * plan.kinds * plan.list_capacity + (1 + MOST_OCTAVES) * tiles
    decided = {"strong": 4 * plan.frames * (of_frame if plan.octaves else 1)}
    if plan.for_cpu:
        return [decided]
    plane = 2 * (plan.frames * plan.shape[0] + 2) * plan.step
    return [noise.scratch(plan), dict.fromkeys(("fine", "coarse", "response"), plane), decided]


def _counters(plan: PlanBase) -> int:
    """Return the counters of a frame: of its lists, and of the work that CPUs share."""
    if not plan.for_cpu:
        return plan.kinds
    segments, halving = -(-plan.bands // 2), 2  # two bands share a segment
    return plan.kinds + 1 + segments * (1 + plan.octaves) + halving


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the image to the list of corners."""
    return [_by_bands(plan)] if plan.for_cpu else _by_pixels(plan)


def _rule(plan: PlanBase) -> RingHarmonic:
    return cast(RingHarmonic, plan.rule)


def _full_scale(plan: PlanBase) -> int:
    return plan.config.grey_levels(plan.dtype)


# One work-item per pixel


def _by_pixels(plan: PlanBase) -> list[Launch]:
    stages = [plan.few("repeat_border", plan.frames * plan.shape[0], 1)]
    for octave in range(1, plan.octaves + 1):
        larger = plan.size_of(octave - 1)
        halving = plan.dense(
            "halve",
            None,
            octave,
            image=plan.image_of(octave - 1),
            full_rows=larger["rows"],
            full_step=larger["step"],
            half_image=plan.image_of(octave),
        )
        stages.append(halving)
    for octave in range(plan.octaves, -1, -1):
        stages += _list_maxima(plan, octave)
    decided = _numbers(plan)
    return [
        *stages,
        plan.stage(
            "find_reference", (DECIDING * plan.kinds, plan.frames), (DECIDING, 1), **decided
        ),
        plan.stage("decide", (DECIDING * plan.frames,), (DECIDING,), **decided),
    ]


def _list_maxima(plan: PlanBase, octave: int) -> list[Launch]:
    """Return the launches from the image of an octave to the lists of its maxima."""
    b, numbers = plan.arrays, _numbers(plan)
    planes = {"fine_plane": b["fine"], "coarse_plane": b["coarse"]}

    def dense(name: str, **arguments: Any) -> Launch:
        return plan.dense(name, None, octave, **numbers, **planes, **arguments)

    stages = [*noise.launches(plan, octave), dense("smooth_image", smooth=b["fine"])]
    if _rule(plan).fine and not octave:
        stages += [dense("fine_response", plane=b["fine"]), dense("fine_maxima")]
    stages += [
        dense("smooth", plane=b["fine"], smoother=b["response"]),
        dense("smooth", plane=b["response"], smoother=b["coarse"]),
    ]
    if octave:
        stages.append(dense("pixels_of_plane", plane=b["coarse"]))
    return [
        *stages,
        dense("coarse_response", plane=b["coarse"]),
        dense("coarse_maxima", octave=np.uint32(octave)),
    ]


# In both forms


def _numbers(plan: PlanBase) -> dict[str, Any]:
    """Return the numbers that the kernels take, by argument."""
    rule = _rule(plan)
    return {
        "octaves": np.uint32(plan.octaves),
        "full_scale": np.uint32(_full_scale(plan)),
        "bands": np.uint32(noise.bands(plan)),
        "frame_words": np.uint32(plan.step // 32),
        "counters_of_frame": np.uint32(_counters(plan)),
        "coarse_noise": np.uint32(rule.coarse_noise),
        "coarse_share": np.int32(rule.coarse_share),
        "fine_share": np.int32(rule.fine_share),
        "nms_radius": np.int32(plan.config.nms_radius),
    }


# For CPUs


def _work_rows(plan: PlanBase) -> int:
    """Return the rows of 16-bit numbers that a band keeps, see kernels/cpu/harmonic.cl."""
    radius = plan.config.nms_radius
    smooth = 16 if radius <= 4 else 32
    responses = 8 if radius <= 3 else 16 if radius <= 7 else 32
    return 4 + smooth + 4 + 32 + 2 + 1 + 2 + responses * (1 + _rule(plan).fine)


def _by_bands(plan: PlanBase) -> Launch:
    """Bind the launch from the image to the list of corners."""
    return plan.stage(
        "harmonic_band",
        (plan.bands, plan.frames),
        (1, 1),
        inverse=np.float32(1 / _full_scale(plan)),
        work_size=np.uint32(_work_rows(plan) * plan.step),
        **_numbers(plan),
    )
