"""The nodes of a frame from those of the frame before."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Refusal
from cmp_cl.grid.grid import NO_SIDES, Grid
from cmp_cl.grid.predict import PREDICTORS
from cmp_cl.motion.memory import Memory
from cmp_cl.motion.nodes import put
from cmp_cl.opencl.device import Device
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.opencl.program import Programs

TORN = 0.15  # px: a corner whose sigma is not below it is torn, as is one that was not refined
STRONG = 8.0  # least weight of the predictions of a node that is checked
LOST = 0.10  # largest share of the nodes without a corner
CROSSED = 0.02  # largest share of the nodes whose corner has the other colour
BEYOND = 0.05  # largest share of a side's nodes beyond which a free corner is
GONE = 0.50  # largest share of a side's nodes that are lost
KNOWN = 0.95  # least share of the nodes that the frame at rest must show
COUNTED = 11  # numbers for each view, as in kernels/track.cl
_BIN = 0.45  # cells at rest: side of a bin
_LEAST_BIN = 4.0  # px


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tracked:
    """What tracking found in a view.

    lost, crossed, astray: nodes without a corner, with one of the other colour, and far from what
    the nodes around predict. beyond, gone: by side (top, bottom, left, right), the free corners
    beyond it and its lost nodes.
    """

    lost: int
    crossed: int
    astray: int
    beyond: tuple[int, ...]
    gone: tuple[int, ...]

    def holds(self, shape: tuple[int, int]) -> bool:
        """Return whether the numbers of the frame before hold for a lattice of that shape.

        A lattice that slips by whole cells has free corners beyond a side, or loses a whole side.
        """
        rows, columns = shape
        sides = columns, columns, rows, rows
        return (
            self.lost <= LOST * rows * columns
            and self.crossed <= CROSSED * rows * columns
            and sum(self.beyond) <= BEYOND * sum(sides)
            and all(gone <= GONE * side for gone, side in zip(self.gone, sides, strict=True))
        )


def can_track(rest: Grid) -> bool:
    """Return whether a slip by whole cells would show: the pattern ends on all sides of the view,
    and nearly all nodes are there."""
    return all(rest.border or NO_SIDES) and rest.valid.mean() > KNOWN and min(rest.shape) >= 3


class Tracker:
    """Follows the nodes of some views from frame to frame.

    views: the grids at rest, and their corners. inputs: the memory of a plan with nodes, status and
    sigma of each view, see `FieldPlan`; `start` writes it on the device. capacity: most corners of
    a view.
    owner: (V, R, C) int32, after a frame: the corner of each node, -1 without one.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        *,
        views: Sequence[tuple[Grid, Corners]],
        sizes: Sequence[tuple[int, int]],
        inputs: Memory,
        capacity: int,
    ) -> None:
        self._queue, self._device = queue, device
        self._inputs = inputs
        self.shape = rows, columns = views[0][0].shape
        self._capacity, self._count = multiple(capacity, GROUP), len(views)
        self._bin = max(_LEAST_BIN, _BIN * min(_step(grid) for grid, _ in views))
        self._bins = tuple(int(max(size) // self._bin) + 1 for size in zip(*sizes, strict=True))
        nodes, corners = (self._count, rows, columns), (self._count, self._capacity)
        self._given = Memory(
            queue,
            {"corners": ((*corners, 4), np.float32), "found": ((self._count,), np.int32)},
        )
        self._kept = Memory(
            queue,
            {
                "owner": (nodes, np.int32),
                "counts": ((self._count, COUNTED), np.int32),
            },
        )
        self._work = Memory(
            queue,
            {
                "last": ((*nodes, 2), np.float32),
                "predicted": ((*nodes, 2), np.float32),
                "residual": ((*nodes, 2), np.float32),
                "nearest": (nodes, np.int32),
                "torn": (nodes, np.uint8),
                "first_of_bin": ((self._count, *self._bins), np.int32),
                "next": (corners, np.int32),
                "claims": (corners, np.int32),
            },
        )
        colours = np.array([colour_of(*view) for view in views], np.int32)
        self._constants = Memory.of(queue, colour=colours, stencils=stencils())
        self._parts = {
            name: part
            for memory in (inputs, self._given, self._kept, self._work, self._constants)
            for name, part in memory.parts.items()
        }
        self._kernels = programs.kernels(
            ["track"], {"ROWS": rows, "COLUMNS": columns, "CAPACITY": self._capacity}
        )
        self.launches = self._listed()
        self.owner = self._kept.arrays["owner"]

    def release(self) -> None:
        """Release the device's memory."""
        self._queue.finish()
        for memory in (self._given, self._kept, self._work, self._constants):
            memory.release()

    def _listed(self) -> list[Launch]:
        nodes = self.shape[0] * self.shape[1]
        bins = np.float32(self._bin), np.int32(self._bins[0]), np.int32(self._bins[1])
        chains = *bins, "first_of_bin", "next"
        return [
            self._bound(
                "place",
                max(nodes, self._capacity),
                *("corners", "found", *bins, "nodes", "last", "predicted"),
                *("first_of_bin", "next", "claims"),
            ),
            self._bound(
                "match",
                nodes,
                *("corners", *chains, "last", "predicted", "colour"),
                *("nearest", "residual", "claims", "counts"),
            ),
            self._bound(
                "agree",
                nodes,
                *("corners", "last", "predicted", "nearest", "residual", "claims"),
                *("nodes", "seen_status", "seen_sigma", "torn", "owner", "counts"),
            ),
            self._bound(
                "check",
                nodes,
                *("corners", *chains, "claims", "owner", "nodes", "torn", "stencils"),
                *("seen_status", "counts"),
            ),
        ]

    def _bound(self, name: str, items: int, *arguments: Any) -> Launch:
        given = [self._parts[each] if isinstance(each, str) else each for each in arguments]
        kernel = self._kernels.bind(name, *given)
        return Launch(name, kernel, (multiple(items, GROUP), self._count), (GROUP, 1), {})

    def reset(self, grids: Sequence[Grid]) -> None:
        """Take the nodes of a frame that was numbered otherwise, at rest from then on.

        Holes get predictions. Enqueues the upload to the plan.
        """
        arrays = self._inputs.arrays
        for view, grid in enumerate(grids):
            put(arrays, view, grid)
        self._work.arrays["last"][:] = arrays["nodes"]
        self._inputs.upload()
        self._work.upload()

    def start(self, found: Sequence[Corners]) -> list[tuple[str, cl.Event]] | None:
        """Enqueue the tracking of a frame; None if a view has more corners than there is room."""
        if max(map(len, found)) > self._capacity:
            return None
        for view, corners in enumerate(found):
            self._given.arrays["corners"][view, : len(corners)] = records(corners)
            self._given.arrays["found"][view] = len(corners)
        self._given.upload()
        for name, value in (("first_of_bin", -1), ("counts", 0)):
            part = self._parts[name]
            cl.enqueue_fill_buffer(self._queue, part, np.array([value], np.int32), 0, part.size)
        events = [
            (
                each.stage,
                cl.enqueue_nd_range_kernel(self._queue, each.kernel, each.items, each.group),
            )
            for each in self.launches
        ]
        self._kept.download()
        self._inputs.download()
        return events

    def read(self) -> list[Tracked]:
        """Return what was found in each view, once the launches have ended."""
        return [
            Tracked(
                lost=int(numbers[0]),
                crossed=int(numbers[1]),
                astray=int(numbers[2]),
                beyond=tuple(numbers[3:7].tolist()),
                gone=tuple(numbers[7:11].tolist()),
            )
            for numbers in self._kept.arrays["counts"]
        ]


def records(corners: Corners) -> NDArray[np.float32]:
    """Return corners as kernels/track.cl takes them, (N, 4): x, y, first boundary, sigma."""
    torn = ~(corners.sigma < TORN) | (corners.refusal != Refusal.NONE.value)
    found = np.empty((len(corners), 4), np.float32)
    found[:, :2] = corners.xy
    found[:, 2] = corners.edges[:, 0]
    found[:, 3] = np.where(torn, -corners.sigma, corners.sigma)
    return found


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
    product: NDArray[np.float64] = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    return product


def _step(grid: Grid) -> float:
    """Return the smaller median step between nodes of a grid, px."""
    steps = [np.linalg.norm(np.diff(grid.xy, axis=axis), axis=2) for axis in (0, 1)]
    return float(min(np.nanmedian(each) for each in steps))


def stencils() -> NDArray[np.float32]:
    """Return the weights of the 7 x 7 nodes around that predict a node, (16, 16, 7, 7).

    The first two axes count its distances from the sides, 4 times the one before plus the one
    behind, up to 3 each. Nodes of too weak predictions have no weights.
    """
    found = np.zeros((16, 16, 7, 7), np.float32)
    for rows in range(16):
        for columns in range(16):
            reach = (-(rows // 4), rows % 4), (-(columns // 4), columns % 4)
            total, mean = 0.0, np.zeros((7, 7))
            for weight, factors in PREDICTORS:
                if all(
                    low <= step <= high
                    for place in factors
                    for step, (low, high) in zip(place, reach, strict=True)
                ):
                    total += weight
                    for (r, c), factor in factors.items():
                        mean[r + 3, c + 3] += weight * factor
            if total >= STRONG:
                found[rows, columns] = mean / total
    return found
