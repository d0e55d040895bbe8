"""Heights and densities from gradients, for waves on a surface and schlieren in a gas.

A pattern seen through a medium appears displaced by u = -length grad(phi): through a free
surface, phi is its height (F. Moisy, M. Rabaud, K. Salsac, Exp. Fluids 46, 2009); through a gas,
phi is the refractive index, integrated along the line of sight (background-oriented schlieren).
`integrate` finds phi from its gradient by least squares, which leads to Poisson's equation.
"""

import dataclasses
import enum
import math
from numbers import Real

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, as_numbers, check_kind, check_positive
from cmp_cl.field.plane import Raster

Array = NDArray[np.float64]

_GLADSTONE_DALE = 2.26e-4  # m3/kg, air in visible light
_TOLERANCE = 1e-8  # relative residual at which the iteration ends
_MOST_STEPS = 2000


class Boundary(enum.Enum):
    """The condition on phi at the border of the mask.

    FREE: none; each connected part of the mask has a mean of 0. ZERO: phi is 0 at the raster points
    just outside.
    """

    FREE = "free"
    ZERO = "zero"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Potential:
    """A function whose gradient was measured.

    value: (H, W) float64, NaN outside the mask. gradient: (H, W, 2) float64, as measured, by x and
        by y. misfit: (H, W) float64, length of the gradient of `value` minus the measured one. It
        comes from noise or from a wrong model.
    x: (W,), y: (H,) float64, coordinates of columns and rows. unit: unit of value, x and y.
    """

    value: Array
    gradient: Array
    misfit: Array
    x: Array
    y: Array
    unit: str


def surface_height(
    displaced: Raster,
    *,
    depth: float,
    index: float = 1.333,
    camera: float = math.inf,
    mask: NDArray[np.bool_] | None = None,
    boundary: Boundary = Boundary.FREE,
) -> Potential:
    """Return the height of a liquid's surface above its level at rest, from a pattern seen through
        it.

    displaced: displacement of the pattern; at rest the surface is flat. depth: distance from the
    surface to the pattern within the liquid (for a layer of another medium, its thickness times
    index over the index of that medium). camera: distance from the surface to the camera, in air.
    Both are in the raster's unit. index: refractive index of the liquid. u = -h* grad(h), 1/h* =
    1/(a depth) - 1/camera, a = 1 - 1/index (Moisy, Rabaud, Salsac 2009, Eqs. 10 and 11). It holds
    for small slopes, heights that are small compared with the depth, and rays that do not cross.
    mask, boundary: see `integrate`.

    Raises ConfigError if a length or the index is out of range, and FieldError as `integrate` does.
    """
    check_kind("displaced", displaced, Raster, FieldError)
    check_positive("depth", depth, ConfigError)
    check_positive("index", index, ConfigError)
    check_kind("camera", camera, Real, ConfigError)
    if not (1 < index < 10 and camera > 0):
        raise ConfigError(
            f"camera must be positive and index from 1 to 10, not {camera!r} and {index!r}"
        )
    inverse = 1 / ((1 - 1 / index) * depth) - 1 / camera
    if not inverse > 0:
        raise ConfigError(f"a camera {camera} away is within the focus of {depth} of liquid")
    return integrate(displaced, -inverse * _plane(displaced), mask=mask, boundary=boundary)


