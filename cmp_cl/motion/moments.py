"""The nodes at one moment, in the plane or in space, and the field between two."""

import dataclasses
import functools
from typing import Any, Self

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.field import DisplacementField
from cmp_cl.fits import bend_shift, surface_slopes
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus
from cmp_cl.motion.filter import Filtered, filtered
from cmp_cl.motion.layout import (
    covariances,
    defines_of,
    flat,
    matrices,
    nodes,
    of_nodes,
    planes,
)
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.opencl.device import Device
from cmp_cl.opencl.launches import constant, enqueue
from cmp_cl.opencl.memory import Layout, Memory
from cmp_cl.opencl.program import programs_of
from cmp_cl.points import Points3D, PointStatus

Array = NDArray[np.float64]
_OPENED = 3.0  # largest ratio of the wear of a strained print to its wear at rest


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Moment:
    """The nodes at one moment: positions (R, C, D), their covariance from the images alone, (R, C,
    D, D), their status and source, (R, C), and the shift by bent edges, (R, C, D)."""

    at: Array
    covariance: Array
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    bend: Array
    unit: str

    @classmethod
    def in_plane(cls, grid: Grid, scale: PlaneScale) -> Self:
        """Return the nodes of a grid in the plane."""
        at, slope = scale(grid.xy)
        per_axis = grid.image_sigma * np.sqrt(np.square(slope).sum(axis=(-2, -1)) / 2)
        variance = np.where(per_axis > 0, np.square(per_axis), np.nan)
        bend = bend_shift(grid.xy.astype(np.float64), grid.edge_radius)
        return cls(
            at=at,
            covariance=variance[..., None, None] * np.eye(2),
            status=np.where(grid.valid, PointStatus.VALID, PointStatus.MISSING).astype(np.uint8),
            source=grid.status,
            bend=(slope @ bend[..., None])[..., 0],
            unit=scale.unit,
        )

    @classmethod
    def in_space(cls, points: Points3D) -> Self:
        """Return points in space."""
        bend = np.zeros_like(points.xyz) if points.bend_shift is None else points.bend_shift
        return cls(
            at=points.xyz,
            covariance=points.covariance,
            status=points.status,
            source=points.source,
            bend=bend,
            unit=points.unit,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of rows and columns."""
        rows, columns = self.status.shape
        return rows, columns

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a position."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def own(self) -> Array:
        """Return the variance per axis from the images, (R, C), NaN where unknown."""
        mean: Array = np.trace(self.covariance, axis1=2, axis2=3) / self.at.shape[2]
        return np.where(mean > 0, mean, np.nan)


def measured_of(source: NDArray[np.uint8], valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the source of the valid nodes that are measured, MISSING of others, (R, C)."""
    return np.where(valid & np.isin(source, MEASURED), source, np.uint8(NodeStatus.MISSING))


class AtRest:
    """The nodes at rest, and what the lattice filter makes of them on a device."""

    def __init__(self, moment: Moment, device: Device) -> None:
        self.moment, self._device = moment, device

    @functools.cached_property
    def filtered(self) -> Filtered:
        """Return the filtered positions."""
        at, measured = self.moment.at, measured_of(self.moment.source, self.moment.valid)
        own, covariance = self.moment.own, self.moment.covariance
        return filtered(at, measured, covariance, self._device, own=own)

    @functools.cached_property
    def position(self) -> Array:
        """Return them without the shift by bent edges, (R, C, D)."""
        return self.filtered.values - self.moment.bend

    @property
    def most(self) -> Array:
        """Return the share of the positions at rest in the largest variance of the noise of a
        displacement, (R, C), NaN where unknown; that of the images now is added to it.

        What the images do not explain of the noise is wear. Wear moves with the material, but
        strain may open it: in the difference it is assumed to be at most three times its size at
        rest. A print without wear at rest has only the noise of its images.
        """
        own = self.moment.own
        return own + _OPENED**2 * np.maximum(np.square(self.filtered.noise) - own, 0)

    @property
    def strain_constants(self) -> dict[str, NDArray[np.float32]]:
        """Return what the strain's kernel takes of them, see `strain_constants`."""
        return strain_constants(self.position, self.filtered.covariance)

    def field(
        self,
        *,
        status: NDArray[np.uint8],
        source: NDArray[np.uint8],
        moved: Array,
        displacement: Array,
        covariance: Array,
        raw_covariance: Array,
    ) -> DisplacementField:
        """Return the field with these displacements, and before the filter.

        moved, displacement: (R, C, D), before the filter and after it, without the shift by bent
        edges. covariance, raw_covariance: their covariances. All are NaN where there is no
        displacement.
        """
        missing = status != PointStatus.VALID.value

        def known(whole: Array) -> Array:
            values = whole.copy()
            values[missing] = np.nan
            return values

        raw = DisplacementField(
            position=known(self.moment.at),
            displacement=moved,
            covariance=raw_covariance,
            position_covariance=known(self.filtered.raw_covariance),
            status=status,
            source=source,
            unit=self.moment.unit,
        )
        return dataclasses.replace(
            raw,
            position=known(self.position),
            displacement=displacement,
            covariance=covariance,
            position_covariance=known(self.filtered.covariance),
            raw=raw,
            strain_of=_StrainOf(self._device),
        )


def strain_constants(position: Array, covariance: Array) -> dict[str, NDArray[np.float32]]:
    """Return the planes and the tables that the strain's kernel takes of the nodes at rest.

    position: (R, C, D). covariance: (R, C, D, D). NaN where there is no node.
    """
    return {
        "rest_position": planes(position - np.nanmean(position, axis=(0, 1))),
        "rest_covariance": flat(covariance),
        "quadratic": surface_slopes(1, 2).astype(np.float32),
        "cubic": surface_slopes(2, 3).astype(np.float32),
    }


def strain_layout(shape: tuple[int, int]) -> Layout:
    """Return the layout of Green-Lagrange strain, 3 planes (R, C), and its covariance, 6; NaN where
    there is none."""
    return {
        "strain": ((3, *shape), np.float32),
        "strain_covariance": ((covariances(3), *shape), np.float32),
    }


@dataclasses.dataclass(frozen=True, eq=False)
class _StrainOf:
    """Computes the strain of a field on a device; pickled, it is None."""

    device: Device

    def __call__(self, field: DisplacementField) -> tuple[Array, Array]:
        shape, axes = field.status.shape, field.displacement.shape[2]
        programs = programs_of(self.device.handle)
        queue = cl.CommandQueue(programs.context)
        given: dict[str, NDArray[Any]] = {
            **strain_constants(field.position, field.position_covariance),
            "displacement": planes(field.displacement),
            "covariance": flat(field.covariance),
            "valid": field.valid.astype(np.uint8),
        }
        results = Memory(queue, strain_layout(shape))
        parts = {name: constant(queue.context, each) for name, each in given.items()}
        kernels = programs.kernels(["strain"], defines_of(shape, axes, self.device))
        enqueue(queue, [of_nodes(kernels, shape, parts | results.parts, "strain")])
        results.download()
        queue.finish()
        strain, covariance = (results.arrays[name] for name in ("strain", "strain_covariance"))
        found = nodes(strain), matrices(covariance)
        results.release()
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return type(None), ()

    def __deepcopy__(self, _: Any) -> Self:
        return self
