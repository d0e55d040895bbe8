"""The displacement of the nodes between two moments, and their strain."""

import dataclasses
import functools
import math
from collections.abc import Callable
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field.nodes import node_columns, surface
from cmp_cl.field.strain import principal_of, surface_normals
from cmp_cl.files import suffix_of, whole_file, write_bytes, write_csv
from cmp_cl.points import PointStatus, largest_deviation

Array = NDArray[np.float64]

_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3}
_STRAIN = ("strain", "strain_sigma", "principal", "principal_sigma", "direction", "direction_sigma")
_LENGTHS = "position", "displacement", "sigma", "position_sigma"
_IN_FILES = *_LENGTHS, *_STRAIN


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisplacementField:
    """The position of each of R x C nodes at rest, and its displacement; D = 2 or 3 coordinates.

    position: (R, C, D) float64, at rest, in `unit`; NaN unless the node is valid. In space, in the
        frame of the left camera; from one camera, in the plane that its scale defines.
    displacement: (R, C, D) float64, in `unit`, NaN unless the node is valid.
    covariance: (R, C, D, D) float64, of the displacement, in `unit` squared; NaN where unknown.
    position_covariance: (R, C, D, D) float64, the same of `position`; it includes wear.
    status: (R, C) uint8 of `PointStatus`: the status now, or that at rest if that is not VALID.
    source: (R, C) uint8 of `NodeStatus`: of those at rest and now, the less direct one.
    unit: name of the unit of length.
    raw: the field before the lattice filter; None if this one is not filtered.
    strain_of: returns the strain of this field and its covariance, for `with_strain`; None if it
        was not measured, comes from a pickle, or is before the filter.

    strain: (R, C, 3) float64, Green-Lagrange strain E11, E22, E12, see `field.green_lagrange`; None
        if it was not asked for. In the plane, 1 and 2 are x and y; in space, 1 runs along the rows
        and 2 is perpendicular to it in the tangent plane at rest. NaN where too few neighbours are
        valid.
    strain_covariance: (R, C, 3, 3) float64, of these three.

    `with_strain` adds the strain. What follows from it is there if it is: strain_sigma, principal,
    principal_sigma, direction and direction_sigma.
    """

    position: Array
    displacement: Array
    covariance: Array
    position_covariance: Array
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    unit: str
    raw: "DisplacementField | None" = None
    strain_of: "Callable[[DisplacementField], tuple[Array, Array]] | None" = None
    strain: Array | None = None
    strain_covariance: Array | None = None

    def __repr__(self) -> str:
        rows, columns = self.status.shape
        return (
            f"<DisplacementField of {rows} x {columns} nodes in {self.unit}: "
            f"{np.count_nonzero(self.valid)} valid>"
        )

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a displacement."""
        return np.equal(self.status, PointStatus.VALID)

    @functools.cached_property
    def sigma(self) -> Array:
        """Return the standard deviation along the most uncertain axis, (R, C), in `unit`, or
        NaN."""
        return largest_deviation(self.covariance)

    @property
    def position_sigma(self) -> Array:
        """Return the same for the position at rest, (R, C) float64."""
        return largest_deviation(self.position_covariance)

    @property
    def strain_sigma(self) -> Array | None:
        """Return the standard deviations of the strain, (R, C, 3) float64."""
        if self.strain_covariance is None:
            return None
        variance = np.diagonal(self.strain_covariance, axis1=2, axis2=3)
        return np.sqrt(np.maximum(variance, 0))

    @property
    def principal(self) -> Array | None:
        """Return the larger and the smaller principal strain, (R, C, 2) float64.

        Where the two differ by less than their sigma, the difference may be noise alone.
        """
        return self._principal[0]

    @property
    def principal_sigma(self) -> Array | None:
        """Return the standard deviations of the principal strains, (R, C, 2) float64."""
        return self._principal[1]

    @property
    def direction(self) -> Array | None:
        """Return the direction of the larger principal strain, (R, C) float64 in [-pi/2, pi/2],
        rad, from axis 1 towards axis 2."""
        return self._principal[2]

    @property
    def direction_sigma(self) -> Array | None:
        """Return the standard deviation of the direction, (R, C) float64, rad.

        It is pi / sqrt(12), that of an unknown direction, where half the difference of the
        principal strains is below 3 of its standard deviations.
        """
        return self._principal[3]

    @functools.cached_property
    def _principal(self) -> tuple[Array, Array, Array, Array] | tuple[None, None, None, None]:
        if self.strain is None or self.strain_covariance is None:
            return None, None, None, None
        return principal_of(self.strain, self.strain_covariance)

    def with_strain(self) -> Self:
        """Return the same field with its strain, see `field.green_lagrange`, and its covariance.

        Errors of filtered neighbours are taken to be alike as they are on average. Raises
        FieldError for a field before the lattice filter, and for one that was not measured or comes
        from a pickle.
        """
        if self.strain is not None:
            return self
        if self.strain_of is None:
            raise FieldError(
                "the error of this field's strain is unknown: it was not measured, or it is before "
                "the lattice filter (take the filtered field), or it comes from a pickle (take the "
                "strain before); cmp_cl.field.green_lagrange gives a strain without an error"
            )
        strain, covariance = self.strain_of(self)
        return dataclasses.replace(self, strain=strain, strain_covariance=covariance)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the field by suffix, whole or not at all.

        .npz: the arrays under their names, for numpy.load. .csv: a row per node, the unit in the
        header, nan where missing. .vtp: the valid nodes and the quadrilaterals between them, for
        ParaView. The raw field is written beside a filtered one; the names of its arrays begin with
        raw_. Raises ConfigError on another suffix, OSError if the file cannot be written.
        """
        suffix = suffix_of(path)
        arrays: dict[str, NDArray[Any]] = {}
        for begin, each in (("", self), ("raw_", self.raw)):
            named = {f"{begin}{name}": getattr(each, name, None) for name in _IN_FILES}
            arrays |= {name: values for name, values in named.items() if values is not None}
        arrays |= {"status": self.status, "source": self.source}
        if suffix == ".npz":
            with whole_file(path) as file:
                np.savez(file, **arrays, unit=np.array(self.unit))  # type: ignore[arg-type]
        elif suffix == ".csv":
            lengths = {f"{begin}{name}": self.unit for begin in ("", "raw_") for name in _LENGTHS}
            columns = dict(node_columns(arrays, lengths))
            write_csv(
                path, columns, zip(*(each.tolist() for each in columns.values()), strict=True)
            )
        elif suffix == ".vtp":
            comment = f"<!-- lengths in {self.unit} -->\n"
            write_bytes(path, surface(self.position, self.displacement, arrays, comment=comment))
        else:
            raise ConfigError(f"{str(path)!r}: the suffix must be one of .npz, .csv, .vtp")

    def as_pytac3d(
        self, *, serial: str = "", index: int = 0, time_s: float = math.nan
    ) -> dict[str, Any]:
        """Return a frame as the dictionary that PyTac3D gives, for code written for it.

        serial: the name of the sensor. index: number of the frame. time_s: its time, s, for both
        time stamps.

        The keys are SN, index, sendTimestamp and recvTimestamp, and 3D_Positions (now),
        3D_Displacements and 3D_Normals, (R C, 3) float64, mm and unit vectors, row by row, NaN
        where missing. The axes are those of the left camera, and normals point to the cameras.
        There are no forces: a displacement alone does not give them.

        Raises FieldError if the field is not in space, or not in m, cm, mm or um.
        """
        return frame_of_pytac3d(
            self.position, self.displacement, self.unit, serial=serial, index=index, time_s=time_s
        )

    def strains(self) -> dict[str, Array]:
        """Return the strain, the principal strains, their direction and sigmas by name; empty
        without a strain."""
        named = {name: getattr(self, name) for name in _STRAIN}
        return {name: values for name, values in named.items() if values is not None}


def frame_of_pytac3d(
    position: Array, displacement: Array, unit: str, *, serial: str, index: int, time_s: float
) -> dict[str, Any]:
    """Return a frame as `DisplacementField.as_pytac3d` does.

    position: at rest, and displacement, (R, C, 3), NaN where missing, in `unit`.
    """
    if position.shape[2] != 3 or unit not in _MILLIMETRES:
        raise FieldError(
            f"PyTac3D's frames are in space, in mm: this field has {position.shape[2]} "
            f"coordinates in {unit}; measure two views with a rig in {', '.join(_MILLIMETRES)}"
        )
    now, size = position + displacement, _MILLIMETRES[unit]
    return {
        "SN": serial,
        "index": index,
        "sendTimestamp": time_s,
        "recvTimestamp": time_s,
        "3D_Positions": size * now.reshape(-1, 3),
        "3D_Displacements": size * displacement.reshape(-1, 3),
        "3D_Normals": surface_normals(now).reshape(-1, 3),
    }
