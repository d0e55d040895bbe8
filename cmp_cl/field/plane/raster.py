"""Values of the nodes, interpolated on a regular raster of the plane at rest."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import ConfigError, FieldError, as_numbers, check_kind, check_positive
from cmp_cl.field.plane.displacement import PlaneField

Array = NDArray[np.float64]

_BLOCK = 1 << 20  # points that are interpolated together
_STEPS = 20  # most Newton steps to find a point in its cell
_CONVERGED = 1e-4  # cells, length of the last step
_REACH = 1.0  # cells from a cell's middle; a point further away is in another cell
_OUTSIDE = 1e-6  # cells, allowance for rounding at their common sides


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
        """Return the distance between neighbouring points, in `unit`."""
        return float(self.x[1] - self.x[0])


def rasterize(field: PlaneField, values: ArrayLike | None = None, *, step: float = 1.0) -> Raster:
    """Interpolate values of the nodes at the multiples of `step` that the cells at rest cover.

    field: gives the positions at rest.

    values: (R, C) or (R, C, K) numbers, NaN where missing; None means the displacement. With a unit
    of px and a step of 1 the points are the pixels. Values and positions at rest are interpolated
    between nodes by cubic convolution (R. G. Keys, IEEE Trans. ASSP 29, 1981), and continued past
    the border by quadratic extrapolation.

    Raises FieldError if no cell is valid or covers a point, ConfigError if step is not
    positive or would give over 1e8 points.
    """
    check_kind("field", field, PlaneField, FieldError)
    given = field.displacement if values is None else values
    numbers = as_numbers("values", given, FieldError)
    if numbers.ndim == 2:
        numbers = numbers[..., None]
    if numbers.ndim != 3 or numbers.shape[:2] != field.status.shape:
        raise FieldError(f"values are {numbers.shape}, the field has {field.status.shape} nodes")
    check_positive("step", step, ConfigError)
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
    """Extend values (R, C, K) by one node on each side, (R + 2, C + 2, K), and fill gaps.

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
    A point on the side between two cells is in both. Fractions are (row, column), 0 to 1.
    """
    nodes = padded[1:-1, 1:-1, :2]
    row, column = cells.T
    # (N, 4, 2).
    corners = np.stack([nodes[row + r, column + c] for r in (0, 1) for c in (0, 1)], axis=1)
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
