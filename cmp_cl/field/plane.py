"""Displacement and strain in the plane, from one view: on the nodes, and on a raster.

A view at rest and a view now give two grids of the same nodes. `plane_displacement` is the
displacement of each node, in px or in a length. `Motion` is its part that is one translation,
rotation and zoom of everything. `plane_strain` is the part that changes lengths. Each has its
standard deviation, to first order in those of the positions.
"""

import dataclasses
import math
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field.strain import slope_weights
from cmp_cl.grid.filter import Filtered, filter_grid
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus

Array = NDArray[np.float64]

_UNIFORM = math.pi / math.sqrt(12)  # rad, standard deviation of an unknown direction
_DISTINCT = 3.0  # standard deviations: noise alone exceeds them in 1 % (Rayleigh)
_LEAST_NODES = 6  # of a window that a plane is fitted to
_BLOCK = 1 << 20  # points of a raster that are interpolated at a time
_STEPS = 20  # Newton steps that find a raster point in its cell
_CONVERGED = 1e-4  # cells, the last of the steps
_REACH = 1.0  # cells from a cell's middle; a point further away is in another cell
_OUTSIDE = 1e-6  # cells, rounding at their common sides


@dataclasses.dataclass(frozen=True, eq=False)
class PlaneScale:
    """The homography from the image to the plane of the pattern.

    matrix: (3, 3), from (x, y, 1), px, to the plane. unit: name of the unit of length there.

    Raises FieldError where the matrix is not finite or has no inverse.
    """

    matrix: Array
    unit: str

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, np.float64)
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
        """Return the plane of a camera that faces it: one px has the same length everywhere."""
        if not 0 < length < math.inf:
            raise FieldError(f"the length of a px must be positive, not {length!r}")
        return cls(np.diag([length, length, 1.0]), unit)

    @classmethod
    def of_cells(cls, rest: Grid, side: float, unit: str = "mm") -> Self:
        """Return the homography that maps the cells of a flat pattern to squares of that side.

        The homography fits all nodes by least squares. x runs along the rows of the pattern, y
        along its columns. Raises FieldError where fewer than 4 nodes are there, or all on a line.
        """
        if not 0 < side < math.inf:
            raise FieldError(f"the side of a cell must be positive, not {side!r}")
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
        points = np.asarray(xy, np.float64)
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
        the position, in `unit`; NaN where unknown. Wear of the print counts in the position.
    status: (R, C) uint8 of `NodeStatus`, the less direct one of the two moments.
    unit: name of the unit of length.
    raw: the field as it was measured, where this one has been through the lattice filter; None
        where this one is raw.
    filtered: what the filter says of the position and of the displacement; None where this field
        is raw.
    shared: (2, 2, 2, 2) float64, covariances of x and y, in `unit` squared, of the errors at rest
        and now: of a node with the next one of its row, and of its column. The displacement has
        their sum. None where nothing is known of it.
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
        """Return (R, C, 2) float64: where the nodes are now, in `unit`."""
        moved: Array = self.position + self.displacement
        return moved


