"""What is drawn of a series: the quantities of a frame, and the curves of all frames."""

import dataclasses
import enum
import functools
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field import DisplacementField, green_lagrange
from cmp_cl.field.strain import principal_of
from cmp_cl.points import of_cells

Array = NDArray[np.float64]

# arrays of a series
NEEDED = "index", "time_ms", "rest", "displacement", "sigma", "unit", "ambiguous", "misfit"
_NARROWEST = 1e-5  # area of a mean cell over the squares of its sides; a narrower one is a line


class Quantity(enum.Enum):
    """The quantity of a node that a map shows.

    DISPLACEMENT: its length, with some arrows. STRAIN: both principal Green-Lagrange strains in the
    plane or in the surface, %. HEIGHT: the displacement towards the cameras, out of the plane of
    the rest positions; two views only. SIGMA: the standard deviation of the displacement.
    """

    DISPLACEMENT = "displacement"
    STRAIN = "strain"
    HEIGHT = "height"
    SIGMA = "sigma"


class Map(NamedTuple):
    """The values (R, C) of a map, its title, its unit, and whether they have a sign."""

    title: str
    values: Array
    unit: str
    signed: bool = False

    @property
    def cells(self) -> Array:
        """Return the value of each cell, (R - 1, C - 1)."""
        return of_cells(self.values)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Moment:
    """What is drawn of one frame.

    rest: (R, C, 2) or (R, C, 3) in `unit`. shift: the displacement, of the same shape. sigma:
    (R, C), NaN where unknown. index, time_ms: the number and the time of the frame. doubtful:
    whether all of it may be wrong, `ambiguous` or `misfit` of `measure.Measured`.
    """

    rest: Array
    shift: NDArray[Any]
    sigma: NDArray[Any]
    unit: str
    index: int
    time_ms: float
    doubtful: bool = False

    @classmethod
    def of(
        cls,
        field: DisplacementField,
        index: int = 0,
        time_ms: float = math.nan,
        *,
        doubtful: bool = False,
    ) -> "Moment":
        """Return what is drawn of a field."""
        return cls(
            rest=field.position,
            shift=field.displacement,
            sigma=field.sigma,
            unit=field.unit,
            index=index,
            time_ms=time_ms,
            doubtful=doubtful,
        )

    @functools.cached_property
    def moved(self) -> Array:
        """Return how far each node has moved, (R, C)."""
        return np.asarray(np.linalg.norm(self.shift, axis=2))

    @property
    def in_space(self) -> bool:
        """Return whether it is of two views."""
        return bool(self.rest.shape[2] == 3)

    def plane(self) -> tuple[Array, Array]:
        """Return the positions at rest (R, C, 2) to draw on, and (3, 3) axes of that plane.

        Raises FieldError if fewer than three nodes are valid, or in space all lie on a line.
        """
        if not self.in_space:
            _check_nodes(self.rest)
            return self.rest, np.eye(3)
        axes, origin = plane_of(self.rest)
        return ((self.rest - origin) @ axes.T)[..., :2], axes

    def quantities(self) -> list[Quantity]:
        """Return the quantities that the frame has."""
        found = [Quantity.DISPLACEMENT]
        found += [Quantity.HEIGHT] if self.in_space else []
        found += [Quantity.SIGMA] if np.isfinite(self.sigma).any() else []
        return [*found, Quantity.STRAIN]

    def maps(self, quantity: Quantity) -> list[Map]:
        """Return the maps of a quantity; raises FieldError for another type, or the height of one
        view."""
        check_kind("quantity", quantity, Quantity, FieldError)
        if quantity is Quantity.DISPLACEMENT:
            return [Map("displacement", self.moved, self.unit)]
        if quantity is Quantity.SIGMA:
            return [Map("standard deviation", self.sigma, self.unit)]
        if quantity is Quantity.STRAIN:
            rest = np.where(np.isnan(self.shift), np.nan, self.rest)
            strain = green_lagrange(rest, rest + self.shift)
            principal = principal_of(strain, np.zeros((*strain.shape, 3)))[0]
            larger, smaller = np.moveaxis(principal, 2, 0)
            return [
                Map("larger principal strain", 100 * larger, "%", signed=True),
                Map("smaller principal strain", 100 * smaller, "%", signed=True),
            ]
        if not self.in_space:
            raise FieldError("one view shows no height: record two views, with --stereo")
        return [Map("height", self.shift @ self.plane()[1][2], self.unit, signed=True)]


