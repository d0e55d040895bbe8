"""The adaptive lattice filter: positions that use the neighbours too, and their error.

On a worn print the visible corner is not at the material point. The image of one corner cannot show
that, but its neighbours in the lattice can. Each node becomes a mixture of local polynomials along
its row and its column. Stein's unbiased risk estimate chooses their widths and degrees at each
node, so that there are no parameters to set. cmp_cl/reference/field/filter.py has the equations,
kernels/filter.cl the kernels.
"""

import dataclasses
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.fits import bilinear_surface
from cmp_cl.motion.layout import (
    covariances,
    defines_of,
    flat,
    in_lines_of,
    matrices,
    nodes,
    of_nodes,
    planes,
)
from cmp_cl.motion.tables import (
    LANES,
    NOISE_GAUSSIAN,
    RISK_GAUSSIAN,
    axis_tables,
    in_lines,
)
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Launch, bound, constant, enqueue, multiple
from cmp_cl.opencl.memory import Layout, Memory
from cmp_cl.opencl.program import Programs, programs_of

ROUNDS = 3  # rounds of the search for outliers
_ESTIMATES, _MASKS = 5, 4  # of the noise, as in kernels/filter.cl
_SHARES = 4  # of the rows for each unit of a CPU; each share costs sums over the lattice
Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Source = NDArray[np.uint8]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Filtered:
    """A filtered lattice of R x C nodes with K coordinates, 2 or 3.

    values: (R, C, K), in the unit of the input, NaN where that is NaN. A node that was rejected,
        because it lies more than six standard deviations from what its neighbours predict, keeps
        its own value and has no influence on them. A rough one is rejected at three, and gets
        their prediction.
    covariance: (R, C, K, K), of the values; where the lattice is too small to show it, that by the
        images. In the plane, both axes have the same variance.
    raw_covariance: the same for the values before the filter.
    noise: (R, C), the standard deviation before the filter, by coordinate, NaN where unknown.
    """

    values: Array
    covariance: Array
    raw_covariance: Array
    noise: Array


def filtered(
    values: Array,
    measured: Source,
    by_images: Array,
    device: Device,
    *,
    own: NDArray[np.floating],
    most: Array | None = None,
) -> Filtered:
    """Filter positions, or displacements, which may bend sharply, as at the edge of a contact.

    values: (R, C, K), NaN where missing. measured: (R, C) of `NodeStatus`, MISSING for nodes that
        may not influence others, which get the prediction of their neighbours. by_images: (R, C, K,
        K), their covariance by the images alone. own: (R, C), the variance per axis by the images
        now, NaN where unknown.
    most: None for positions; for displacements by how much the largest variance of the noise
        exceeds `own`, (R, C), NaN where unknown. A residual beyond it is taken for shape and kept.

    The noise of displacements is also estimated along single directions, the axes and the
    diagonals, to tell it from a bend. A deformation is filtered as one array of displacements, not
    as two of positions: wear that travels with the material cancels in their difference.
    """
    rows, columns, axes = values.shape
    if not rows * columns:
        nothing = np.empty((rows, columns, axes, axes))
        return Filtered(
            values=values,
            covariance=nothing,
            raw_covariance=nothing,
            noise=np.empty((rows, columns)),
        )
    programs = programs_of(device.handle)
    queue = cl.CommandQueue(programs.context)
    results = Memory(queue, LatticeFilter.layout((rows, columns), axes))
    plan = LatticeFilter(
        queue,
        programs,
        device,
        shape=(rows, columns),
        axes=axes,
        results=results,
        bends=most is not None,
    )
    there: Bools = np.asarray(np.isfinite(values).all(axis=2), np.bool_)
    votes, surface = there & (measured > 0), np.zeros(values.shape)
    if most is None and votes.any():
        surface = bilinear_surface(values, votes)
    inputs = plan.inputs.arrays
    inputs["moved"][:] = planes(np.where(there[..., None], values - surface, 0))
    inputs["points"][:] = flat(by_images)
    inputs["own"][:, :columns] = own
    inputs["bound_rest"][:, :columns] = np.nan if most is None else most
    inputs["valid"][:] = there
    inputs["measured"][:] = np.where(there, measured, 0)
    inputs["votes"][:] = votes
    results.arrays["rejected"][:] = 0
    plan.inputs.upload()
    results.upload()
    enqueue(queue, plan.launches)
    results.download()
    queue.finish()
    arrays = results.arrays
    found = Filtered(
        values=nodes(arrays["displacement"]) + surface,
        covariance=matrices(arrays["covariance"]),
        raw_covariance=matrices(arrays["raw_covariance"]),
        noise=np.where(there, np.sqrt(arrays["variance"][:, :columns]), np.nan).astype(np.float64),
    )
    for memory in (plan, results):
        memory.release()
    return found