def plane_displacement(
    rest: Grid, now: Grid, scale: PlaneScale | None = None, *, raw: bool = False
) -> PlaneField:
    """Return the displacement of each node in the plane, now - rest, by its number.

    The difference goes through the lattice filter, and so does the position at rest: see
    `cmp_cl.grid.filter_grid`. scale: from the image to the plane; None means px. raw: leave the
    filter out. The errors are those that the lattice shows, and those of the corners where it is
    too small to tell. The field has the rows and columns of the grid at rest: a node beyond them
    has no displacement.

    Raises FieldError where now has not all rows and columns of the grid at rest.
    """
    if not now.covers(rest):
        raise FieldError(f"rest has {rest.extent}, now has {now.extent}")
    now = now.cut_to(rest)
    scale = PlaneScale.pixels() if scale is None else scale
    both = rest.valid & now.valid
    measured = both & np.isin(rest.status, MEASURED) & np.isin(now.status, MEASURED)
    (before, slope_before), (after, slope_after) = scale(rest.xy), scale(now.xy)

    def deviation(grid: Grid, slope: Array) -> Array:
        per_axis = np.sqrt(np.square(slope).sum(axis=(-2, -1)) / 2)
        return np.where(both & (grid.sigma > 0), grid.sigma * per_axis, np.nan)

    missing = np.uint8(NodeStatus.MISSING)
    position = np.where(both[..., None], before, np.nan)
    moved = np.where(both[..., None], after - before, np.nan)
    at_rest = filter_grid(position, measured=measured)
    change = filter_grid(moved, measured=measured, bends=True)
    own_rest, own_now = deviation(rest, slope_before), deviation(now, slope_after)
    unfiltered = PlaneField(
        position=position,
        displacement=moved,
        sigma=_either(change.noise, np.hypot(own_rest, own_now)),
        sigma_position=_either(at_rest.noise, own_rest),
        status=np.where(both, np.maximum(rest.status, now.status), missing).astype(np.uint8),
        unit=scale.unit,
    )
    if raw:
        return unfiltered
    return dataclasses.replace(
        unfiltered,
        position=at_rest.values,
        displacement=change.values,
        sigma=_either(change.sigma, np.hypot(own_rest, own_now)),
        sigma_position=_either(at_rest.sigma, own_rest),
        raw=unfiltered,
        filtered=(at_rest, change),
    )


def _either(lattice: Array, corners: Array) -> Array:
    """Return the standard deviation that the lattice shows, or that of the corners."""
    return np.where(np.isfinite(lattice), lattice, corners)


def with_measured_noise(field: PlaneField) -> PlaneField:
    """Return the raw field with one standard deviation for all nodes, from its own roughness.

    Neighbours share the edge between them, and so part of their errors across it: how much is
    estimated too, and `plane_strain` counts it. For errors of variance v, of which neighbours share
    a part p, second differences by row of second differences by column have the variance (36 - 48
    p) v, and the covariance (42 p - 24) v with those across the edge to the next node (after J.
    Immerkaer, CVIU 64, 1996, for p = 0). Each moment gets half of v. Errors that vary slowly over
    four nodes, or are the same at rest and now, are not seen. A field that bends within four nodes
    counts as noise.

    Raises FieldError where no 4 x 4 nodes are valid.
    """
    field = field if field.raw is None else field.raw
    rough = np.diff(np.diff(field.displacement, 2, axis=0), 2, axis=1)
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
        raise FieldError("no 4 x 4 nodes are valid: they show no noise")
    size = float(np.nanmean(np.square(rough)))
    own, other = np.square(across).sum() / 2, (across[0] * across[1]).sum()
    gain = float(42 * own + 32 * other)  # 42 where rows and columns are square to each other
    ratio = products.mean() / size if size > 0 else -1.0
    part = np.clip((24 + 36 * ratio) / max(gain + 48 * ratio, 1.0), 0, 0.5)
    variance = size / (36 - 48 * part)
    even = np.where(field.valid, math.sqrt(variance), np.nan)
    return dataclasses.replace(
        field,
        sigma=even,
        sigma_position=even / math.sqrt(2),
        shared=part * variance * by_moment,
    )


def _across(points: Array) -> Array:
    """Return the projections (2, 2, 2) on the directions across the rows and across the columns."""
    steps = [np.nanmean(np.diff(points, axis=axis).reshape(-1, 2), axis=0) for axis in (1, 0)]
    normals = [np.array([-y, x]) / math.hypot(x, y) for x, y in steps]
    return np.stack([np.outer(normal, normal) for normal in normals])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """One motion of the whole pattern: now = centre + translation + zoom R (rest - centre).

    centre: (x, y), the mean of the nodes at rest. translation: (x, y) of the centre, in `unit`.
    rotation: rad, from x towards y. zoom: factor. sigma_translation, sigma_rotation,
    sigma_zoom: standard deviations by the errors of the positions alone; NaN where unknown.
    """

    centre: tuple[float, float]
    translation: tuple[float, float]
    rotation: float
    zoom: float
    sigma_translation: float
    sigma_rotation: float
    sigma_zoom: float
    unit: str


