"""The stages from the list of corners to positions, and the reading of their result."""

import functools
import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import EdgeLines, EdgeStep, Fit, Midlines
from cmp_cl.corners import Corners, Method
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.stages.layout import LANES, PlanBase
from cmp_cl.stages.moments import BLUR, moments
from cmp_cl.stages.resampling import full_pixels

RESULT_HEAD = 16  # numbers before the fields of a frame, as in kernels/result.clh
RESULT_FIELDS = 13
POSITION, PIXEL, EDGES = slice(0, 2), slice(2, 4), slice(4, 8)
RESPONSE, METHOD, VARIANCE, CORRELATION, GRAIN = 8, 9, 10, 11, 12
SHARES = 32  # shares of the corners for each unit of the device
RADII = (3, 4, 5)  # of the rings, px of the working image
RING_SAMPLES = 32
STEP_RADIUS = (0.75, 4.5, 9.0)  # of EDGE_STEP's disc: cells, and its least and largest px
STEP_SHIFT = 2.0  # px of the working image: EDGE_STEP's largest distance from its start
DOUBTFUL_EXCESS = 0.010  # excess of the residual's autocorrelation over the frame's median
VARIANCE_OF_EXCESS = 1000  # px^2 per squared excess, fitted on rendered scenes and on boards
# px^2 per squared range of the lesser autocorrelations, and their range in a good frame; the same
# for the least of them; then by what the part by noise grows, per median grain. All were fitted on
# the boards of bench/fit.py.
VARIANCE_OF_RANGE = np.float32(3000)
LEAST_RANGE = np.float32(0.0025)
VARIANCE_OF_LEAST = np.float32(500)
GREATEST_LEAST = np.float32(0.025)
VARIANCE_OF_GRAIN = np.float32(2.2)
FEW = 8  # corners that do not tell what the noise is
VARIANCE_OF_MODEL = np.float32(1e-4)  # px^2 of the image: the part that noise has no share in


def files(plan: PlanBase) -> list[str]:
    """Return the kernel files, in the order of the stages."""
    refinement = plan.config.refinement
    if refinement is None:
        return ["centroids"]
    name = _name(refinement)
    return [f"cpu/{name}" if plan.lanes == LANES else name]


def _name(refinement: EdgeLines | EdgeStep | Midlines) -> str:
    """Return the name of the kernel that takes a corner at a time."""
    if isinstance(refinement, Midlines):
        return "midlines"
    return "edge_step" if isinstance(refinement, EdgeStep) else "edge_lines"


def defines(plan: PlanBase) -> dict[str, str | int]:
    """Return the macros that only these kernels need."""
    refinement = plan.config.refinement
    quadratic = isinstance(refinement, Midlines) and refinement.fit is Fit.QUADRATIC
    table = (
        moments(_step_radius(refinement, plan.scale or 1.0))
        if isinstance(refinement, EdgeStep)
        else ()
    )
    return {
        "LANES": plan.lanes,
        "LISTS": plan.lists,
        "SCALED": int(plan.scale is not None),
        "ANGLES": len(table) - 1,
        "BLUR": f"{BLUR}f",
        "QUADRATIC": int(quadratic),
    }


def result_size(plan: PlanBase) -> int:
    """Return the bytes of the result of a frame."""
    return 4 * (RESULT_HEAD + RESULT_FIELDS * plan.corner_capacity)


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the list of corners to positions."""
    arrays, size = plan.arrays, _full_size(plan)
    if plan.config.refinement is not None:
        given = {name: arrays[name] for name in ("corners", "counts", "result")}
        return looks(plan, room=plan.corner_capacity, **given)
    return [
        plan.of_corners(
            "centroids",
            corners=arrays["corners"],
            counts=arrays["counts"],
            rows=size["rows"],
            columns=size["columns"],
            **plan.corner_list,
            scale=np.float32(plan.scale or 1),
            result=arrays["result"],
        )
    ]


def looks(
    plan: PlanBase, *, corners: cl.Buffer, counts: cl.Buffer, result: cl.Buffer, room: int
) -> list[Launch]:
    """Return the launch that refines corners at some places of the plan's frames.

    corners, counts, result: as those of the plan, see kernels/result.clh, with room for so many
    corners in each frame, a multiple of the work-items in a group.
    """
    refinement, factor = plan.config.refinement, plan.scale or 1.0
    if refinement is None:
        return []
    eight = plan.lanes == LANES
    rings: dict[str, Any] = {}
    if plan.scale is not None:
        if eight:
            rings["ring_reach"] = np.uint32(math.ceil(RADII[-1] / plan.scale) + 1)
        rings["ring_samples"] = _ring_samples(plan, plan.scale)
    disc: dict[str, Any] = {}
    shift = STEP_SHIFT
    if isinstance(refinement, EdgeStep):
        radius = _step_radius(refinement, factor)
        disc = {"radius": np.float32(radius), "moments": plan.constant(moments(radius))}
    else:
        shift = refinement.max_shift
    shares = min(SHARES * plan.device.handle.max_compute_units, room // LANES)
    launch = plan.stage(
        f"{_name(refinement)}_eight" if eight else _name(refinement),
        (shares if eight else room, plan.frames),
        (1 if eight else GROUP, 1),
        image=plan.arrays["image"],
        corners=corners,
        counts=counts,
        **_full_size(plan),
        capacity=np.uint32(room),
        count_offset=np.uint32(plan.frames * plan.lists),
        length=np.uint32(plan.frames * room),
        max_shift=np.float32(shift / factor),
        scale=np.float32(factor),
        **rings,
        **disc,
        result=result,
    )
    return [launch]


def _full_size(plan: PlanBase) -> dict[str, Any]:
    rows, columns = (np.uint32(n) for n in plan.shape)
    return {"rows": rows, "columns": columns, "step": np.uint32(plan.full_step)}


def _ring_samples(plan: PlanBase, scale: float) -> cl.Buffer:
    """Return (rings, 32, 8) float32, see RING_32 in kernels/edges.clh."""
    angle = np.arange(RING_SAMPLES) * (math.tau / RING_SAMPLES)
    circle = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    offset = np.float32(np.array(RADII)[:, None, None] / scale * circle)
    pixel = np.floor(offset)
    parts = (offset, np.roll(offset, -1, axis=1) - offset, pixel, offset - pixel)
    return plan.constant(np.concatenate(parts, axis=2))


def _step_radius(refinement: EdgeStep, scale: float) -> float:
    """Return the radius of EDGE_STEP's disc, px of the image."""
    share, least, most = STEP_RADIUS
    return min(max(share * refinement.cell * scale, least), most) / scale


