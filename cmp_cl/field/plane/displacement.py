"""Displacement in the plane, from one view.

A view at rest and a view now give two grids of the same nodes. `plane_displacement` returns the
displacement of each node, in px or in a length, with its standard deviation.
"""

import dataclasses
import math
from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import FieldError, as_numbers, check_kind, check_positive
from cmp_cl.grid.filter import (
    Filtered,
    bend_shift_of,
    filter_at_rest,
    filter_grid,
    image_sigma,
    noise_of_change,
)
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class PlaneScale:
    """The homography from the image to the plane of the pattern.

    matrix: (3, 3), from (x, y, 1), px, to the plane. unit: name of the unit of length there.

    Raises FieldError if the matrix is not finite or has no inverse.
    """

    matrix: Array
    unit: str

    def __post_init__(self) -> None:
        check_kind("unit", self.unit, str, FieldError)
        matrix = as_numbers("matrix", self.matrix, FieldError)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not np.linalg.det(matrix):
            raise FieldError(f"a homography is (3, 3), finite and regular, not {matrix.tolist()}")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def pixels(cls) -> Self:
        """Return the image itself as the plane, in px."""
        return cls(np.eye(3), "px")

    @classmethod
    def of_pixel(cls, length: float, unit: str = "mm") -> Self:
        """Return the scale of a camera that faces the plane, so that a px has the same length
            everywhere.

        length: of one px. unit: name of its unit. Raises FieldError if it is not positive.
        """
        check_positive("length", length, FieldError)
        return cls(np.diag([length, length, 1.0]), unit)

    @classmethod
    def of_cells(cls, rest: Grid, side: float, unit: str = "mm") -> Self:
        """Return the homography that maps the cells of a flat pattern to squares of that side.

        rest: the grid at rest. side: side of a cell. unit: name of its unit. The homography fits
            all nodes by least squares. x runs along the rows of the pattern, y along its columns.
            Raises FieldError if side is not positive, if fewer than 4 nodes are valid, or if all
            lie on a line.
        """
        check_kind("rest", rest, Grid, FieldError)
        check_positive("side", side, FieldError)
        row, column = np.nonzero(rest.valid)
        matrix = None
        if len(row) >= 4 and len(set(row)) > 1 and len(set(column)) > 1:
            nodes = np.column_stack([column, row]) * float(side)
            matrix, _ = cv2.findHomography(rest.xy[rest.valid].astype(np.float64), nodes)
        if matrix is None:
            raise FieldError(
                f"{len(row)} nodes at rest do not fix the plane: at least 4 are needed, in two "
                "rows and two columns"
            )
        return cls(np.asarray(matrix, np.float64), unit)

    def __call__(self, xy: ArrayLike) -> tuple[Array, Array]:
        """Map points (..., 2), px, to the plane; also return the derivative by px, (..., 2, 2)."""
        points = as_numbers("xy", xy, FieldError)
        if not points.ndim or points.shape[-1] != 2:
            raise FieldError(f"xy must be (..., 2), not {points.shape}")
        mapped = points @ self.matrix[:, :2].T + self.matrix[:, 2]
        plane = mapped[..., :2] / mapped[..., 2:]
        slope = self.matrix[:2, :2] - plane[..., None] * self.matrix[2, :2]
        return plane, slope / mapped[..., 2, None, None]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlaneField:
    """The position of each node at rest in the plane, and its displacement.

    position: (R, C, 2) float64, at rest, in `unit`; NaN unless the node is valid.
    displacement: (R, C, 2) float64, in `unit`, NaN unless the node is valid.
    sigma, sigma_position: (R, C) float64, standard deviation per axis of the displacement and of
        the position, in `unit`; NaN where unknown. That of the position includes wear.
    status: (R, C) uint8 of `NodeStatus`: of those at rest and now, the less direct one.
    unit: name of the unit of length.
    raw: the field before the lattice filter; None if this one is not filtered.
    filtered: the filter's results for the position and the displacement; None if this field
        is not filtered.
    shared: (2, 2, 2, 2) float64, in `unit` squared: the covariances of x and y, for the errors at
        rest and now, between a node and the next one in its row, and in its column. The
        displacement has the sum of both moments. None if unknown, and for a filtered field, whose
        raw field has it.
    """

    position: Array
    displacement: Array
    sigma: Array
    sigma_position: Array
    status: NDArray[np.uint8]
    unit: str
    raw: "PlaneField | None" = None
    filtered: tuple[Filtered, Filtered] | None = None
    shared: Array | None = None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a displacement."""
        return ~np.isnan(self.displacement[..., 0])

    @property
    def now(self) -> Array:
        """Return the positions of the nodes now, (R, C, 2) float64, in `unit`."""
        moved: Array = self.position + self.displacement
        return moved


def plane_displacement(
    rest: Grid, now: Grid, scale: PlaneScale | None = None, *, raw: bool = False
) -> PlaneField:
    """Return the displacement of each node in the plane, now - rest, by its number.

    rest, now: the grids. scale: from the image to the plane; None means px. raw: leave out the
        filter.

    The displacement and the position at rest are filtered over the lattice, see
    `cmp_cl.grid.filter_grid`, and the shift by bent edges is subtracted. The errors are estimated
    from the lattice; if it is too small, they are those of the corners. The part that neighbours
    share is in `raw.shared`, see `with_measured_noise`. The field has the rows and columns of the
    grid at rest; nodes beyond them have no displacement.

    Raises FieldError if an argument is of another type, or if now does not have all rows and
    columns of the grid at rest.
    """
    check_kind("rest", rest, Grid, FieldError)
    check_kind("now", now, Grid, FieldError)
    if not now.covers(rest):
        raise FieldError(f"rest has {rest.extent}, now has {now.extent}")
    now = now.cut_to(rest)
    scale = PlaneScale.pixels() if scale is None else scale
    check_kind("scale", scale, PlaneScale, FieldError)
    both = rest.valid & now.valid
    seen_at_rest = np.isin(rest.status, MEASURED)
    (before, slope_before), (after, slope_after) = scale(rest.xy), scale(now.xy)

    def deviation(grid: Grid, slope: Array) -> Array:
        per_axis = np.sqrt(np.square(slope).sum(axis=(-2, -1)) / 2)
        own = image_sigma(grid)
        return np.where(both & (own > 0), own * per_axis, np.nan)

    missing = np.uint8(NodeStatus.MISSING)
    position = np.where(both[..., None], before, np.nan)
    moved = np.where(both[..., None], after - before, np.nan)
    at_rest = filter_at_rest(before, measured=seen_at_rest)
    own_rest, own_now = deviation(rest, slope_before), deviation(now, slope_after)
    change = filter_grid(
        moved,
        measured=both & seen_at_rest & np.isin(now.status, MEASURED),
        bends=True,
        most_noise=noise_of_change(at_rest, own_rest, own_now),
    )
    unfiltered = PlaneField(
        position=position,
        displacement=moved,
        sigma=_either(change.noise, np.hypot(own_rest, own_now)),
        sigma_position=np.where(both, _either(at_rest.noise, own_rest), np.nan),
        status=np.where(both, np.maximum(rest.status, now.status), missing).astype(np.uint8),
        unit=scale.unit,
    )
    shown = _shown_by_neighbours(unfiltered)
    known = np.isfinite(unfiltered.sigma)
    if shown is not None and known.any():
        shared = shown[1]
        larger = math.sqrt(_unseen(shared))
        sigma = larger * unfiltered.sigma
        unfiltered = dataclasses.replace(
            unfiltered,
            sigma=sigma,
            sigma_position=larger * unfiltered.sigma_position,
            shared=np.square(sigma[known]).mean() * shared,
        )
    if raw:
        return unfiltered
    bent_rest, bent_now = (
        (slope @ bend_shift_of(grid)[..., None])[..., 0]
        for grid, slope in ((rest, slope_before), (now, slope_after))
    )
    return dataclasses.replace(
        unfiltered,
        position=np.where(both[..., None], at_rest.values - bent_rest, np.nan),
        displacement=change.values - (bent_now - bent_rest),
        sigma=_either(change.sigma, np.hypot(own_rest, own_now)),
        sigma_position=np.where(both, _either(at_rest.sigma, own_rest), np.nan),
        shared=None,
        raw=unfiltered,
        filtered=(at_rest, change),
    )


def _either(lattice: Array, corners: Array) -> Array:
    """Return the standard deviation from the lattice, or that of the corners where it has none."""
    return np.where(np.isfinite(lattice), lattice, corners)


def with_measured_noise(field: PlaneField) -> PlaneField:
    """Return the raw field with one standard deviation for all nodes, estimated from its roughness.

    Neighbours share the edge between them, and so a part of their errors across it. That part is
    estimated too, and `plane_strain` uses it. For errors of variance v, of which neighbours share a
    part p, second differences by row of second differences by column have the variance (36 - 48 p)
    v, and the covariance (42 p - 24) v with those across the edge to the next node (after J.
    Immerkaer, CVIU 64, 1996, for p = 0). Half of v is attributed to each moment. The estimate does
    not include errors that vary slowly over four nodes, or that are the same at rest and now. It
    takes a bend of the field within four nodes for noise.

    Raises FieldError if no 4 x 4 nodes are valid.
    """
    check_kind("field", field, PlaneField, FieldError)
    field = field if field.raw is None else field.raw
    shown = _shown_by_neighbours(field)
    if shown is None:
        raise FieldError("no 4 x 4 nodes are valid: they show no noise")
    variance, shared = shown
    even = np.where(field.valid, math.sqrt(variance), np.nan)
    return dataclasses.replace(
        field,
        sigma=even,
        sigma_position=even / math.sqrt(2),
        shared=variance * shared,
    )


def _shown_by_neighbours(field: PlaneField) -> tuple[float, Array] | None:
    """Return the variance of the errors from the roughness of a raw field, and the part that
    neighbours share; None without 4 x 4 valid nodes.

    The part is (2, 2, 2, 2) like `PlaneField.shared`, for a variance of 1.
    """
    rough = np.diff(np.diff(field.displacement, 2, axis=0), 2, axis=1)
    if np.isnan(rough).all():
        return None
    by_moment = np.stack([_across(moment) for moment in (field.position, field.now)]) / 2
    across = by_moment.sum(axis=0)
    products = np.concatenate(
        [
            np.einsum("rci,ij,rcj->rc", one, normal, two).ravel()
            for normal, one, two in (
                (across[0], rough[:, 1:], rough[:, :-1]),
                (across[1], rough[1:], rough[:-1]),
            )
        ]
    )
    products = products[~np.isnan(products)]
    if not len(products):
        return None
    size = float(np.nanmean(np.square(rough)))
    own, other = np.square(across).sum() / 2, (across[0] * across[1]).sum()
    gain = float(42 * own + 32 * other)  # 42 if rows and columns are perpendicular
    ratio = products.mean() / size if size > 0 else -1.0
    part = np.clip((24 + 36 * ratio) / max(gain + 48 * ratio, 1.0), 0, 0.5)
    return size / (36 - 48 * part), part * by_moment


def _unseen(shared: Array) -> float:
    """Return the variance of the errors over the one that the lattice filter estimates.

    shared: as `_shown_by_neighbours` returns it. The filter assumes independent errors. The
    residual of its pilot, (5, -30, 75, 131, 75, -30, 5) / 231 along both axes, then has the
    variance 0.678 v. If neighbours share a part p across their edge, it has 0.678 v - 0.421 p v.
    """
    part = float(np.einsum("mnii->", shared)) / 2
    return 1 / (1 - 0.421 / 0.678 * part)


def _across(points: Array) -> Array:
    """Return the projections (2, 2, 2) on the directions across the rows and across the columns."""
    steps = [np.nanmean(np.diff(points, axis=axis).reshape(-1, 2), axis=0) for axis in (1, 0)]
    normals = [np.array([-y, x]) / math.hypot(x, y) for x, y in steps]
    return np.stack([np.outer(normal, normal) for normal in normals])