def motion_of(field: PlaneField, *, zoom: bool = True) -> Motion:
    """Return the translation, rotation and zoom that fit all nodes best by least squares.

    zoom: whether lengths may change; False fits a rigid motion, with a zoom of 1.

    Raises FieldError where fewer than two nodes are valid.
    """
    valid = field.valid
    if np.count_nonzero(valid) < 2:
        raise FieldError("a motion needs at least two valid nodes")
    before, after = _complex(field.position[valid]), _complex(field.now[valid])
    centre, goal = before.mean(), after.mean()
    spread = np.square(np.abs(before - centre)).sum()
    if not spread > 0:
        raise FieldError("all nodes lie at one point: they show no rotation")
    factor = (np.conj(before - centre) * (after - goal)).sum() / spread
    scale = abs(factor) if zoom else 1.0
    own = field if field.raw is None else field.raw  # whose errors neighbours do not share
    variance = np.square(own.sigma[valid])
    variance += np.square(abs(factor - 1) * own.sigma_position[valid])
    turning = math.sqrt((np.square(np.abs(before - centre)) * variance).sum()) / spread
    return Motion(
        centre=(float(centre.real), float(centre.imag)),
        translation=(float((goal - centre).real), float((goal - centre).imag)),
        rotation=float(np.angle(factor)),
        zoom=float(scale),
        sigma_translation=math.sqrt(variance.sum()) / len(before),
        sigma_rotation=turning / abs(factor),
        sigma_zoom=turning if zoom else 0.0,
        unit=field.unit,
    )


def without_motion(field: PlaneField, motion: Motion) -> PlaneField:
    """Remove a motion from the field, so that the deformation alone remains.

    The nodes now are moved back. `sigma` does not include the error of the motion.
    """
    centre, goal = complex(*motion.centre), complex(*motion.centre) + complex(*motion.translation)
    factor = motion.zoom * np.exp(1j * motion.rotation)
    back = (_complex(field.now) - goal) / factor + centre
    moved = np.stack([back.real, back.imag], axis=-1) - field.position
    return dataclasses.replace(
        field,
        displacement=moved,
        sigma=field.sigma / abs(motion.zoom),
        shared=None if field.shared is None else _moved_back(field.shared, motion),
        raw=None if field.raw is None else without_motion(field.raw, motion),
    )


def _moved_back(shared: Array, motion: Motion) -> Array:
    cosine, sine = math.cos(motion.rotation), math.sin(motion.rotation)
    back = np.array([[cosine, sine], [-sine, cosine]]) / motion.zoom
    return np.stack([shared[0], back @ shared[1] @ back.T])


