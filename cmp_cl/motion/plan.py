"""The plan of a field: from the nodes of two views to their displacement in space.

Tables and buffers are made once, and the launches are listed once. A frame then costs the upload of
its nodes, the launches and one read.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.field import DisplacementField
from cmp_cl.filter import Filtered, filter_at_rest, filter_grid
from cmp_cl.filter.polynomials import STRAIN_REACH
from cmp_cl.grid.grid import MEASURED, Grid
from cmp_cl.motion.memory import Memory
from cmp_cl.motion.nodes import put
from cmp_cl.motion.tables import (
    NOISE_GAUSSIAN,
    RISK_GAUSSIAN,
    axis_tables,
)
from cmp_cl.motion.track import Tracker
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Launch, multiple
from cmp_cl.opencl.program import Programs
from cmp_cl.space import Points3D, PointStatus, StereoRig, Window
from cmp_cl.space.rig import MIN_PARALLAX

LARGEST_ERROR = 3.0  # px, of the reprojection, as in `StereoRig.triangulate`
ROUNDS = 3  # rounds of the search for outliers
_COEFFICIENTS = 12  # of distortion, in kernels/space.cl
_ESTIMATES, _MASKS = 5, 4  # of the noise, as in kernels/filter.cl
_ROUGH = 6  # sums over a row, in kernels/strain.cl
_PAIRS_OF_AXES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix
Array = NDArray[np.float64]


class FieldPlan:
    """Buffers and bound kernels that turn the nodes of two views into a displacement field.

    rest: the points at rest. rig: the cameras. edge_radii: of the left and the right grid, px, NaN
    if unknown. strain: whether fields have a strain.
    frame: what a frame starts from, see `Tracker.layout`, and what comes of it.

    Where the device has no double precision, points err by some hundredths of a micrometre.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        *,
        rest: Points3D,
        rig: StereoRig,
        edge_radii: Sequence[float] = (math.nan, math.nan),
        strain: bool = False,
    ) -> None:
        self.shape = rows, columns = rest.status.shape
        self._queue, self._device, self._strained = queue, device, strain
        self._rest = rest
        self._double = has_double(device)
        self._down, self._along = axis_tables(rows), axis_tables(columns)
        files = ["space", "filter", *(["strain"] if strain else [])]
        self.kernels = programs.kernels(files, self._defines(rig))
        self._at_rest = filter_at_rest(rest.xyz, measured=np.isin(rest.source, MEASURED))
        bend = 0.0 if rest.bend_shift is None else rest.bend_shift
        self._position = self._at_rest.values - bend
        self._position_covariance, self._raw_covariance = (
            np.where(
                np.isfinite(sigma)[..., None, None],
                self._at_rest.covariance_of(sigma),
                rest.covariance,
            )
            for sigma in (self._at_rest.sigma, self._at_rest.noise)
        )
        self._constants = Memory.of(queue, **self._constant_arrays(rig))
        self._work = Memory(queue, self._work_layout())
        self.frame = Memory(queue, self._frame_layout())
        self._parts = {
            name: part
            for memory in (self._constants, self._work, self.frame)
            for name, part in memory.parts.items()
        }
        self.launches = self._listed(edge_radii)
        self.events: list[tuple[str, cl.Event]] = []

    def release(self) -> None:
        """Release the device's memory."""
        self._queue.finish()
        for memory in (self._constants, self._work, self.frame):
            memory.release()

    # What is compiled and allocated

    def _defines(self, rig: StereoRig) -> dict[str, str | int]:
        rows, columns = self.shape
        down, along = self._down, self._along
        return {
            "ROWS": rows,
            "COLUMNS": columns,
            "K": 3,
            "PILOT_DOWN": down.pilot_side,
            "PILOT_ALONG": along.pilot_side,
            "FILTERS_DOWN": len(down.sides),
            "FILTERS_ALONG": len(along.sides),
            "PAIRS": self._pairs,
            "BEND_DOWN": down.bend.shape[2],
            "BEND_ALONG": along.bend.shape[2],
            "STRAIN_REACH": STRAIN_REACH,
            "MEDIA": 0 if rig.window is None else len(rig.window.layers) + 1,
            "NEAR": "1e-7" if self._double else "1e-3f",
            "DOUBLE": int(self._double),
            "EXACT": "1e-9" if self._double else "1e-3f",
            "TINY": "1e-300" if self._double else "1e-30f",
        }

    @property
    def _pairs(self) -> int:
        return len(self._down.sides) * len(self._along.sides)

    def _constant_arrays(self, rig: StereoRig) -> dict[str, NDArray[Any]]:
        rest, real = self._rest, np.float64 if self._double else np.float32
        before = np.trace(rest.covariance, axis1=2, axis2=3) / 3
        before = np.where(before > 0, before, np.nan)
        wear = np.maximum(np.square(self._at_rest.noise) - before, 0)
        middle = np.nanmean(self._position, axis=(0, 1))
        by_column, by_row = np.moveaxis(self._at_rest.slope_variance(smoothed=True), 2, 0)
        bend = np.zeros_like(rest.xyz) if rest.bend_shift is None else rest.bend_shift
        tables = {
            f"{name}_{axis}": getattr(each, name)
            for axis, each in (("down", self._down), ("along", self._along))
            for name in ("sides", "filters", "own", "gain", "pilot", "pilot_own", "bend")
        }
        return {
            **tables,
            "gram_mean_down": self._down.grams.mean.astype(np.float32),
            "gram_slope_down": self._down.grams.slope.astype(np.float32),
            "gram_mean_along": np.moveaxis(self._along.grams.mean, 1, 3).astype(np.float32),
            "gram_slope_along": np.moveaxis(self._along.grams.slope, 1, 3).astype(np.float32),
            "rows_noise": NOISE_GAUSSIAN,
            "rows_risk": RISK_GAUSSIAN,
            "left": camera_numbers(
                rig.K1, rig.D1, np.eye(3), np.zeros(3), window=rig.window
            ).astype(real),
            "right": camera_numbers(rig.K2, rig.D2, rig.R, rig.T, window=rig.window).astype(real),
            "rest": _planes(rest.xyz).astype(real),
            "rest_status": rest.status,
            "rest_source": rest.source,
            "rest_points": _planes(_six(rest.covariance)).astype(np.float32),
            "rest_bent": _planes(bend).astype(np.float32),
            "bound_rest": (before + 9 * wear).astype(np.float32),
            "rest_position": _planes(self._position - middle).astype(np.float32),
            "rest_covariance": _planes(_six(self._position_covariance)).astype(np.float32),
            "rest_by_column": by_column.astype(np.float32),
            "rest_by_row": by_row.astype(np.float32),
        }

    def _work_layout(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        planes = {
            "moved": 3,
            "points": 6,
            "bent": 3,
            "data": 3,
            "residual": 3,
            "size": 1,
            "near": _ESTIMATES + _MASKS + 6,
            "variance": 1,
            "chosen": 1,
            "common": 6,
            "estimate": 3 * self._pairs,
            "loss": self._pairs,
            "near_votes": 1,
            "weights": self._pairs,
            "values": 3,
            "mixed_variance": 1,
            "left_share": 1,
            "by_column": 1,
            "by_row": 1,
        }
        layout: dict[str, tuple[tuple[int, ...], Any]] = {
            name: ((count, *self.shape), np.float32) for name, count in planes.items()
        }
        layout["sums"] = (self.shape[0], _ESTIMATES * 6 + 1), np.float32
        layout["rough"] = (self.shape[0], _ROUGH), np.float32
        layout["unsupported"] = (self._pairs, *self.shape), np.uint8
        for name in ("valid", "measured", "votes"):
            layout[name] = self.shape, np.uint8
        return layout

    def _frame_layout(self) -> dict[str, tuple[tuple[int, ...], Any]]:
        planes = {
            "displacement": 3,
            "raw_displacement": 3,
            "covariance": 6,
            "raw_covariance": 6,
            "sigma": 1,
            "raw_sigma": 1,
            "own": 1,
            **({"strain": 3, "strain_covariance": 6} if self._strained else {}),
        }
        layout: dict[str, tuple[tuple[int, ...], Any]] = {
            **Tracker.layout(len(_VIEWS), self.shape),
            **{name: ((count, *self.shape), np.float32) for name, count in planes.items()},
        }
        layout["status"] = layout["source"] = self.shape, np.uint8
        layout["counts"] = (1 + ROUNDS,), np.int32
        return layout

    # What is launched

    def _listed(self, edge_radii: Sequence[float]) -> list[Launch]:
        left, right = (np.float32(radius if radius >= 0 else 0) for radius in edge_radii)
        focal = float(np.mean([self._camera("left")[:2], self._camera("right")[:2]]))
        real = np.float64 if self._double else np.float32
        listed = [
            self._of_nodes(
                "space",
                *("nodes", "seen_status", "seen_sigma", *_VIEWS),
                real(MIN_PARALLAX / focal),
                np.float32(LARGEST_ERROR),
                "bend_down",
                "bend_along",
                left,
                right,
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
                1,
                *("estimate", "loss", "near_votes", "unsupported", "counts"),
                *("variance", "chosen", *owns, "gain_down", "gain_along", "rows_risk"),
                *("weights", "values", "mixed_variance", "left_share"),
            ),
            self._of_nodes(
                "finish_in_space",
                *("moved", "values", "votes", "measured", "variance", "mixed_variance"),
                *("common", "points", "bent", "valid", "displacement", "raw_displacement"),
                *("covariance", "raw_covariance", "sigma", "raw_sigma"),
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
                *(*pilots, "residual", "size", "near", "sums"),
            ),
            self._of_rows(
                "noise",
                1,
                *("near", "sums", "size", *pilots, "bound_rest", "own", number, "counts"),
                *("votes", "variance", "chosen", "common"),
            ),
        ]

    def _camera(self, view: str) -> NDArray[Any]:
        return self._constants.arrays[view]

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

    def start(self) -> None:
        """Enqueue the launches and the download of the results. The inputs are on the device."""
        queue = self._queue
        cl.enqueue_fill_buffer(
            queue, self._parts["counts"], np.zeros(1, np.int32), 0, 4 * (1 + ROUNDS)
        )
        self.events.clear()
        for launch in self.launches:
            event = cl.enqueue_nd_range_kernel(queue, launch.kernel, launch.items, launch.group)
            self.events.append((launch.stage, event))
        self.frame.download()
        queue.flush()

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
            measured=valid & np.isin(source, MEASURED),
            most_noise=np.sqrt(self._constants.arrays["bound_rest"] + results["own"][0]),
        )
        both: dict[str, Any] = {
            "status": status,
            "source": source,
            "unit": self._rest.unit,
            "lattice": (self._at_rest, change),
        }
        raw = DisplacementField(
            position=np.where(there, self._rest.xyz, np.nan),
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

    values: (R, C, 3), before the filter. measured: (R, C). most_noise: (R, C), as `filter_grid`
    takes them.
    """

    values: Array
    measured: NDArray[np.bool_]
    most_noise: Array

    @functools.cached_property
    def _filtered(self) -> Filtered:
        return filter_grid(
            self.values, measured=self.measured, bends=True, most_noise=self.most_noise
        )

    def slope_variance(self, *, smoothed: bool) -> Array:
        """Return the variances of the slopes, (R, C, 2), see `Filtered.slope_variance`."""
        return self._filtered.slope_variance(smoothed=smoothed)


def fits(rig: StereoRig) -> bool:
    """Return whether kernels/space.cl has the lens model of both cameras: not a tilted sensor's."""
    return max(len(rig.D1), len(rig.D2)) <= _COEFFICIENTS


_VIEWS = ("left", "right")


def has_double(device: Device) -> bool:
    """Return whether a device computes in double precision."""
    return "cl_khr_fp64" in device.handle.extensions


def camera_numbers(
    matrix: Array, distortion: Array, rotation: Array, move: Array, *, window: Window | None = None
) -> Array:
    """Return a camera as kernels/space.cl takes it, (31,), and its window after it.

    rotation, move: from the frame of the left camera. The coefficients of distortion are at most
    12; those of a tilted sensor have no place. window: before the camera; None is air.
    """
    coefficients = np.zeros(_COEFFICIENTS)
    coefficients[: len(distortion)] = distortion
    focal, middle, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2], -move @ rotation
    numbers = [focal, middle, coefficients, rotation.ravel(), move, centre]
    if window is not None:
        media = [*window.layers, (0.0, window.index)]
        numbers += [window.normal, np.array([window.height(centre)]), np.ravel(media)]
    return np.concatenate(numbers)


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
    """Return the symmetric matrices (R, C, 3, 3) float64 of xx xy xz yy yz zz, (6, R, C)."""
    place = np.zeros((3, 3), np.intp)
    for number, (i, j) in enumerate(_PAIRS_OF_AXES):
        place[i, j] = place[j, i] = number
    return np.ascontiguousarray(np.moveaxis(planes[place], (0, 1), (2, 3)), np.float64)