def projected_density(
    displaced: Raster,
    *,
    distance: float,
    gladstone_dale: float = _GLADSTONE_DALE,
    index: float = 1.000273,
    mask: NDArray[np.bool_] | None = None,
    boundary: Boundary = Boundary.FREE,
) -> Potential:
    """Return the density of a gas minus that at rest, integrated along the line of sight, kg/m2.

    displaced: displacement of the background, mm in the background's plane. distance: from
    the middle of the gas to the background, mm. gladstone_dale: m3/kg. index: refractive index of
    the gas at rest. mask, boundary: see `integrate`. u = -distance grad(integral of n) / index, and
    n - 1 = gladstone_dale density.

    Raises ConfigError if a number is out of range, FieldError if the unit is not mm.
    """
    check_kind("displaced", displaced, Raster, FieldError)
    if displaced.unit != "mm":
        raise FieldError(f"a density needs the displacement in mm, not in {displaced.unit}")
    check_positive("distance", distance, ConfigError)
    check_positive("gladstone_dale", gladstone_dale, ConfigError)
    check_positive("index", index, ConfigError)
    if not index >= 1:
        raise ConfigError(f"index must be at least 1, not {index!r}")
    factor = 1e-3 * index / (distance * gladstone_dale)  # kg/m2 per mm, by mm
    found = integrate(displaced, -factor * _plane(displaced), mask=mask, boundary=boundary)
    return dataclasses.replace(found, unit="kg/m2")


def _plane(displaced: Raster) -> Array:
    if displaced.values.shape[2] != 2:
        raise FieldError(f"a displacement has 2 values a point, not {displaced.values.shape[2]}")
    return displaced.values


def integrate(
    raster: Raster,
    gradient: Array,
    *,
    mask: NDArray[np.bool_] | None = None,
    boundary: Boundary = Boundary.FREE,
) -> Potential:
    """Return the function with a given gradient, by least squares over neighbouring points.

    raster: gives the coordinates. gradient: (H, W, 2) by x and y, NaN where unknown. mask: (H, W)
        bool, the points at which phi is wanted; None means all. Points of unknown gradient are left
        out. boundary: the condition at the border of the mask.

    The solver is conjugate gradients, preconditioned by the cosine transform's solution on the
    whole rectangle. Raises FieldError if the shapes differ, no point is left in the mask, or the
    iteration does not converge.
    """
    check_kind("raster", raster, Raster, FieldError)
    gradient = as_numbers("gradient", gradient, FieldError)
    if gradient.shape != (len(raster.y), len(raster.x), 2):
        raise FieldError(f"the gradient is {gradient.shape}, the raster {raster.values.shape}")
    known = np.asarray(np.isfinite(gradient).all(axis=2), np.bool_)
    check_kind("boundary", boundary, Boundary, FieldError)
    if mask is not None:
        check_kind("mask", mask, np.ndarray, FieldError)
        if mask.shape != known.shape or mask.dtype != np.bool_:
            raise FieldError(
                f"the mask must be bool of {known.shape}, not {mask.dtype} {mask.shape}"
            )
        known = np.asarray(known & mask, np.bool_)
    if not known.any():
        raise FieldError("no gradient is known within the mask")
    # A margin of one point holds the zeros; it does not belong to the mask.
    inside = np.pad(known, 1)
    slopes = np.pad(np.where(known[..., None], gradient, 0) * raster.step, ((1, 1), (1, 1), (0, 0)))
    problem = _Poisson(inside, boundary)
    value = problem.solve(problem.divergence(slopes))
    misfit = problem.misfit(value, slopes)[1:-1, 1:-1] / raster.step
    return Potential(
        value=np.where(known, value[1:-1, 1:-1], np.nan),
        gradient=np.where(known[..., None], gradient, np.nan),
        misfit=np.where(known, misfit, np.nan),
        x=raster.x,
        y=raster.y,
        unit=raster.unit,
    )