def _complex(points: Array) -> NDArray[np.complex128]:
    numbers: NDArray[np.complex128] = points[..., 0] + 1j * points[..., 1]
    return numbers


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlaneStrain:
    """Green-Lagrange strain in the plane.

    tensor: (R, C, 3) float64, Exx, Eyy, Exy (half the engineering shear), along the axes of
        the field; NaN where too few neighbours are valid.
    covariance: (R, C, 3, 3) float64, of these three, from the errors of the positions alone; NaN
        where unknown. A strain that varies within the window is also smoothed, which is not
        included.
    """

    tensor: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Return (R, C, 3) float64: the standard deviations of the tensor's entries."""
        deviation: Array = np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1))
        return deviation

    def principal(self) -> "PrincipalStrain":
        """Return the largest and the smallest strain, and the direction of the largest one."""
        xx, yy, xy = np.moveaxis(self.tensor, -1, 0)
        mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        direction = np.arctan2(xy, (xx - yy) / 2) / 2
        cosine, sine = np.cos(direction), np.sin(direction)
        # Derivatives of v1'Ev1, v2'Ev2 and v1'Ev2 by Exx, Eyy and Exy.
        along = np.stack([cosine**2, sine**2, 2 * sine * cosine], axis=-1)
        across = np.stack([sine**2, cosine**2, -2 * sine * cosine], axis=-1)
        turning = np.stack([-sine * cosine, sine * cosine, cosine**2 - sine**2], axis=-1)
        first, second, mixed = (
            np.sqrt(np.einsum("...i,...ij,...j", row, self.covariance, row))
            for row in (along, across, turning)
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.where(half > _DISTINCT * mixed, mixed / (2 * half), _UNIFORM)
        return PrincipalStrain(
            strain=np.stack([mean + half, mean - half], axis=-1),
            sigma=np.stack([first, second], axis=-1),
            direction=direction,
            sigma_direction=np.where(np.isnan(mixed), np.nan, spread),
        )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PrincipalStrain:
    """Principal strains of a plane.

    strain: (R, C, 2) float64, the larger and the smaller one; sigma: (R, C, 2) of them. Where the
        two differ by less than their sigma, the difference may be noise alone.
    direction: (R, C) float64 in [-pi/2, pi/2], rad, of the larger one, from x towards y.
    sigma_direction: (R, C), rad; pi / sqrt(12), that of an unknown direction, where half the
        difference of the strains is below 3 of its standard deviations.
    """

    strain: Array
    sigma: Array
    direction: Array
    sigma_direction: Array


def plane_strain(field: PlaneField, *, radius: int = 2) -> PlaneStrain:
    """Return the Green-Lagrange strain E = (F'F - 1) / 2 of every node, with its covariance.

    Around each node a plane in (column, row) is fitted to the positions at rest and now by least
    squares, over the (2 radius + 1)^2 nodes, which gives the gradient F of the positions now with
    respect to those at rest. Nodes without a sigma are used only where no node has one. Wear of the
    print is taken to keep its size; where it stretches with the material, large strains are more
    certain than their sigma says.

    Returns NaN where the node is missing, or fewer than 6 of its window are there, or all of
    these on a line. Raises ConfigError where radius is not a whole number from 1 to 50.
    """
    if type(radius) is not int or not 1 <= radius <= 50:
        raise ConfigError(f"radius must be a whole number from 1 to 50, not {radius!r}")
    valid = field.valid
    known = valid & np.isfinite(field.sigma)
    used = known if known.any() else valid
    slopes, errors = _local_planes(
        np.concatenate([field.position, field.now], axis=2),
        np.stack([field.sigma_position, field.sigma], axis=-1),
        used,
        radius,
    )
    if field.filtered is not None:
        errors = _shared_errors(field, used, radius)
    errors = np.eye(2)[:, :, None, None] * errors[:, :, :, None, None]
    if field.shared is not None:
        at_rest, now = field.shared
        errors += _of_neighbours(np.stack([at_rest, at_rest + now]), used, radius)
    before, after = slopes[..., :2], slopes[..., 2:]
    size = np.square(before).sum(axis=(-2, -1))
    area = before[..., 0, 0] * before[..., 1, 1] - before[..., 0, 1] * before[..., 1, 0]
    good = valid & (np.abs(area) > 1e-9 * size)
    tensor, covariance = np.full((*valid.shape, 3), np.nan), np.full((*valid.shape, 3, 3), np.nan)
    back = np.linalg.inv(before[good])
    gradient = (back @ after[good]).transpose(0, 2, 1)
    green = (gradient.transpose(0, 2, 1) @ gradient - np.eye(2)) / 2
    tensor[good] = np.stack([green[:, 0, 0], green[:, 1, 1], green[:, 0, 1]], axis=-1)
    covariance[good] = _strain_covariance(gradient, back, errors[good])
    return PlaneStrain(tensor=tensor, covariance=covariance)


def _local_planes(
    values: Array, sigma: Array, used: NDArray[np.bool_], radius: int
) -> tuple[Array, Array]:
    """Fit the plane a + b column + c row to the values around each node.

    values: (R, C, K). sigma: (R, C, L), of values whose nodes share no error. Returns (R, C, 2, K)
    slopes by column and by row, and (R, C, L, 2, 2) covariances of such slopes; NaN where the
    plane is not determined.
    """
    rows, columns = used.shape
    pad = ((radius, radius), (radius, radius), (0, 0))
    filled = np.pad(np.where(used[..., None], values, 0), pad)
    weights = np.concatenate([used[..., None], np.where(used[..., None], sigma**2, 0)], axis=2)
    weights = np.pad(weights.astype(np.float64), pad)
    sums = np.zeros((rows, columns, 3, values.shape[2]))
    moments = np.zeros((rows, columns, weights.shape[2], 3, 3))
    for row in range(2 * radius + 1):
        for column in range(2 * radius + 1):
            at = slice(row, row + rows), slice(column, column + columns)
            basis = np.array([1.0, column - radius, row - radius])
            sums += basis[:, None] * filled[at][:, :, None]
            moments += np.outer(basis, basis) * weights[at][..., None, None]
    count = moments[:, :, 0]
    solvable = (count[..., 0, 0] >= _LEAST_NODES) & (np.linalg.det(count) > 1e-6)
    inverse = np.full(count.shape, np.nan)
    inverse[solvable] = np.linalg.inv(count[solvable])
    errors = (inverse[:, :, None] @ moments[:, :, 1:] @ inverse[:, :, None])[..., 1:, 1:]
    return (inverse @ sums)[..., 1:, :], errors


def _shared_errors(field: PlaneField, used: NDArray[np.bool_], radius: int) -> Array:
    """Return the covariances (R, C, 2, 2, 2) of the slopes of filtered values, position and
    displacement: neighbours share errors there.
    """
    errors = np.zeros((*used.shape, 2, 2, 2))
    stencils = slope_weights(used, radius)
    pairs = zip(field.filtered or (), (field.sigma_position, field.sigma), strict=True)
    for number, (filtered, sigma) in enumerate(pairs):
        with np.errstate(invalid="ignore", divide="ignore"):
            zoomed = np.square(sigma / filtered.sigma)  # where a motion has been taken away
        for axis, stencil in enumerate(stencils):
            variance = np.square(filtered.deviation_of(stencil)) * zoomed
            errors[:, :, number, axis, axis] = variance
    return errors


def _of_neighbours(shared: Array, used: NDArray[np.bool_], radius: int) -> Array:
    """Return what errors that neighbours share add to the covariances of the slopes: (R, C, M, 2,
    2, 2, 2), by value, two coordinates, and two axes. shared: (M, 2, 2, 2), of M values.
    """
    stencils = np.stack(slope_weights(used, radius), axis=2)
    added = np.zeros((*used.shape, len(shared), 2, 2, 2, 2))
    for covariance, one, two in (
        (shared[:, 0], stencils[..., 1:], stencils[..., :-1]),
        (shared[:, 1], stencils[..., 1:, :], stencils[..., :-1, :]),
    ):
        along = np.einsum("rcjde,rclde->rcjl", one, two, optimize=True)
        along += along.swapaxes(2, 3)
        added += covariance[:, :, :, None, None] * along[:, :, None, None, None]
    return added


def _strain_covariance(gradient: Array, back: Array, errors: Array) -> Array:
    """Return the covariance (N, 3, 3) of Exx, Eyy, Exy.

    gradient: (N, 2, 2) F. back: (N, 2, 2) columns and rows by the axes at rest. errors: (N, 2, 2,
    2, 2, 2), covariances of the slopes of the position and of the displacement, by two
    coordinates, and two of columns and rows.
    """
    # An error e of the position is one of now, too: it acts on F as (1 - F) e does.
    weights = np.einsum("nja,nmikab,nlb->nmijkl", back, errors, back, optimize=True)
    moved = gradient - np.eye(2)
    of_gradient = weights[:, 1] + np.einsum(
        "nia,najbl,nkb->nijkl", moved, weights[:, 0], moved, optimize=True
    )
    eye = np.eye(2)
    by_gradient = np.stack(
        [
            (np.einsum("ni,j->nij", gradient[:, :, a], eye[b]))
            + (np.einsum("ni,j->nij", gradient[:, :, b], eye[a]))
            for a, b in ((0, 0), (1, 1), (0, 1))
        ],
        axis=1,
    )
    covariance: Array = np.einsum(
        "naij,nijkl,nbkl->nab", by_gradient / 2, of_gradient, by_gradient / 2, optimize=True
    )
    return covariance


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Raster:
    """Values of the nodes, interpolated on a regular raster of the plane at rest.

    x: (W,), y: (H,) float64, coordinates of columns and rows, in `unit`. values: (H, W, K) float64,
    NaN outside the cells whose four nodes are valid. unit: unit of x and y.
    """

    x: Array
    y: Array
    values: Array
    unit: str

    @property
    def step(self) -> float:
        """Return the distance of neighbouring points, in `unit`."""
        return float(self.x[1] - self.x[0])


def rasterize(field: PlaneField, values: ArrayLike | None = None, *, step: float = 1.0) -> Raster:
    """Interpolate the nodes' values at the multiples of `step` that the cells at rest cover.

    values: (R, C) or (R, C, K) numbers, NaN where missing; None means the displacement. In px and
    at step 1 the points are the pixels. Values and positions at rest are interpolated between nodes
    by cubic convolution (R. G. Keys, IEEE Trans. ASSP 29, 1981), and continued past the border by
    quadratic extrapolation.

    Raises FieldError where no cell is valid or covers a point, ConfigError where step is not
    positive or asks for over 1e8 points.
    """
    numbers = field.displacement if values is None else np.asarray(values, np.float64)
    if numbers.ndim == 2:
        numbers = numbers[..., None]
    if numbers.ndim != 3 or numbers.shape[:2] != field.status.shape:
        raise FieldError(f"values are {numbers.shape}, the field has {field.status.shape} nodes")
    if not 0 < step < math.inf:
        raise ConfigError(f"step must be a positive length, not {step!r}")
    valid = field.valid & ~np.isnan(numbers).any(axis=2)
    cells = np.argwhere(valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:])
    if not len(cells):
        raise FieldError("no cell has four valid nodes: there is nothing to draw")
    low = np.ceil(field.position[valid].min(axis=0) / step).astype(int)
    high = np.floor(field.position[valid].max(axis=0) / step).astype(int)
    if (high < low).any():
        raise FieldError(f"no multiple of {step} {field.unit} lies within the nodes")
    width, height = (high - low + 1).tolist()
    if width * height > 1e8:
        raise ConfigError(f"step {step} {field.unit} asks for {width} x {height} points")
    padded = _continued(
        np.where(valid[..., None], np.concatenate([field.position, numbers], axis=2), np.nan)
    )
    drawn = np.full((height, width, numbers.shape[2]), np.nan)
    for cell, index, fraction in _covered(padded, cells, step, low):
        column, row = (index - low).T
        drawn[row, column] = _cubic(padded, cell, fraction)[:, 2:]
    x, y = np.arange(low[0], high[0] + 1) * step, np.arange(low[1], high[1] + 1) * step
    return Raster(x=x, y=y, values=drawn, unit=field.unit)


