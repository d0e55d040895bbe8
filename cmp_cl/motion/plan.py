"""The plan of a field: from the nodes of one view or of two to their displacement.

Tables and buffers are made once, and the launches are listed once. A frame then costs the upload of
its nodes, the launches and one read.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.field import DisplacementField
from cmp_cl.grid.grid import Grid
from cmp_cl.motion.filter import LatticeFilter
from cmp_cl.motion.geometry import InPlane, InSpace
from cmp_cl.motion.layout import (
    defines_of,
    flat,
    matrices,
    nodes,
    of_nodes,
    planes,
)
from cmp_cl.motion.moments import AtRest, Moment, strain_layout
from cmp_cl.motion.nodes import put
from cmp_cl.motion.tables import axis_tables
from cmp_cl.motion.track import Tracker
from cmp_cl.opencl.device import Device, DeviceKind, clear_errors
from cmp_cl.opencl.launches import constant, enqueue
from cmp_cl.opencl.memory import Layout, Memory
from cmp_cl.opencl.program import Programs

Array = NDArray[np.float64]


class FieldPlan:
    """Buffers and bound kernels that turn the nodes of V views into a field of D coordinates.

    rest: the nodes at rest. geometry: how the views show them, in space or in the plane. strain:
    whether fields have a strain. listed: numbers of each view, written by others, that the host
    reads with the results.
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
        listed: int = 0,
    ) -> None:
        self.shape = rest.shape
        self._queue, self._strained, self._geometry = queue, strain, geometry
        self._at_rest = AtRest(rest, device)
        self._double = has_double(device)
        self.frame = Memory(queue, self._frame_layout(listed))
        self._filter = LatticeFilter(
            queue,
            programs,
            device,
            shape=self.shape,
            axes=geometry.axes,
            results=self.frame,
            bends=True,
        )
        self._filter.inputs.arrays["bound_rest"][:, : self.shape[1]] = self._at_rest.most
        self._filter.inputs.upload()
        width = geometry.width if device.kind is DeviceKind.CPU else 1
        defines = {
            **defines_of(self.shape, geometry.axes, device),
            "DOUBLE": int(self._double),
            "WIDTH": width,
            **geometry.defines(double=self._double),
        }
        kernels = programs.kernels([geometry.file], defines)
        parts = self._filter.parts | geometry.numbers(np.float64 if self._double else np.float32)
        for name, table in self._tables().items():
            parts[name] = constant(queue.context, table)
        moved = of_nodes(kernels, self.shape, parts, geometry.kernel, width)
        self.launches = [moved, *self._filter.launches]
        if strain:
            kernels = programs.kernels(["strain"], defines_of(self.shape, geometry.axes, device))
            for name, each in self._at_rest.strain_constants.items():
                parts[name] = constant(queue.context, each)
            self.launches.append(of_nodes(kernels, self.shape, parts, "strain"))

    def release(self) -> None:
        """Release the device's memory."""
        self._filter.release()
        self.frame.release()

    def _tables(self) -> dict[str, NDArray[Any]]:
        rest, real = self._at_rest.moment, np.float64 if self._double else np.float32
        down, along = (axis_tables(n) for n in self.shape)
        seen = {name: np.asarray(each, real) for name, each in self._geometry.constants().items()}
        return {
            "bend_down": down.bend,
            "bend_along": along.bend,
            **seen,
            "rest": np.moveaxis(rest.at, -1, 0).astype(real),
            "rest_status": rest.status,
            "rest_source": rest.source,
            "rest_points": flat(rest.covariance),
            "rest_bent": planes(rest.bend),
        }

    def _frame_layout(self, listed: int) -> Layout:
        layout = {
            **Tracker.layout(self._geometry.views, self.shape),
            **LatticeFilter.layout(self.shape, self._geometry.axes),
            **(strain_layout(self.shape) if self._strained else {}),
            "status": (self.shape, np.uint8),
            "source": (self.shape, np.uint8),
        }
        for name, count in self._geometry.own_results.items():
            layout[name] = (count, *self.shape), np.float32
        if listed:
            layout["listed"] = (self._geometry.views, listed), np.float32
        return layout

    # What happens in a frame

    def take(self, grids: Sequence[Grid], corners: Sequence[Corners]) -> None:
        """Take the nodes of the grids of all views, and enqueue their upload."""
        for view, (grid, found) in enumerate(zip(grids, corners, strict=True)):
            put(self.frame.arrays, view, grid, found)
        self.frame.upload()

    def start(self) -> list[tuple[str, cl.Event]]:
        """Enqueue the launches and the download of the results; return the event of each launch.
        The inputs are on the device."""
        events = enqueue(self._queue, self.launches)
        self._done = [events[-1][1], *self.frame.download()][-1]
        self._queue.flush()
        return events

    def read(self) -> dict[str, NDArray[Any]]:
        """Wait for what was started. Return copies of the arrays of the frame by name; results are
        planes (N, R, C) float32, status and source (R, C) uint8."""
        with clear_errors(self._queue.device):
            self._done.wait()
        return self.frame.copies()

    def field(self, results: dict[str, NDArray[Any]]) -> DisplacementField:
        """Return the field that the results of `read` describe."""
        status, source = results["status"], results["source"]
        field = self._at_rest.field(
            status=status,
            source=source,
            moved=nodes(results["raw_displacement"]),
            displacement=nodes(results["displacement"]),
            covariance=matrices(results["covariance"]),
            raw_covariance=matrices(results["raw_covariance"]),
        )
        if not self._strained:
            return field
        return dataclasses.replace(
            field,
            strain=nodes(results["strain"]),
            strain_covariance=matrices(results["strain_covariance"]),
        )


def has_double(device: Device) -> bool:
    """Return whether a device computes in double precision."""
    return "cl_khr_fp64" in device.handle.extensions
