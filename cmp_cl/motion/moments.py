"""The nodes at one moment, in the plane or in space."""

import dataclasses
import functools
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter import Filtered, bend_shift, filter_at_rest
from cmp_cl.grid.grid import MEASURED, Grid
from cmp_cl.motion.scale import PlaneScale
from cmp_cl.points import Points3D, PointStatus

Array = NDArray[np.float64]


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
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a position."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def own(self) -> Array:
        """Return the standard deviation per axis from the images, (R, C)."""
        variance: Array = np.trace(self.covariance, axis1=2, axis2=3) / self.at.shape[2]
        return np.sqrt(variance)

    @functools.cached_property
    def filtered(self) -> Filtered:
        """Return what the lattice filter finds for the positions of a pattern at rest."""
        return filter_at_rest(self.at, measured=np.isin(self.source, MEASURED))


def covariance_from(filtered: Filtered, sigma: Array, by_images: Array) -> Array:
    """Return the covariance from the lattice, or from the images where that is unknown, (R, C, D,
    D). In the plane, both axes have the same variance."""
    lattice = filtered.covariance_of(sigma)
    if lattice.shape[2] == 2:
        lattice = np.square(sigma)[..., None, None] * np.eye(2)
    known = np.isfinite(lattice).all(axis=(2, 3), keepdims=True)
    return np.where(known, lattice, by_images)