class Summary:
    """What the sheet of a series shows: its frame of the largest displacement, and two curves.

    moment: that frame, None before the first one; top: that displacement. Doubtful frames are it
    only if there are no others. curves: of each frame its number, its time, ms, and the largest and
    the median displacement of its nodes, NaN without any. doubtful: for each, whether it is.
    """

    def __init__(self, moments: Iterable[Moment] = ()) -> None:
        self.moment: Moment | None = None
        self.top = 0.0
        self.curves: list[tuple[int, float, float, float]] = []
        self.doubtful: list[bool] = []
        self._best: tuple[bool, bool, float] = False, False, 0.0
        for moment in moments:
            self.add(moment)

    def add(self, moment: Moment) -> None:
        """Add a frame."""
        known = moment.moved[~np.isnan(moment.moved)]
        largest, median = (known.max(), np.median(known)) if len(known) else (math.nan, math.nan)
        seen = len(known) > 0
        top = float(largest) if seen else 0.0
        best = seen, not moment.doubtful, top
        if self.moment is None or best > self._best:
            self.moment, self.top, self._best = moment, top, best
        self.doubtful.append(moment.doubtful and seen)
        self.curves.append((moment.index, moment.time_ms, float(largest), float(median)))


def moments_of(series: Mapping[str, NDArray[Any]]) -> list[Moment]:
    """Return the frames of a series, from its arrays as `cmp_cl.series.read_series` checks them.

    Raises FieldError without a frame, or without positions at rest and displacements.
    """
    if not len(series.get("index", ())):
        raise FieldError("the series has no frame")
    missing = [name for name in NEEDED[:4] if name not in series]
    if missing:
        raise FieldError(f"the series has no {' and no '.join(missing)}")
    rest, shift = np.asarray(series["rest"], np.float64), series["displacement"]
    sigma = series.get("sigma", np.broadcast_to(np.nan, shift.shape[:3]))
    unit = str(series.get("unit", "px"))
    doubtful = np.zeros(len(shift), np.bool_)
    for name in ("ambiguous", "misfit"):
        doubtful |= series.get(name, False)
    return [
        Moment(
            rest=rest, shift=shift[n], sigma=sigma[n], unit=unit, index=int(index),
            time_ms=float(series["time_ms"][n]), doubtful=bool(doubtful[n]),
        )
        for n, index in enumerate(series["index"])
    ]  # fmt: skip


def plane_of(rest: Array) -> tuple[Array, Array]:
    """Fit a plane to positions (R, C, 3), NaN where missing: (3, 3) axes as rows, (3,) origin.

    They are fitted by a linear function of row and column. The first axis runs along the rows, the
    second along the columns, the third towards the cameras (a left-handed frame, as on a picture
    with y down and height towards the viewer).

    Raises FieldError if fewer than three nodes are valid, or all lie on a line.
    """
    row, column = _check_nodes(rest)
    points = rest[row, column]
    origin = points.mean(axis=0)
    indices = np.column_stack([column - column.mean(), row - row.mean()])
    along, down = np.linalg.lstsq(indices, points - origin, rcond=None)[0]
    normal = np.cross(down, along)
    area = np.linalg.norm(normal)
    if not area > _NARROWEST * (along @ along + down @ down):
        raise FieldError("all valid nodes lie on a line: they make no surface")
    normal *= -np.copysign(1 / area, normal @ origin)
    along /= np.linalg.norm(along)
    across = np.cross(normal, along)
    return np.stack([along, np.copysign(1, across @ down) * across, normal]), origin


def _check_nodes(rest: Array) -> tuple[NDArray[np.int64], ...]:
    """Return rows and columns of the valid nodes; raises FieldError for fewer than three."""
    found = np.nonzero(~np.isnan(rest[..., 0]))
    if len(found[0]) < 3:
        raise FieldError(f"{len(found[0])} nodes are valid, at least 3 are needed to draw them")
    return found