class Found:
    """The corners that `Plan.read` returns, made when they are asked for. counts: of each frame."""

    def __init__(self, rows: NDArray[np.float32], plan: PlanBase) -> None:
        self._rows, self._plan = rows, plan
        self.counts: list[int] = rows[:, 0].view(np.uint32).tolist()

    @functools.cached_property
    def corners(self) -> list[Corners]:
        """Return the corners of each frame."""
        return read_corners(self._rows, self._plan)


def read_corners(rows: NDArray[np.float32], plan: PlanBase) -> list[Corners]:
    """Return the corners of each frame, as parts of the result of `Plan.read`."""
    device, found = str(plan.device), []
    refinement, radius = plan.config.refinement, math.nan
    if isinstance(refinement, EdgeStep):
        radius = _step_radius(refinement, plan.scale or 1.0)
    for row, count in zip(rows, rows[:, 0].view(np.uint32).tolist(), strict=True):
        padded = multiple(count, LANES)
        fields = row[RESULT_HEAD:][: RESULT_FIELDS * padded].reshape(RESULT_FIELDS, padded)
        decisions = fields[METHOD].view(np.uint8)  # methods, then why another was rejected
        method = decisions[:count]
        octave = decisions[2 * padded : 2 * padded + count] if plan.octaves else None
        sigma, doubtful = _deviation(fields[:, :count], method, octave)
        pixel = fields[PIXEL].view(np.int32).reshape(-1, 2)[:count]
        if plan.scale is not None:
            pixel = full_pixels(pixel, plan.shape, plan.scale)
        found.append(
            Corners(
                xy=fields[POSITION].reshape(-1, 2)[:count],
                pixel=pixel,
                octave=np.zeros(count, np.uint8) if octave is None else octave,
                response=fields[RESPONSE, :count],
                method=method,
                refusal=decisions[padded : padded + count],
                sigma=sigma,
                edges=fields[EDGES].reshape(-1, 4)[:count],
                doubtful=doubtful,
                edge_radius=radius,
                device=device,
            )
        )
    return found


def _deviation(
    fields: NDArray[np.float32], method: NDArray[np.uint8], octave: NDArray[np.uint8] | None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the standard deviation of each position, px, and which corners are doubtful.

    octave: (N,), or None if the frame is all. Corners that EDGE_STEP did not refine have an
        autocorrelation and a grain of -inf.
    """
    # A plain number: comparing an array with a member of an enumeration is slower.
    accepted = method == Method.EDGE_STEP.value
    if octave is None or not octave.any():
        variance, excess = _grown(fields, accepted)
    else:
        variance, excess = fields[VARIANCE].copy(), np.zeros_like(fields[VARIANCE])
        for n in np.unique(octave):
            here = octave == n
            variance[here], excess[here] = _grown(fields[:, here], accepted[here], int(n))
    return np.sqrt(variance), excess > DOUBTFUL_EXCESS


def _grown(
    fields: NDArray[np.float32], accepted: NDArray[np.bool_], octave: int = 0
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the variances, px^2, with what the corners of an octave show together, and how far
    each residual's autocorrelation exceeds their median.

    Noise that neighbours share moves a corner more than other noise: the part by noise grows with
    the median grain. A corner with an excess above DOUBTFUL_EXCESS is doubtful: its surroundings do
    not look like the corner model. Where the whole frame does not, because its pixels are enlarged
    or compressed, the least autocorrelations spread, or are all large where pixels are enlarged by
    more than blur hides; texture beside a pattern changes the others alone.
    """
    variance, correlation, grain = fields[VARIANCE], fields[CORRELATION], fields[GRAIN]
    count = int(np.count_nonzero(accepted))
    if not count:
        return variance, np.zeros_like(variance)
    above = 19 * count // 20, 3 * count // 5, count // 2
    ranks = [len(correlation) - 1 - n for n in above]
    ordered = np.partition(correlation, ranks)
    least, low, middle = (ordered[rank] for rank in ranks)
    excess = np.maximum(correlation - middle, 0)
    spread = np.maximum(low - least - LEAST_RANGE, 0)
    stepped = np.maximum(least - GREATEST_LEAST, 0)
    coarse = np.float32(0)
    if count > FEW:
        rank = ranks[2] - FEW // 2  # the median with FEW corners more that have none
        coarse = np.maximum(VARIANCE_OF_GRAIN * np.partition(grain, rank)[rank] - 1, 0)
    of_noise = (variance - VARIANCE_OF_MODEL * np.float32(4**octave)) * accepted
    more: NDArray[np.float32] = (
        coarse * of_noise
        + VARIANCE_OF_EXCESS * excess * excess
        + VARIANCE_OF_RANGE * spread * spread
        + VARIANCE_OF_LEAST * stepped * stepped
    )
    return variance + more, excess
