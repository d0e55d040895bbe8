"""The nodes at one moment, in the plane or in space, and the field between two."""

import dataclasses
import functools
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cmp_cl.field import DisplacementField
from cmp_cl.fits import bend_shift, surface_slopes
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus
from cmp_cl.motion.filter import Filtered, filtered
from cmp_cl.motion.layout import flat, matrices, nodes, planes
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.opencl.device import Device
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
    """The nodes at rest, and what the lattice filter makes of them on a device.

    slopes: whether the covariances of slopes will be used.
    """

    def __init__(self, moment: Moment, device: Device, *, slopes: bool = False) -> None:
        self.moment, self._device, self._slopes = moment, device, slopes

    @functools.cached_property
    def filtered(self) -> Filtered:
        """Return the filtered positions."""
        at, measured = self.moment.at, measured_of(self.moment.source, self.moment.valid)
        own, covariance = self.moment.own, self.moment.covariance
        return filtered(at, measured, covariance, self._device, own=own, slopes=self._slopes)

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

    @functools.cached_property
    def strain_constants(self) -> dict[str, NDArray[np.float32]]:
        """Return the planes of the positions, and the tables, that the strain's kernel takes."""
        found = (self if self._slopes else AtRest(self.moment, self._device, slopes=True)).filtered
        return {
            "rest_position": planes(self.position - np.nanmean(self.position, axis=(0, 1))),
            "rest_covariance": flat(found.covariance),
            "rest_slopes": found.slopes,
            "quadratic": surface_slopes(1, 2).astype(np.float32),
            "cubic": surface_slopes(2, 3).astype(np.float32),
        }

    def change(
        self,
        moved: Array,
        measured: NDArray[np.uint8],
        own: NDArray[np.floating],
        by_images: Array | None = None,
        **strained: Any,
    ) -> Filtered:
        """Filter the displacement `moved`, (R, C, D).

        measured: (R, C), see `measured_of`. own: (R, C), the variance per axis now, from the
        images. by_images: the covariance of `moved` from the images. strained: see `filtered`.
        """
        if by_images is None:
            by_images = np.zeros((*moved.shape, moved.shape[2]))
        return filtered(
            moved, measured, by_images, self._device, own=own, most=self.most, **strained
        )

    def field(
        self,
        *,
        status: NDArray[np.uint8],
        source: NDArray[np.uint8],
        moved: Array,
        own: NDArray[np.floating],
        displacement: Array,
        covariance: Array,
        raw_covariance: Array,
    ) -> DisplacementField:
        """Return the field with these displacements, and before the filter.

        moved, displacement: (R, C, D), before the filter and after it, without the shift by bent
        edges. covariance, raw_covariance: their covariances. All are NaN where there is no
        displacement. own: as in `change`.
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
            strain_of=_StrainOf(self, moved, own),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _StrainOf:
    """Computes the strain of the field of a moment on its device; pickled, it is None."""

    at_rest: AtRest
    moved: Array
    own: NDArray[np.floating]

    def __call__(self, field: DisplacementField) -> tuple[Array, Array]:
        measured = measured_of(field.source, field.valid)
        rest = {
            **self.at_rest.strain_constants,
            "displacement": planes(field.displacement),
            "covariance": flat(field.covariance),
        }
        found = self.at_rest.change(self.moved, measured, self.own, slopes=True, rest=rest)
        return nodes(found.strain), matrices(found.strain_covariance)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(None), ()

    def __deepcopy__(self, _: Any) -> Self:
        return self
