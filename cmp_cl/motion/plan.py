"""The plan of a field: from the nodes of one view or of two to their displacement.

Tables and buffers are made once, and the launches are listed once. A frame then costs the upload of
its nodes, the launches and one read.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.field import DisplacementField
from cmp_cl.filter import Filtered, filter_grid
from cmp_cl.filter.polynomials import STRAIN_REACH
from cmp_cl.grid.grid import MEASURED, Grid
from cmp_cl.motion.geometry import InPlane, InSpace
from cmp_cl.motion.memory import Memory
from cmp_cl.motion.moments import Moment, covariance_from
from cmp_cl.motion.nodes import put
from cmp_cl.motion.tables import (
    LANES,
    NOISE_GAUSSIAN,
    RISK_GAUSSIAN,
    axis_tables,
    in_lines,
)
from cmp_cl.motion.track import Tracker
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.opencl.program import Programs
from cmp_cl.points import PointStatus

ROUNDS = 3  # rounds of the search for outliers
_ESTIMATES, _MASKS = 5, 4  # of the noise, as in kernels/filter.cl
_ROUGH = 6  # sums over a row, in kernels/strain.cl
_PAIRS_OF_AXES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix
Array = NDArray[np.float64]


class FieldPlan:
    """Buffers and bound kernels that turn the nodes of V views into a field of D coordinates.

    rest: the nodes at rest. geometry: how the views show them, in space or in the plane. strain:
    whether fields have a strain.
    frame: what a frame starts from, see `Tracker.layout`, and what comes of it.

    Where the device has no double precision, displacements in space err by some hundredths of a
    micrometre, see `cmp_cl.measure.TwoViews`.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        *,
        rest: Moment,
        geometry: InSpace | InPlane,
        strain: bool = False,
    ) -> None:
        self.shape = rows, columns = rest.status.shape
        self._queue, self._device, self._strained = queue, device, strain
        self._rest, self._geometry = rest, geometry
        self._at_rest = rest.filtered
        self._double = has_double(device)
        self._down, self._along = axis_tables(rows), axis_tables(columns)
        files = [geometry.file, "filter", *(["strain"] if strain else [])]
        self.kernels = programs.kernels(files, self._defines())
        self._position = self._at_rest.values - rest.bend
        self._position_covariance, self._raw_covariance = (
            covariance_from(self._at_rest, sigma, rest.covariance)
            for sigma in (self._at_rest.sigma, self._at_rest.noise)
        )
        self._constants = Memory.of(queue, **self._constant_arrays())
        self._bound_rest = self._constants.arrays["bound_rest"].copy()
        self._work = Memory(queue, self._work_layout())
        self.frame = Memory(queue, self._frame_layout())
        self._parts = {
            name: part
            for memory in (self._constants, self._work, self.frame)
            for name, part in memory.parts.items()
        }
        self.launches = self._listed()

    def release(self) -> None:
        """Release the device's memory."""
        self._queue.finish()
        for memory in (self._constants, self._work, self.frame):
            memory.release()

    # What is compiled and allocated

    def _defines(self) -> dict[str, str | int]:
        rows, columns = self.shape
        down, along = self._down, self._along
        return {
            "ROWS": rows,
            "COLUMNS": columns,
            "K": self._geometry.axes,
            "PILOT_DOWN": down.pilot_side,
            "PILOT_ALONG": along.pilot_side,
            "FILTERS_DOWN": len(down.sides),
            "FILTERS_ALONG": len(along.sides),
            "PAIRS": self._pairs,
            "BEND_DOWN": down.bend.shape[2],
            "BEND_ALONG": along.bend.shape[2],
            "STRAIN_REACH": STRAIN_REACH,
            "STRAINED": int(self._strained),
            "DOUBLE": int(self._double),
            **self._geometry.defines(double=self._double),
        }

    @property
    def _pairs(self) -> int:
        return len(self._down.sides) * len(self._along.sides)

    def _constant_arrays(self) -> dict[str, NDArray[Any]]:
        rest, real = self._rest, np.float64 if self._double else np.float32
        before = np.where(rest.own > 0, np.square(rest.own), np.nan)
        wear = np.maximum(np.square(self._at_rest.noise) - before, 0)
        middle = np.nanmean(self._position, axis=(0, 1))
        by_column, by_row = np.moveaxis(self._at_rest.slope_variance(smoothed=True), 2, 0)
        seen = {name: np.asarray(each, real) for name, each in self._geometry.constants().items()}
        tables = {
            f"{name}_{axis}": getattr(each, name)
            for axis, each in (("down", self._down), ("along", self._along))
            for name in ("sides", "own", "gain", "pilot_own", "bend")
        }
        for name in ("own_along", "gain_along"):
            tables[name] = in_lines(tables[name])
        return {
            **tables,
            "filters_down": self._down.filters,
            "filters_along": in_lines(self._along.matrices),
            "pilot_down": self._down.pilot,
            "pilot_along": in_lines(self._along.pilot_matrix),
            "gram_mean_down": self._down.grams.mean.astype(np.float32),
            "gram_slope_down": self._down.grams.slope.astype(np.float32),
            "gram_mean_along": np.moveaxis(self._along.grams.mean, 1, 3).astype(np.float32),
            "gram_slope_along": np.moveaxis(self._along.grams.slope, 1, 3).astype(np.float32),
            "rows_noise": NOISE_GAUSSIAN,
            "rows_risk": RISK_GAUSSIAN,
            **seen,
            "rest": _planes(rest.at).astype(real),
            "rest_status": rest.status,
            "rest_source": rest.source,
            "rest_points": self._flat(rest.covariance),
            "rest_bent": _planes(rest.bend).astype(np.float32),
            "bound_rest": (before + 9 * wear).astype(np.float32),
            "rest_position": _planes(self._position - middle).astype(np.float32),
            "rest_covariance": self._flat(self._position_covariance),
            "rest_by_column": by_column.astype(np.float32),
            "rest_by_row": by_row.astype(np.float32),
        }

    def _flat(self, covariance: Array) -> NDArray[np.float32]:
        """Return covariances as planes: xx xy xz yy yz zz, or the variance per axis."""
        numbers = _six(covariance) if self._geometry.axes == 3 else covariance[..., :1, 0]
        return _planes(numbers).astype(np.float32)

    def _work_layout(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        axes = self._geometry.axes
        products = axes * (axes + 1) // 2
        of_nodes = {
            "moved": axes,
            "points": self._geometry.covariances,
            "bent": axes,
            "by_column": 1,
            "by_row": 1,
        }
        in_line = {
            "data": axes,
            "size": 1,
            "near": _ESTIMATES + _MASKS + products,
            "variance": 1,
            "chosen": 1,
            "common": products,
            "estimate": axes * self._pairs,
            "loss": self._pairs,
            "unsupported": self._pairs,
            "near_votes": 1,
            "weights": self._pairs if self._strained else 1,
            "values": axes,
            "mixed_variance": 1,
            "left_share": 1,
        }
        rows, columns = self.shape
        wide = rows, multiple(columns, LANES)
        layout: dict[str, tuple[tuple[int, ...], Any]] = {
            **{name: ((count, *self.shape), np.float32) for name, count in of_nodes.items()},
            **{name: ((count, *wide), np.float32) for name, count in in_line.items()},
        }
        layout["sums"] = (self.shape[0], _ESTIMATES * products + 1), np.float32
        layout["rough"] = (self.shape[0], _ROUGH), np.float32
        for name in ("valid", "measured", "votes"):
            layout[name] = self.shape, np.uint8
        return layout

    def _frame_layout(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        axes, covariances = self._geometry.axes, self._geometry.covariances
        planes = {
            "displacement": axes,
            "raw_displacement": axes,
            "covariance": covariances,
            "raw_covariance": covariances,
            "own": 1,
            **({"strain": 3, "strain_covariance": 6} if self._strained else {}),
        }
        layout: dict[str, tuple[tuple[int, ...], Any]] = {
            **Tracker.layout(self._geometry.views, self.shape),
            **{name: ((count, *self.shape), np.float32) for name, count in planes.items()},
        }
        layout["status"] = layout["source"] = self.shape, np.uint8
        layout["counts"] = (1 + ROUNDS,), np.int32
        return layout

    # What is launched

    def _listed(self) -> list[Launch]:
        real = np.float64 if self._double else np.float32
        listed = [
            self._of_nodes(
                self._geometry.kernel,
                *("nodes", "seen_status", "seen_sigma"),
                *self._geometry.arguments(real),
                *("rest", "rest_status", "rest_source", "rest_points", "rest_bent"),
                *("moved", "points", "own", "bent", "status", "source"),
                *("valid", "measured", "votes", "counts"),
            )
        ]
        for number in range(1 + ROUNDS):
            listed += self._round(np.int32(number))
        owns = ("own_down", "own_along")
        listed += [
            self._of_rows(
                "smooth",
                len(self._down.sides),
                *("data", "votes", "counts", "chosen", "sides_down", "sides_along"),
                *("filters_down", "filters_along", *owns, "rows_risk"),
                *("estimate", "loss", "near_votes", "unsupported"),
            ),
            self._of_rows(
                "blend",
                multiple(self.shape[1], LANES) // LANES,
                *("estimate", "loss", "near_votes", "unsupported", "counts"),
                *("variance", "chosen", *owns, "gain_down", "gain_along", "rows_risk"),
                *("weights", "values", "mixed_variance", "left_share"),
            ),
            self._of_nodes(
                self._geometry.finish,
                *("moved", "values", "votes", "measured", "variance", "mixed_variance"),
                *(*self._geometry.finished, "bent", "valid"),
                *("displacement", "raw_displacement", "covariance", "raw_covariance"),
            ),
        ]
        if self._strained:
            listed += [
                self._of_rows("roughness", 1, "data", "votes", "variance", "rough"),
                self._of_rows(
                    "slopes",
                    1,
                    *("weights", "mixed_variance", "left_share", "votes", "rough"),
                    *("gram_mean_down", "gram_slope_down"),
                    *("gram_mean_along", "gram_slope_along", "by_column", "by_row"),
                ),
                self._of_nodes(
                    "strain",
                    *("rest_position", "displacement", "valid", "covariance"),
                    *("by_column", "by_row", "rest_covariance"),
                    *("rest_by_column", "rest_by_row", "strain", "strain_covariance"),
                ),
            ]
        return listed

    def _round(self, number: np.int32) -> list[Launch]:
        """Return the launches of a round of the search for outliers."""
        pilots = ("pilot_own_down", "pilot_own_along", "rows_noise")
        return [
            self._of_nodes("fill", "moved", "votes", "counts", number, "data"),
            self._of_rows(
                "pilot",
                1,
                *("data", "votes", "counts", number, "pilot_down", "pilot_along"),
                *(*pilots, "size", "near", "sums"),
            ),
            self._of_rows(
                "noise",
                1,
                *("near", "sums", "size", *pilots, "bound_rest", "own", number, "counts"),
                *("votes", "variance", "chosen", "common"),
            ),
        ]

    def _of_nodes(self, name: str, *arguments: Any) -> Launch:
        """Bind a kernel with one work-item per node."""
        nodes = self.shape[0] * self.shape[1]
        return self._bound(name, (multiple(nodes, GROUP),), (GROUP,), arguments)

    def _of_rows(self, name: str, others: int, *arguments: Any) -> Launch:
        """Bind a kernel with one work-item per row, times `others`."""
        group = (1, 1) if self._device.kind is DeviceKind.CPU else None
        return self._bound(name, (self.shape[0], others), group, arguments)

    def _bound(
        self,
        name: str,
        items: tuple[int, ...],
        group: tuple[int, ...] | None,
        arguments: tuple[Any, ...],
    ) -> Launch:
        """Bind a kernel to its arguments, numbers and names of arrays."""
        given = [self._parts[each] if isinstance(each, str) else each for each in arguments]
        return Launch(name, self.kernels.bind(name, *given), items, group, {})

    # What happens in a frame

    def take(self, grids: Sequence[Grid], corners: Sequence[Corners]) -> None:
        """Take the nodes of the grids of all views, and enqueue their upload."""
        for view, (grid, found) in enumerate(zip(grids, corners, strict=True)):
            put(self.frame.arrays, view, grid, found)
        self.frame.upload()

    def start(self) -> list[tuple[str, cl.Event]]:
        """Enqueue the launches and the download of the results; return the event of each launch.
        The inputs are on the device."""
        queue = self._queue
        cl.enqueue_fill_buffer(
            queue, self._parts["counts"], np.zeros(1, np.int32), 0, 4 * (1 + ROUNDS)
        )
        events = [
            (
                each.stage,
                cl.enqueue_nd_range_kernel(queue, each.kernel, each.items, each.group),
            )
            for each in self.launches
        ]
        self.frame.download()
        queue.flush()
        return events

    def read(self) -> dict[str, NDArray[Any]]:
        """Wait for the launches. Return copies of the arrays of the frame by name; results are
        planes (N, R, C) float32, status and source (R, C) uint8."""
        self._queue.finish()
        return {name: values.copy() for name, values in self.frame.arrays.items()}

    def field(self, results: dict[str, NDArray[Any]]) -> DisplacementField:
        """Return the field that the results of `read` describe."""
        status, source = results["status"], results["source"]
        valid = status == PointStatus.VALID
        there = valid[..., None]
        raw_displacement = _nodes(results["raw_displacement"])
        change = _Change(
            values=raw_displacement,
            valid=valid,
            source=source,
            bound_rest=self._bound_rest,
            own=results["own"][0],
        )
        both: dict[str, Any] = {
            "status": status,
            "source": source,
            "unit": self._rest.unit,
            "lattice": (self._at_rest, change),
        }
        raw = DisplacementField(
            position=np.where(there, self._rest.at, np.nan),
            displacement=raw_displacement,
            covariance=_matrices(results["raw_covariance"]),
            position_covariance=np.where(there[..., None], self._raw_covariance, np.nan),
            **both,
        )
        return DisplacementField(
            position=np.where(there, self._position, np.nan),
            displacement=_nodes(results["displacement"]),
            covariance=_matrices(results["covariance"]),
            position_covariance=np.where(there[..., None], self._position_covariance, np.nan),
            raw=raw,
            strain=_nodes(results["strain"]) if self._strained else None,
            strain_covariance=(_matrices(results["strain_covariance"]) if self._strained else None),
            **both,
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class _Change:
    """What a strain asks of the filter of a displacement. The host filters it again when asked.

    values: (R, C, D), before the filter. valid, source: as in a field. bound_rest: (R, C), the part
    at rest of the largest variance of the noise. own: the variance now, from the images.
    """

    values: Array
    valid: NDArray[np.bool_]
    source: NDArray[np.uint8]
    bound_rest: NDArray[np.float32]
    own: NDArray[np.float32]

    @functools.cached_property
    def _filtered(self) -> Filtered:
        return filter_grid(
            self.values,
            measured=self.valid & np.isin(self.source, MEASURED),
            bends=True,
            most_noise=np.sqrt(self.bound_rest + self.own),
        )

    def slope_variance(self, *, smoothed: bool) -> Array:
        """Return the variances of the slopes, (R, C, 2), see `Filtered.slope_variance`."""
        return self._filtered.slope_variance(smoothed=smoothed)


def has_double(device: Device) -> bool:
    """Return whether a device computes in double precision."""
    return "cl_khr_fp64" in device.handle.extensions


def _six(matrices: Array) -> Array:
    """Return xx xy xz yy yz zz of symmetric matrices (R, C, 3, 3), (R, C, 6)."""
    return np.stack([matrices[..., i, j] for i, j in _PAIRS_OF_AXES], axis=-1)


def _planes(values: Array) -> Array:
    """Return (R, C, K) values as planes, (K, R, C)."""
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))


def _nodes(planes: NDArray[np.float32]) -> Array:
    """Return planes (K, R, C) as values of nodes, (R, C, K) float64."""
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1), np.float64)


def _matrices(planes: NDArray[np.float32]) -> Array:
    """Return the symmetric matrices (R, C, D, D) float64 of xx xy xz yy yz zz, (6, R, C), or of the
    variance per axis of a plane, (1, R, C)."""
    if len(planes) == 1:
        flat: Array = planes[0, ..., None, None] * np.eye(2)
        return flat
    place = np.zeros((3, 3), np.intp)
    for number, (i, j) in enumerate(_PAIRS_OF_AXES):
        place[i, j] = place[j, i] = number
    return np.ascontiguousarray(np.moveaxis(planes[place], (0, 1), (2, 3)), np.float64)
