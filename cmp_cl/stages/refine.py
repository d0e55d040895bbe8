"""The stages from the list of corners to positions, and the reading of their result."""

import functools
import math
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import EdgeLines, EdgeStep, Fit, Midlines
from cmp_cl.corners import Corners
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.stages.corner_model import ANGLES, BLUR, moments, step_radius
from cmp_cl.stages.layout import LANES, LISTS, MOST_OCTAVES, PlanBase

RESULT_HEAD = 16  # numbers before the fields of a frame, as in kernels/result.clh
RESULT_FIELDS, READ_FIELDS = 13, 11  # of a corner; the last two stay on the device
POSITION, PIXEL, EDGES = slice(0, 2), slice(2, 4), slice(4, 8)
RESPONSE, METHOD, VARIANCE = 8, 9, 10
SHARES = 32  # shares of the corners for each unit of the device
STEP_SHIFT = 2.0  # px: EDGE_STEP's largest distance from its start
MEDIANS = 2  # of an octave's residuals, as in kernels/residual.cl
MEDIAN_GROUP = 256  # work-items that find one


def files(plan: PlanBase) -> list[str]:
    refinement = plan.config.refinement
    if refinement is None:
        return ["centroids"]
    name = _name(refinement)
    kept = [f"cpu/{name}" if plan.lanes == LANES else name]
    return [*kept, "residual"] if isinstance(refinement, EdgeStep) else kept


def _name(refinement: EdgeLines | EdgeStep | Midlines) -> str:
    """Return the name of the kernel that takes a corner at a time."""
    if isinstance(refinement, Midlines):
        return "midlines"
    return "edge_step" if isinstance(refinement, EdgeStep) else "edge_lines"


def defines(plan: PlanBase) -> dict[str, str | int]:
    refinement = plan.config.refinement
    quadratic = isinstance(refinement, Midlines) and refinement.fit is Fit.QUADRATIC
    return {
        "LANES": plan.lanes,
        "LISTS": LISTS,
        "ANGLES": ANGLES,
        "BLUR": f"{BLUR}f",
        "QUADRATIC": int(quadratic),
    }


def result_size(plan: PlanBase) -> int:
    """Return the bytes of the result of a frame."""
    return 4 * (RESULT_HEAD + RESULT_FIELDS * plan.corner_capacity)


def sizes(plan: PlanBase) -> dict[str, int]:
    """Return the bytes of the buffers that these kernels use, by name."""
    if not isinstance(plan.config.refinement, EdgeStep):
        return {}
    return {"typical": 4 * plan.frames * (MOST_OCTAVES + 1) * MEDIANS}


def launches(plan: PlanBase) -> list[Launch]:
    """Return the launches from the list of corners to positions."""
    if plan.config.refinement is None:
        return [plan.of_corners("centroids")]
    given = {name: plan.arrays[name] for name in ("corners", "counts", "result")}
    refined, *grown = looks(plan, room=plan.corner_capacity, **given)
    if not grown:
        return [refined]
    groups, capacity = (plan.octaves + 1) * MEDIANS, plan.corner_capacity
    typical = plan.of_groups("typical_residual", groups, MEDIAN_GROUP, capacity=np.uint32(capacity))
    return [refined, typical, *grown]


def looks(
    plan: PlanBase, *, corners: cl.Buffer, counts: cl.Buffer, result: cl.Buffer, room: int
) -> list[Launch]:
    """Return the launches that refine corners at some places of the plan's frames.

    The residuals of the corners of the frame tell how large their variances are.

    corners, counts, result: as those of the plan, see kernels/result.clh, with room for so many
    corners in each frame, a multiple of the work-items in a group.
    """
    refinement = plan.config.refinement
    if refinement is None:
        return []
    eight = plan.lanes == LANES
    disc: dict[str, Any] = {}
    shift = STEP_SHIFT
    if isinstance(refinement, EdgeStep):
        radius = step_radius(refinement)
        disc = {"radius": np.float32(radius), "moments": plan.constant(moments(radius))}
    else:
        shift = refinement.max_shift
    listed = {
        "corners": corners,
        "counts": counts,
        "result": result,
        "capacity": np.uint32(room),
        "length": np.uint32(plan.frames * room),
    }
    shares = min(SHARES * plan.device.handle.max_compute_units, room // LANES)
    launch = plan.stage(
        f"{_name(refinement)}_eight" if eight else _name(refinement),
        (shares if eight else room, plan.frames),
        (1 if eight else GROUP, 1),
        **listed,
        max_shift=np.float32(shift),
        **disc,
    )
    if not isinstance(refinement, EdgeStep):
        return [launch]
    return [launch, plan.stage("grow_variance", (room, plan.frames), (GROUP, 1), **listed)]


class Found:
    """The corners that `Plan.read` returns, made when they are asked for. counts: of each frame."""

    def __init__(self, rows: NDArray[np.float32], plan: PlanBase) -> None:
        self._rows, self._plan = rows, plan
        self.counts: list[int] = rows[:, 0].view(np.uint32).tolist()

    @functools.cached_property
    def corners(self) -> list[Corners]:
        """Return the corners of each frame, as parts of the result of `Plan.read`."""
        plan, device, found = self._plan, str(self._plan.device), []
        refinement, radius = plan.config.refinement, math.nan
        if isinstance(refinement, EdgeStep):
            radius = step_radius(refinement)
        for row, count in zip(self._rows, self.counts, strict=True):
            padded = multiple(count, LANES)
            fields = row[RESULT_HEAD:][: READ_FIELDS * padded].reshape(READ_FIELDS, padded)
            method, refusal, octave, doubtful = (
                fields[METHOD].view(np.uint8).reshape(4, padded)[:, :count]
            )
            found.append(
                Corners(
                    xy=fields[POSITION].reshape(-1, 2)[:count],
                    pixel=fields[PIXEL].view(np.int32).reshape(-1, 2)[:count],
                    octave=octave,
                    response=fields[RESPONSE, :count],
                    method=method,
                    refusal=refusal,
                    sigma=np.sqrt(fields[VARIANCE, :count]),
                    edges=fields[EDGES].reshape(-1, 4)[:count],
                    doubtful=doubtful.view(np.bool_),
                    edge_radius=radius,
                    device=device,
                )
            )
        return found