def _continued(values: Array) -> Array:
    """Extend values (R, C, K) by a ring around them, (R + 2, C + 2, K), and fill gaps.

    A missing value is the mean of the continuations along its row and column: quadratic, else
    linear, else constant. Two passes give every neighbour of a valid cell a value.
    """
    filled = np.pad(values, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    for _ in range(2):
        guesses = []
        for axis in (0, 1):
            for side in (1, -1):
                one, two, three = (_shifted(filled, side * by, axis) for by in (1, 2, 3))
                quadratic, linear = 3 * one - 3 * two + three, 2 * one - two
                best = np.where(np.isnan(quadratic), linear, quadratic)
                guesses.append(np.where(np.isnan(best), one, best))
        stack = np.stack(guesses)
        count = (~np.isnan(stack)).sum(axis=0)
        mean = np.nansum(stack, axis=0) / np.maximum(count, 1)
        filled = np.where(np.isnan(filled) & (count > 0), mean, filled)
    return filled


def _shifted(values: Array, by: int, axis: int) -> Array:
    """Shift values along an axis by that many nodes; NaN enters at the end."""
    moved = np.full_like(values, np.nan)
    size = values.shape[axis]
    target, source = [slice(None)] * values.ndim, [slice(None)] * values.ndim
    target[axis] = slice(max(0, -by), min(size, size - by))
    source[axis] = slice(max(0, by), min(size, size + by))
    moved[tuple(target)] = values[tuple(source)]
    return moved


def _covered(padded: Array, cells: NDArray[np.int64], step: float, low: NDArray[Any]) -> Any:
    """Yield blocks of raster points in cells: cells (N, 2), points (N, 2), fractions (N, 2).

    padded: (R + 2, C + 2, K) values, the first two the positions. Points are in units of the step.
    A point on the side between two cells comes with both. Fractions are (row, column), 0 to 1.
    """
    nodes = padded[1:-1, 1:-1, :2]
    row, column = cells.T
    corners = np.stack(
        [nodes[row + r, column + c] for r in (0, 1) for c in (0, 1)], axis=1
    )  # (N, 4, 2)
    margin = 0.25 * (corners.max(axis=1) - corners.min(axis=1))  # sides are curves
    first = np.ceil((corners.min(axis=1) - margin) / step).astype(np.int64)
    last = np.floor((corners.max(axis=1) + margin) / step).astype(np.int64)
    top = np.ceil(np.nanmax(nodes.reshape(-1, 2), axis=0) / step).astype(np.int64)
    first, last = np.maximum(first, low), np.minimum(last, top)
    size = np.maximum(last - first + 1, 0)
    order = np.argsort(size.prod(axis=1))
    begin = 0
    while begin < len(order):
        end = begin + 1
        while end < len(order) and (end + 1 - begin) * size[order[end]].prod() <= _BLOCK:
            end += 1
        block = order[begin:end]
        begin = end
        span = size[block].max(axis=0)
        offsets = np.stack(np.meshgrid(*map(np.arange, span)), axis=-1).reshape(-1, 2)
        within = (offsets[None] < size[block][:, None]).all(axis=2)
        number, which = np.nonzero(within)
        index, cell = first[block][number] + offsets[which], cells[block][number]
        fraction = _inverse(padded, cell, index * step)
        inside = ((fraction >= -_OUTSIDE) & (fraction <= 1 + _OUTSIDE)).all(axis=1)
        yield cell[inside], index[inside], fraction[inside]


def _inverse(padded: Array, cell: NDArray[np.int64], goal: Array) -> Array:
    """Return the fractions (row, column) of points within their cells, (N, 2); Newton's method."""
    row, column = cell.T + 1
    position = padded[..., :2]
    corner = position[row, column]
    down = position[row + 1, column] - corner
    right = position[row, column + 1] - corner
    slope = np.stack([down, right], axis=-1)  # (N, 2 of the plane, 2 of the lattice)
    good = np.abs(np.linalg.det(slope)) > 1e-12 * np.square(slope).sum(axis=(1, 2))
    inverse = np.full(slope.shape, np.nan)
    inverse[good] = np.linalg.inv(slope[good])
    fraction = np.full((len(cell), 2), 0.5)
    active = np.arange(len(cell))
    for _ in range(_STEPS):
        seen = _cubic(position, cell[active], fraction[active])
        step = (inverse[active] @ (goal[active] - seen)[..., None])[..., 0]
        moved = fraction[active] + step
        near: NDArray[np.bool_] = np.all(np.abs(moved - 0.5) <= _REACH, axis=1)
        fraction[active] = np.where(near[:, None], moved, np.nan)
        active = active[near & (np.abs(step) > _CONVERGED).any(axis=1)]
        if not len(active):
            break
    fraction[active] = np.nan
    return fraction


def _cubic(padded: Array, cell: NDArray[np.int64], fraction: Array) -> Array:
    """Interpolate (R + 2, C + 2, K) at fractions (N, 2) of cells by cubic convolution: (N, K)."""
    by_row, by_column = np.stack(_keys(fraction[:, 0])), np.stack(_keys(fraction[:, 1]))
    flat = padded.reshape(-1, padded.shape[2])
    first = cell[:, 0] * padded.shape[1] + cell[:, 1]
    result = np.zeros((len(cell), padded.shape[2]))
    for down in range(4):
        line = np.zeros_like(result)
        for right in range(4):
            line += by_column[right, :, None] * flat[first + (down * padded.shape[1] + right)]
        result += by_row[down, :, None] * line
    return result


def _keys(t: Array) -> tuple[Array, Array, Array, Array]:
    """Return the weights of the four neighbours at -1, 0, 1, 2 for a point at t."""
    return (
        ((2 - t) * t - 1) * t / 2,
        ((3 * t - 5) * t**2 + 2) / 2,
        ((4 - 3 * t) * t + 1) * t / 2,
        (t - 1) * t**2 / 2,
    )