class LatticeFilter:
    """Buffers and bound kernels that filter lattices of one shape.

    shape: (R, C). axes: K, 2 or 3. bends: whether the values may bend sharply, see
    `filtered`.
    inputs: what the launches start from. moved: K planes (R, C), 0 where there is no value.
    points: their covariance by the images, 6 planes or 1. bent: K planes, subtracted at the end.
    own, bound_rest: (R, C and more columns that are not used), of which the sum is the largest
    variance of the noise. valid, measured, votes: (R, C), the nodes with a value, the source of
    those that have a vote, and these.
    results: holds the arrays of `layout`; rejected is 0.
    """

    def __init__(
        self,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        *,
        shape: tuple[int, int],
        axes: int,
        results: Memory,
        bends: bool,
    ) -> None:
        self._shape, self._axes = shape, axes
        self._is_cpu = device.kind is DeviceKind.CPU
        self._shares = _SHARES * device.handle.max_compute_units
        self._down, self._along = (axis_tables(n) for n in shape)
        self.inputs = Memory(queue, self._inputs())
        self._work = Memory(queue, self._work_layout())
        self.parts: dict[str, Any] = {"bends": np.int32(bends)}
        for memory in (self.inputs, self._work, results):
            self.parts |= memory.parts
        for name, table in self._tables().items():
            self.parts[name] = constant(queue.context, table)
        self._kernels = programs.kernels(["filter"], defines_of(shape, axes, device))
        self.launches = self._listed()

    def release(self) -> None:
        """Release the device's memory."""
        self.inputs.release()
        self._work.release()

    # What is compiled and allocated

    def _inputs(self) -> Layout:
        axes, shape, wide = self._axes, self._shape, in_lines_of(self._shape)
        return {
            **_planes(shape, moved=axes, points=covariances(axes), bent=axes),
            **dict.fromkeys(("own", "bound_rest"), (wide, np.float32)),
            **dict.fromkeys(("valid", "measured", "votes"), (shape, np.uint8)),
        }

    @staticmethod
    def layout(shape: tuple[int, int], axes: int) -> Layout:
        """Return the layout of the results.

        displacement, raw_displacement: K planes (R, C), NaN where not valid. covariance,
        raw_covariance: 6 planes xx xy xz yy yz zz, or the variance per axis. variance: (R, C and
        more columns that are not used), of the noise before the filter. rejected: the nodes that
        each round has rejected; 0 at the end.
        """
        planes = _planes(
            shape,
            displacement=axes,
            raw_displacement=axes,
            covariance=covariances(axes),
            raw_covariance=covariances(axes),
        )
        return {
            **planes,
            "variance": (in_lines_of(shape), np.float32),
            "rejected": ((ROUNDS,), np.int32),
        }

    def _tables(self) -> dict[str, NDArray[Any]]:
        down, along = self._down, self._along
        tables: dict[str, NDArray[Any]] = {
            "sides_down": down.sides,
            "sides_along": along.sides,
            "rows_noise": NOISE_GAUSSIAN,
            "rows_risk": RISK_GAUSSIAN,
        }
        for name in ("filters", "own", "gain", "pilot", "pilot_own"):
            tables[f"{name}_down"] = vars(down)[name]
            tables[f"{name}_along"] = in_lines(vars(along)[name])
        return tables

    def _work_layout(self) -> Layout:
        axes = self._axes
        pairs = len(self._down.sides) * len(self._along.sides)
        products = axes * (axes + 1) // 2
        return _planes(
            in_lines_of(self._shape),
            data=axes,
            vote=1,
            size=1,
            near=products + _MASKS + _ESTIMATES,
            chosen=1,
            common=products,
            estimate=axes * pairs,
            loss=pairs,
            near_votes=1,
            values=axes,
            mixed_noise=1,
            mixed_bias=1,
            mixed_own=1,
        )

    # What is launched

    def _listed(self) -> list[Launch]:
        rows, eights = self._shape[0], multiple(self._shape[1], LANES) // LANES
        down, along = len(self._down.sides), len(self._along.sides)
        group = 1 if self._is_cpu else GROUP
        return [
            self._of_nodes("fill"),
            self._of("pilot", rows, _ESTIMATES),
            self._of("noise", *((self._shares, 1) if self._is_cpu else (rows, eights))),
            bound(self._kernels, self.parts, "settle", (group,), (group,)),
            self._of("smooth", rows, down, 1 if self._is_cpu else along),
            self._of("blend", rows, eights),
            self._of_nodes("finish"),
        ]

    def _of_nodes(self, name: str) -> Launch:
        return of_nodes(self._kernels, self._shape, self.parts, name)

    def _of(self, name: str, *items: int) -> Launch:
        """Bind a kernel with so many work-items, of rows or shares of them and of others."""
        group = (1,) * len(items) if self._is_cpu else None
        return bound(self._kernels, self.parts, name, items, group)


def _planes(shape: tuple[int, int], **counts: int) -> Layout:
    """Return the layout of so many planes (R, C) of numbers by name."""
    return {name: ((count, *shape), np.float32) for name, count in counts.items()}