class _Poisson:
    """Least squares of differences between neighbours: A'A phi = A'g on a mask (H, W)."""

    def __init__(self, inside: NDArray[np.bool_], boundary: Boundary) -> None:
        self._inside = inside
        # The pairs of neighbours that are used, along x (H, W - 1) and along y (H - 1, W).
        pairs = [(inside[:, :-1], inside[:, 1:]), (inside[:-1], inside[1:])]
        meet = np.logical_or if boundary is Boundary.ZERO else np.logical_and
        self._pairs = [np.asarray(meet(one, two), np.bool_) for one, two in pairs]
        self._parts: NDArray[np.int32] | None = None
        if boundary is Boundary.FREE:
            parts = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)[1]
            self._parts = np.asarray(parts, np.int32)
            self._sizes = np.maximum(np.bincount(self._parts.ravel()), 1)
        rows, columns = (cv2.getOptimalDFTSize((side + 1) // 2) * 2 for side in inside.shape)
        waves = [2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (rows, columns)]
        self._spectrum = waves[0][:, None] + waves[1]
        self._spectrum[0, 0] = np.inf if self._parts is not None else self._spectrum[0, 1] / 4

    def divergence(self, slopes: Array) -> Array:
        """Return A'g, from the mean slope of two points that are both inside, else from one
        slope."""
        return self._spread(self._means(slopes))

    def _means(self, slopes: Array) -> list[Array]:
        along_x, along_y = slopes[..., 0], slopes[..., 1]
        inside = self._inside.astype(np.float64)
        sums = along_x[:, :-1] + along_x[:, 1:], along_y[:-1] + along_y[1:]
        counts = inside[:, :-1] + inside[:, 1:], inside[:-1] + inside[1:]
        return [
            np.where(pairs, total / np.maximum(count, 1), 0)
            for pairs, total, count in zip(self._pairs, sums, counts, strict=True)
        ]

    def _spread(self, differences: list[Array]) -> Array:
        """Apply A' to differences along x and y."""
        along_x, along_y = differences
        result = np.zeros(self._inside.shape)
        result[:, 1:] += along_x
        result[:, :-1] -= along_x
        result[1:] += along_y
        result[:-1] -= along_y
        return np.where(self._inside, result, 0)

    def _differences(self, value: Array) -> list[Array]:
        return [
            np.where(pairs, np.diff(value, axis=axis), 0)
            for axis, pairs in zip((1, 0), self._pairs, strict=True)
        ]

    def _centred(self, value: Array) -> Array:
        """Subtract the mean of each part, if nothing else determines it."""
        if self._parts is None:
            return np.where(self._inside, value, 0)
        sums = np.bincount(self._parts.ravel(), weights=value.ravel())
        return np.where(self._inside, value - (sums / self._sizes)[self._parts], 0)

    def _roughly(self, residual: Array) -> Array:
        """Solve approximately, on the whole rectangle."""
        padded = np.zeros(self._spectrum.shape)
        padded[: residual.shape[0], : residual.shape[1]] = residual
        waves = cv2.dct(padded) / self._spectrum
        solved = cv2.idct(waves)[: residual.shape[0], : residual.shape[1]]
        return self._centred(np.asarray(solved, np.float64))

    def solve(self, goal: Array) -> Array:
        """Solve by conjugate gradients. Raises FieldError if they do not converge."""
        value = np.zeros_like(goal)
        residual = self._centred(goal)
        target = _TOLERANCE * float(np.linalg.norm(residual))
        direction, before = np.zeros_like(goal), 1.0
        for _ in range(_MOST_STEPS):
            if float(np.linalg.norm(residual)) <= target:
                return self._centred(value)
            rough = self._roughly(residual)
            now = float((residual * rough).sum())
            direction = rough + (now / before) * direction
            before = now
            image = self._spread(self._differences(direction))
            step = now / float((direction * image).sum())
            value = value + step * direction
            residual = residual - step * image
        raise FieldError(f"Poisson's equation is not solved after {_MOST_STEPS} steps")

    def misfit(self, value: Array, slopes: Array) -> Array:
        """Return, for each point, the RMS difference from the measured slope over both axes."""
        total = np.zeros_like(value)
        for axis, (found, wanted, pairs) in enumerate(
            zip(self._differences(value), self._means(slopes), self._pairs, strict=True)
        ):
            squares, counts = np.zeros_like(value), np.zeros_like(value)
            off = np.square(found - wanted)
            for end in (slice(1, None), slice(None, -1)):
                at = (slice(None), end) if axis == 0 else (end, slice(None))
                squares[at] += off
                counts[at] += pairs
            total += squares / np.maximum(counts, 1)
        return np.sqrt(total)
