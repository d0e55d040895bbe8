"""The nodes of a frame from those of the frame before."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.grid.grid import MEASURED, NO_SIDES, Grid
from cmp_cl.motion.nodes import whole
from cmp_cl.opencl.launches import GROUP, Launch, bound, constant, multiple
from cmp_cl.opencl.memory import Layout, Memory, copy
from cmp_cl.opencl.program import Programs
from cmp_cl.stages import refine
from cmp_cl.stages.layout import CORNER_COLUMNS, LISTS
from cmp_cl.stages.plan import Plan
from cmp_cl.stages.refine import EDGES, METHOD, RESULT_FIELDS, RESULT_HEAD, VARIANCE

LOST = 0.10  # largest share of the nodes without a corner
BEYOND = 0.05  # largest share of the nodes of all sides beyond which a free corner is
BEYOND_ONE = 0.25  # the same of one side
ADRIFT = 0.005  # largest share of the nodes that are lost beside a corner
GONE = 0.50  # largest share of a side's nodes that are lost
KNOWN = 0.95  # least share of the nodes that the frame at rest must show
COUNTED = 10  # numbers for each view, as in kernels/track.cl
LEAST_ROOM = 4096  # corners of a view
_BIN = 1.0  # cells at rest: side of a bin
_LEAST_BIN = 4.0  # px


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tracked:
    """What tracking found in a view.

    lost: nodes without a corner. beyond, gone: by side (top, bottom, left, right), the free corners
    beyond it and its lost nodes. adrift: lost nodes beside a corner that may be theirs, or that has
    the other colour.
    """

    lost: int = 0
    beyond: tuple[int, ...] = (0, 0, 0, 0)
    gone: tuple[int, ...] = (0, 0, 0, 0)
    adrift: int = 0

    def holds(
        self,
        shape: tuple[int, int],
        at_rest: "Tracked | None" = None,
        ends: tuple[bool, ...] = (True, True, True, True),
    ) -> bool:
        """Return whether the numbers of the frame before hold for a lattice of that shape.

        A lattice that slips by whole cells has free corners beyond a side at which the pattern
        ends, or loses the whole side; at others, lines come into view and leave it.
        at_rest: what is found there: free corners beyond a side, where squares meet the surround,
        and nodes that the view does not show. ends: whether the pattern ends at each side.
        """
        rest = at_rest or Tracked()
        rows, columns = shape
        every = self.beyond, self.gone, rest.beyond, rest.gone, (columns, columns, rows, rows)
        beyond, gone, usual, missing, sides = (list(compress(each, ends)) for each in every)
        more = [now - before for now, before in zip(beyond, usual, strict=True)]
        return (
            self.lost - rest.lost <= LOST * (rows * columns - rest.lost)
            and self.adrift <= ADRIFT * rows * columns
            and sum(more) <= BEYOND * sum(sides) + 2 * math.sqrt(sum(usual))
            and all(each <= BEYOND_ONE * side for each, side in zip(more, sides, strict=True))
            and all(
                now - before <= GONE * (side - before)
                for now, before, side in zip(gone, missing, sides, strict=True)
            )
        )


def can_track(rest: Grid, *, slow: bool) -> bool:
    """Return whether a slip by whole cells would show: the pattern ends on all sides of the view,
    and nearly all nodes are there.

    slow: the pattern moves by less than half a cell from frame to frame, so that it cannot slip.
    """
    sure = all(rest.border or NO_SIDES) and rest.valid.mean() > KNOWN
    return bool((slow or sure) and min(rest.shape) >= 3)


class Tracker:
    """Follows the nodes of some views from frame to frame.

    views: the grids at rest, and their corners. size: (H, W) of a view. frame: the memory of a plan
    that has the arrays of `layout`; a frame writes them on the device.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        programs: Programs,
        *,
        views: Sequence[tuple[Grid, Corners]],
        size: tuple[int, int],
        frame: Memory,
    ) -> None:
        self._queue = queue
        self._frame = frame
        self._bound_to: WeakKeyDictionary[Plan, tuple[cl.Buffer, list[Launch]]] = (
            WeakKeyDictionary()
        )
        self.shape = rows, columns = views[0][0].shape
        self._count = len(views)
        self._size = size
        self.capacity = multiple(max(LEAST_ROOM, 2 * rows * columns), GROUP)
        self._at_rest = [Tracked()] * len(views)
        self._known = [np.count_nonzero(grid.valid) for grid, _ in views]
        self._ends = [grid.border or NO_SIDES for grid, _ in views]
        self.room = multiple(rows * columns, GROUP)  # of second looks
        self._first_count = len(views) * LISTS
        self._bin = max(_LEAST_BIN, _BIN * min(_step(grid) for grid, _ in views))
        self._bins = tuple(int(length / self._bin) + 1 for length in size)
        nodes, corners = (self._count, rows, columns), (self._count, self.capacity)
        self._work = Memory(
            queue,
            {
                "corners": ((*corners, 4), np.float32),
                "last": ((*nodes, 2), np.float32),
                "last_status": (nodes, np.uint8),
                "predicted": ((*nodes, 2), np.float32),
                "residual": ((*nodes, 2), np.float32),
                "nearest": (nodes, np.int32),
                "first_of_bin": ((self._count, *self._bins), np.int32),
                "next": (corners, np.int32),
                "claims": (corners, np.int32),
                "kept": (nodes, np.int32),
                "expected": ((*nodes, 2), np.float32),
                "look": (nodes, np.int32),
                "looks": ((CORNER_COLUMNS, self._count, self.room), np.int32),
                "look_counts": ((self._count * (LISTS + 1),), np.uint32),
                "look_result": ((self._count, _stride(self.room)), np.float32),
            },
        )
        colour = np.array([colour_of(*view) for view in views], np.int32)
        rest = np.array([whole(grid.xy) for grid, _ in views], np.float32)
        self._parts = {
            **frame.parts,
            **self._work.parts,
            "colour": constant(queue.context, colour),
            "rest": constant(queue.context, rest),
        }
        self._kernels = programs.kernels(
            ["track"],
            {
                "ROWS": rows,
                "COLUMNS": columns,
                "CAPACITY": self.capacity,
                "LOOKS": self.room,
                "COLUMNS_OF_LOOK": CORNER_COLUMNS,
                "HEAD": RESULT_HEAD,
                "EDGES_FIELD": EDGES.start,
                "METHOD_FIELD": METHOD,
                "VARIANCE_FIELD": VARIANCE,
                "K": 2,
            },
        )

    @staticmethod
    def layout(views: int, shape: tuple[int, int]) -> Layout:
        """Return the arrays of a frame.

        nodes: (V, R, C, 2) float32, px of the view, complete: a node without a position has a
            prediction. seen_status: (V, R, C) uint8 of `NodeStatus`. seen_sigma: (V, R, C) float32,
            px, not positive if unknown. owner: (V, R, C) int32, the corner of each node, -1 without
            one. tracked: (V, 10) int32, what was counted.
        """
        nodes = (views, *shape)
        return {
            "nodes": ((*nodes, 2), np.float32),
            "seen_status": (nodes, np.uint8),
            "seen_sigma": (nodes, np.float32),
            "owner": (nodes, np.int32),
            "tracked": ((views, COUNTED), np.int32),
        }

    def release(self) -> None:
        """Release the device's memory."""
        self._work.release()

    def launches(self, plan: Plan) -> list[Launch]:
        """Return the launches that track the nodes in the frames of a detector's plan."""
        result = plan.arrays["result"]
        known = self._bound_to.get(plan)
        if known is None or known[0] is not result:  # its lists have grown
            names = {"corners": "looks", "counts": "look_counts", "result": "look_result"}
            parts = {name: self._parts[own] for name, own in names.items()}
            looks = refine.looks(plan, room=self.room, **parts)
            known = result, self.bind(result, plan.corner_capacity, looks)
            self._bound_to[plan] = known
        return known[1]

    def bind(self, result: cl.Buffer, room: int, looks: Sequence[Launch]) -> list[Launch]:
        """Return the launches that track the nodes among the corners of a result.

        result: in the layout of kernels/result.clh, with room for so many corners in each view.
        looks: those of the second look; if there are none, nodes get none.
        """
        nodes = self.shape[0] * self.shape[1]
        parts = self._parts | {
            "result": result,
            "stride": np.uint32(_stride(room)),
            "room": np.uint32(room),
            "bins_per_px": np.float32(1 / self._bin),
            "bin_rows": np.int32(self._bins[0]),
            "bin_columns": np.int32(self._bins[1]),
            "image_rows": np.int32(self._size[0]),
            "image_columns": np.int32(self._size[1]),
            "first_count": np.uint32(self._first_count),
            "look_length": np.uint32(self._count * self.room),
            "look_stride": np.uint32(_stride(self.room)),
        }
        items = {"predict": max(nodes, math.prod(self._bins)), "place": self.capacity}
        *before, enter = (
            bound(
                self._kernels,
                parts,
                name,
                (multiple(items.get(name, nodes), GROUP), self._count),
                (GROUP, 1),
            )
            for name in ("predict", "place", "match", "agree", "check", "enter")
        )
        return [*before, *looks, enter]

    def begin(self, grids: Sequence[Grid]) -> bool:
        """Go on from the nodes of these grids, which are on the device; return whether they are
        enough. Enqueues copies: they do not move."""
        copy(self._queue, self._parts["last"], self._parts["nodes"])
        copy(self._queue, self._parts["last_status"], self._parts["seen_status"])
        return all(
            not grid.ambiguous and np.count_nonzero(grid.valid) >= (1 - LOST) * known
            for grid, known in zip(grids, self._known, strict=True)
        )

    def holds(self, arrays: Mapping[str, NDArray[Any]], corners: Sequence[int]) -> bool:
        """Return whether the numbers of the frame before hold in all views.

        arrays: of the frame, see `FieldPlan.read`. corners: their number in each view.
        """
        return max(corners) <= self.capacity and all(
            each.holds(self.shape, at_rest, ends)
            for each, at_rest, ends in zip(
                self.found(arrays), self._at_rest, self._ends, strict=True
            )
        )

    def know_rest(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take what is found in the frame at rest as usual. arrays: of it, see `FieldPlan.read`."""
        self._at_rest = self.found(arrays)

    def found(self, arrays: Mapping[str, NDArray[Any]]) -> list[Tracked]:
        """Return what was found in each view. arrays: of the frame, see `FieldPlan.read`."""
        return [
            Tracked(
                lost=counts[0],
                beyond=tuple(counts[1:5]),
                gone=tuple(counts[5:9]),
                adrift=counts[9],
            )
            for counts in arrays["tracked"].tolist()
        ]


def _stride(room: int) -> int:
    """Return the numbers of the result of a view with room for so many corners."""
    return RESULT_HEAD + RESULT_FIELDS * room


def differing(one: Grid, other: Grid) -> int:
    """Return the number of nodes for which two grids of the same corners have different ones."""
    both = (one.index[:, 0] >= 0) & (other.index[:, 0] >= 0)
    moved = both & (one.index != other.index).any(axis=1)
    return int(np.count_nonzero(moved))


def lost(tracked: Grid, other: Grid) -> int:
    """Return the number of nodes of a grid that are not measured, but are in another one."""
    return int(np.count_nonzero(~_measured(tracked) & _measured(other)))


def _measured(grid: Grid) -> NDArray[np.bool_]:
    return np.isin(grid.status, MEASURED)


def colour_of(rest: Grid, corners: Corners) -> int:
    """Return 1 if the first boundary of most corners of even row + column runs along their row, -1
    if down their column."""
    known = rest.index[:, 0] >= 0
    row, column = rest.index[known].T
    along, down = (np.gradient(rest.xy.astype(np.float64), axis=axis) for axis in (1, 0))
    angle = corners.edges[known, 0].astype(np.float64)
    edge = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    off = [np.abs(_cross(edge, step[row, column])) for step in (down, along)]
    sign = np.sign(off[0] - off[1]) * np.where((row + column) % 2, -1, 1)
    return 1 if np.nansum(sign) >= 0 else -1


def _cross(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    return one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]


def _step(grid: Grid) -> float:
    """Return the smaller median step between nodes of a grid, px."""
    steps = [np.linalg.norm(np.diff(grid.xy, axis=axis), axis=2) for axis in (0, 1)]
    return float(min(np.nanmedian(each) for each in steps))
