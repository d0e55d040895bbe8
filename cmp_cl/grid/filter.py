"""The adaptive lattice filter: positions from the neighbours too, and how far each may be off.

On a worn print the visible corner is not where the material point is. No picture of one corner
can tell, but its neighbours in the lattice can. Each node becomes a mixture of local polynomials
along its row and its column. Stein's unbiased risk estimate chooses, node by node, how far they
reach and of which degree they are; there is nothing to set.
"""

import dataclasses
import functools
import math
import threading
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import GridError
from cmp_cl.grid.grid import MEASURED, Grid

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]
Box = tuple[slice, slice]

AXIS_FILTERS = ((0, 0), (2, 1), (2, 3), (4, 3), (7, 3))  # half width in nodes, degree
BENDING_FILTERS = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # of what may bend sharply
NOISE_REACH = 2.0  # nodes, standard deviation of the Gaussian that averages the noise
RISK_REACH = 1.5  # nodes, of the one that averages the risk
LEAST_SUPPORT = 0.75  # share of a window's nodes that must be measured
REFUSED = 6.0  # standard deviations from what the neighbours predict
_SHARPNESS = 2 * math.pi * RISK_REACH**2 / 3  # of the weights, per unit of risk
_FLOOR = 1e-10  # of the variance of the noise, relative to the mean square of the values
_LEAST = 1e-30  # of the variance of the noise
_LEAST_OF_FIVE = 1.29  # white noise: its variance over the mean of the least of the five below
_SEVEN = np.array([5, -30, 75, 131, 75, -30, 5]) / 231  # the pilot's weights, inside
_ROUNDS = 3  # searches for nodes to refuse
_FILL_REACH = (3, 6)  # nodes around a hole that predict its value
_ROWS_AT_ONCE = 16  # of a lattice, where every node has a kernel of its own
_MOST_KEPT = 1 << 20  # numbers of a thread's scratch memory
_kept = threading.local()


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Filtered:
    """A lattice of R x C nodes with K coordinates behind the filter.

    values: (R, C, K) float64, in the unit of the input, NaN where that is NaN. A refused node
        keeps its own value.
    sigma: (R, C) float64, standard deviation of `values` per coordinate, NaN where too few
        neighbours are there to tell.
    noise: (R, C) float64, the same of the values before the filter.
    refused: (R, C) bool, nodes that are more than REFUSED standard deviations from what their
        neighbours predict. They have no influence on others.
    """

    values: Array
    sigma: Array
    noise: Array
    refused: Bools
    _mixtures: "tuple[_Mixture, ...]"

    def covariance(self) -> Array:
        """Return (R, C, K, K) float64: the covariance of the coordinates of each filtered node, NaN
        where sigma is.

        The residuals around the node say how its coordinates vary together; the mean of the
        diagonal is sigma squared.
        """
        return self._covariance(self.sigma)

    def noise_covariance(self) -> Array:
        """Return (R, C, K, K) float64: the same of the values before the filter."""
        return self._covariance(self.noise)

    def _covariance(self, sigma: Array) -> Array:
        count = self.values.shape[2]
        whole = np.full((*sigma.shape, count, count), np.nan)
        for mixture in self._mixtures:
            box, part = mixture.box, mixture.part
            covariance = mixture.common() * np.square(sigma[box])[..., None, None]
            whole[box] = np.where(part[..., None, None], covariance, whole[box])
        return whole

    def deviation_of(self, stencil: ArrayLike) -> Array:
        """Return (R, C) float64: the standard deviation of a linear combination around each node.

        stencil: (R, C, S, S), S odd, the weights of the filtered neighbours, the node itself in
        the middle; weights of what lies beyond the lattice or is NaN must be 0. Neighbours
        share much of their noise: a slope between them is more certain than their own sigma
        says. NaN where sigma is. Raises GridError where the stencil has another shape.
        """
        weights = np.asarray(stencil, np.float64)
        if weights.ndim != 4 or weights.shape[:2] != self.sigma.shape or weights.shape[2] % 2 == 0:
            raise GridError(
                f"the stencil must be (R, C, S, S), S odd, for {self.sigma.shape} nodes, not "
                f"{weights.shape}"
            )
        deviation = np.full(self.sigma.shape, np.nan)
        for mixture in self._mixtures:
            box, part = mixture.box, mixture.part
            found = mixture.deviation_of(weights[box], self.sigma[box])
            deviation[box] = np.where(part, found, deviation[box])
        return np.where(np.isnan(self.sigma), np.nan, deviation)


def filter_grid(
    values: ArrayLike, *, measured: ArrayLike | None = None, bends: bool = False
) -> Filtered:
    """Filter a lattice over its rows and columns.

    values: (R, C, K), K >= 1 coordinates in one unit and of like noise; a node with a NaN is
    missing. measured: (R, C) bool, the nodes that others may rely on; the rest get what their
    neighbours predict. None means all. A deformation is filtered as one array of displacements,
    not as two of positions: wear that travels with the material cancels in their difference.
    bends: the values may bend sharply along an axis, as a deformation does at the edge of what
    presses. What bends is then told from noise by looking along one direction alone, too: an
    axis or a diagonal. Leave it out for positions: wear that neighbours share would be taken
    for the shape.

    Raises GridError where the arrays have other shapes.
    """
    given = np.array(values, np.float64)
    if given.ndim != 3 or not given.shape[2]:
        raise GridError(f"values must be (R, C, K), K >= 1, not {given.shape}")
    there = np.asarray(np.isfinite(given).all(axis=2), np.bool_)
    given[~there] = np.nan
    votes = there.copy()
    if measured is not None:
        allowed = np.asarray(measured, np.bool_)
        if allowed.shape != there.shape:
            raise GridError(f"measured must be {there.shape}, not {allowed.shape}")
        votes &= allowed
    sigma = np.full(there.shape, np.nan)
    noise = sigma.copy()
    refused = np.zeros(there.shape, np.bool_)
    mixtures = []
    for part in _components(votes):
        box = _box(votes & part)
        mixture, plane = _of_component(given[box], votes[box], part[box], box, bends=bends)
        prediction = mixture.values.transpose(1, 2, 0) + plane
        here = there[box] & part[box]
        refused[box] |= here & votes[box] & ~mixture.votes
        variance = np.where(mixture.votes, mixture.variance, mixture.raw_variance)
        if refused[box].any():
            off = np.square(given[box] - prediction).mean(axis=2)
            variance = np.where(refused[box], np.maximum(off, variance), variance)
        kept = here & ~refused[box] & np.isfinite(variance)
        given[box] = np.where(kept[..., None], prediction, given[box])
        sigma[box] = np.where(here, np.sqrt(variance), sigma[box])
        noise[box] = np.where(here, np.sqrt(mixture.raw_variance), noise[box])
        mixtures.append(mixture)
    return Filtered(
        values=given, sigma=sigma, noise=noise, refused=refused, _mixtures=tuple(mixtures)
    )


def filter_at_rest(values: ArrayLike, *, measured: ArrayLike) -> Filtered:
    """Filter positions at rest, see `filter_grid`. The last few are kept: those of a film's frames
    are the same."""
    given, votes = np.asarray(values, np.float64), np.asarray(measured, np.bool_)
    return _at_rest(given.shape, given.tobytes(), votes.tobytes())


@functools.lru_cache(maxsize=4)
def _at_rest(shape: tuple[int, ...], values: bytes, measured: bytes) -> Filtered:
    votes = np.frombuffer(measured, np.bool_).reshape(shape[:2])
    found = filter_grid(np.frombuffer(values).reshape(shape), measured=votes)
    for array in (found.values, found.sigma, found.noise, found.refused):
        array.flags.writeable = False
    return found


def filter_positions(now: Grid, *, rest: Grid | None = None) -> tuple[Grid, Grid]:
    """Return the grid with filtered positions, and the raw one, each with the sigma from the
    lattice.

    rest: the same pattern at rest, numbered alike. Then the displacements are filtered and
    stand on the filtered positions at rest; a node that is missing there keeps its position.
    Nodes that no image has shown, interpolated ones, follow their neighbours. Where the lattice
    is too small to tell, sigma stays what the corners say.

    Raises GridError where the grid has not all rows and columns of the one at rest.
    """
    if rest is None:
        found = filter_grid(now.xy, measured=np.isin(now.status, MEASURED))
        return _with(now, found.values, found.sigma), _with(now, now.xy, found.noise)
    if not now.covers(rest):
        raise GridError(f"the grid at rest has {rest.extent}, the other {now.extent}")
    rest = rest.cut_to(now)
    measured = np.isin(rest.status, MEASURED)
    start = filter_at_rest(rest.xy, measured=measured)
    moved = now.xy.astype(np.float64) - rest.xy
    change = filter_grid(moved, measured=measured & np.isin(now.status, MEASURED), bends=True)
    values = np.where(np.isnan(moved), now.xy, start.values + change.values)
    return (
        _with(now, values, np.hypot(start.sigma, change.sigma)),
        _with(now, now.xy, np.hypot(start.noise, change.noise)),
    )


def _with(grid: Grid, values: NDArray[np.floating[Any]], sigma: Array) -> Grid:
    """Return the grid with other positions, and that sigma where it is known."""
    return dataclasses.replace(
        grid,
        xy=values.astype(np.float32),
        sigma=np.where(np.isfinite(sigma), sigma, grid.sigma).astype(np.float32),
    )


def _of_component(
    given: Array, votes: Bools, part: Bools, box: Box, *, bends: bool
) -> "tuple[_Mixture, Array]":
    """Return the mixture for the residual of the best bilinear surface; the surface, (R, C, K)."""
    votes = votes & part
    plane = _plane(given, votes)
    data = np.where(votes[..., None], given - plane, 0).transpose(2, 0, 1)
    return _mixed(np.ascontiguousarray(data, np.float32), votes, part, box, bends=bends), plane


def _components(votes: Bools) -> list[Bools]:
    """Return the parts of the lattice with votes, with up to a node around each; gaps of one or two
    nodes part nothing.
    """
    if votes.all():
        return [votes] if votes.size else []
    grown = cv2.dilate(votes.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, label = cv2.connectedComponents(grown, connectivity=8)
    return [label == number for number in range(1, count)]


def _box(votes: Bools) -> Box:
    """Return the smallest rectangle with all nodes that have a vote."""
    rows, columns = np.nonzero(votes.any(axis=1))[0], np.nonzero(votes.any(axis=0))[0]
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


@functools.lru_cache(maxsize=64)
def _bilinear(rows: int, columns: int) -> Array:
    """Return 1, r, c and r c, from -1 to 1, orthogonal over all nodes: (R, C, 4)."""
    r = np.linspace(-1, 1, rows)[:, None] if rows > 1 else np.full((1, 1), 1e-9)
    c = np.linspace(-1, 1, columns)[None, :] if columns > 1 else np.full((1, 1), 1e-9)
    return np.stack(np.broadcast_arrays(1.0, r, c, r * c), axis=-1)


def _plane(values: Array, votes: Bools) -> Array:
    """Return (R, C, K): the bilinear surface that fits best. The filters leave such surfaces as
    they are; without it float32 is exact enough for what is left.
    """
    rows, columns = votes.shape
    terms = _bilinear(rows, columns)
    if votes.all():
        flat = terms.reshape(-1, 4)
        fit = (flat.T @ values.reshape(len(flat), -1)) / np.square(flat).sum(axis=0)[:, None]
    else:
        fit = np.linalg.lstsq(terms[votes], values[votes], rcond=None)[0]
    plane: Array = terms @ fit
    return plane


@dataclasses.dataclass(frozen=True, eq=False)
class _Axis:
    """The filters along an axis of n nodes, A of them.

    filters: (A, n, n) float32, a row per node; the first one changes nothing. own: (A, n), the
    weight of the node itself. gain: (A, n), the sum of the squares. share: (A, n, n), 1 / window
    where the window is. pilot, pilot_own, pilot_share: of the filter that shows the noise.
    near_noise, near_risk: (n, n) Gaussians, rows of sum 1. columns: (A - 1, n, n), the filters
    after the first one as factors on the right.
    """

    filters: Single
    columns: Single
    own: Single
    gain: Single
    share: Single
    pilot: Single
    pilot_own: Single
    pilot_share: Single
    near_noise: Single
    near_risk: Single


def _polynomial(n: int, half: int, degree: int) -> Array:
    """Return (n, n): the value at each node of the polynomial fitted to its window, which is moved
    inwards at the ends.
    """
    whole = np.zeros((n, n))
    for node in range(n):
        first = min(max(node - half, 0), n - 2 * half - 1)
        window = np.arange(first, first + 2 * half + 1)
        powers = (window - node)[:, None].astype(np.float64) ** np.arange(degree + 1)
        whole[node, window] = np.linalg.pinv(powers)[0]
    return whole


def _gaussian(n: int, deviation: float) -> Single:
    apart = np.arange(n)[:, None] - np.arange(n)
    weights = np.exp(-np.square(apart / deviation) / 2)
    rows: Single = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    return rows


@functools.lru_cache(maxsize=64)
def _axis(n: int, *, bends: bool = False) -> _Axis:
    usual = BENDING_FILTERS if bends else AXIS_FILTERS
    fitting = [(half, degree) for half, degree in usual if n >= 2 * half + 1]
    filters = np.stack([_polynomial(n, *each) for each in fitting])
    pilot = _polynomial(n, *((3, 5) if n >= 8 else (2, 3) if n >= 5 else (0, 0)))
    windows = [np.not_equal(each, 0) | np.eye(n, dtype=np.bool_) for each in [*filters, pilot]]
    share = np.stack([each / each.sum(axis=1, keepdims=True) for each in windows])

    def single(values: Array) -> Single:
        return np.ascontiguousarray(values, np.float32)

    return _Axis(
        filters=single(filters),
        columns=single(filters[1:].transpose(0, 2, 1)),
        own=single(np.diagonal(filters, axis1=1, axis2=2)),
        gain=single(np.square(filters).sum(axis=2)),
        share=single(share[:-1]),
        pilot=single(pilot),
        pilot_own=single(np.diag(pilot)),
        pilot_share=single(share[-1]),
        near_noise=_gaussian(n, NOISE_REACH),
        near_risk=_gaussian(n, RISK_REACH),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Pairs:
    """What the pairs of a filter along the columns (A) and one along the rows (B) share.

    own, gain: (A, B, R, C). pilot_own: (R, C).
    """

    own: Single
    gain: Single
    pilot_own: Single


@functools.lru_cache(maxsize=64)
def _pairs(rows: int, columns: int, *, bends: bool = False) -> _Pairs:
    down, along = _axis(rows, bends=bends), _axis(columns, bends=bends)
    return _Pairs(
        own=down.own[:, None, :, None] * along.own[:, None],
        gain=down.gain[:, None, :, None] * along.gain[:, None],
        pilot_own=np.outer(down.pilot_own, along.pilot_own),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Mixture:
    """The filter at work on a component, in its rectangle of nodes; all float32.

    part: (R, C), the nodes of the component. votes: (R, C), those that others rely on.
    bends: see `filter_grid`.
    data, values: (K, R, C), before, with predictions in the holes, and behind it.
    residual: (K, R, C), of the pilot. weights: (A, B, R, C), of each pair at each node.
    raw_variance, variance: (R, C), of the data and of the values. gain: (R, C), the least ratio
    of the two that the weights allow.
    """

    box: Box
    part: Bools
    bends: bool
    data: Single
    votes: Bools
    residual: Single
    weights: Single
    values: Single
    raw_variance: Single
    variance: Single
    gain: Single

    def common(self) -> Array:
        """Return (R, C, K, K): how the coordinates vary together around each node, of mean diagonal
        1."""
        rows, columns = self.votes.shape
        down, along = _axis(rows), _axis(columns)
        residual = np.where(self.votes, self.residual, 0).astype(np.float64)
        products = residual[:, None] * residual[None]
        sums = down.near_noise @ products @ along.near_noise.T
        sums = sums.transpose(2, 3, 0, 1)
        count = len(residual)
        mean = np.trace(sums, axis1=2, axis2=3)[..., None, None] / count
        alike = np.broadcast_to(np.eye(count), sums.shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(mean > 0, sums / mean, alike)

    def deviation_of(self, stencil: Array, sigma: Array) -> Array:
        """Return (R, C) float64, see `Filtered.deviation_of`."""
        rows, columns = self.votes.shape
        reach, side = stencil.shape[2] // 2, 2 * max(half for half, _ in AXIS_FILTERS)
        down, along = (_bands(n, side, bends=self.bends) for n in (rows, columns))
        noise = np.sqrt(self.raw_variance)
        with np.errstate(invalid="ignore", divide="ignore"):
            excess = sigma / (noise * np.sqrt(self.gain))  # what the noise does not explain
        excess = np.where(np.isfinite(excess), excess, 1)
        noise = np.pad(np.where(np.isfinite(noise), noise, 0), side + reach)
        result = np.empty((rows, columns))
        for first in range(0, rows, _ROWS_AT_ONCE):
            block = slice(first, min(first + _ROWS_AT_ONCE, rows))
            low, high = max(first - reach, 0), min(block.stop + reach, rows)
            kernels = np.einsum(
                "abrc,ard,bce->rcde", self.weights[:, :, low:high], down[:, low:high], along,
                optimize=True,
            )  # fmt: skip
            around = np.lib.stride_tricks.sliding_window_view(
                noise[low + reach : high + reach + 2 * side, reach : -reach or None],
                kernels.shape[2:],
            )
            kernels = kernels * around
            kernels *= excess[low:high, :, None, None]
            total = np.zeros(
                (block.stop - first, columns, *(n + 2 * reach for n in [2 * side + 1] * 2))
            )
            width = 2 * side + 1
            for i in range(-reach, reach + 1):
                for j in range(-reach, reach + 1):
                    top, bottom = max(first, -i), min(block.stop, rows - i)
                    left, right = max(0, -j), min(columns, columns - j)
                    if top >= bottom or left >= right:
                        continue
                    weight = stencil[top:bottom, left:right, i + reach, j + reach]
                    total[
                        top - first : bottom - first,
                        left:right,
                        i + reach : i + reach + width,
                        j + reach : j + reach + width,
                    ] += (
                        weight[..., None, None]
                        * kernels[top + i - low : bottom + i - low, left + j : right + j]
                    )
            result[block] = np.sqrt(np.square(total).sum(axis=(2, 3)))
        return result


def _bands(n: int, side: int, *, bends: bool) -> Single:
    """Return the rows of the filters around the node, (A, n, 2 side + 1)."""
    filters = _axis(n, bends=bends).filters
    bands = np.zeros((len(filters), n, 2 * side + 1), np.float32)
    for node in range(n):
        first, last = max(node - side, 0), min(node + side + 1, n)
        bands[:, node, first - node + side : last - node + side] = filters[:, node, first:last]
    return bands


def _mixed(data: Single, votes: Bools, part: Bools, box: Box, *, bends: bool) -> _Mixture:
    """Return the mixture for data (K, R, C), without the nodes that their neighbours refuse."""
    whole = bool(votes.all())
    if not whole:
        data = _filled(data, votes)
    residual, noise = _noise(data, votes, whole=whole)
    allowed = votes
    for _ in range(_ROUNDS):
        suspects = _suspects(residual, noise, allowed)
        if not suspects.any():
            break
        allowed = allowed & ~suspects
        data = _filled(np.where(votes, data, 0), allowed)
        residual, noise = _noise(data, allowed, whole=False)
    shape_noise = _noise_along(data, allowed, noise) if bends else noise
    return _mixture(data, allowed, residual, noise, shape_noise, part, box, bends=bends)


def _noise(data: Single, votes: Bools, *, whole: bool) -> tuple[Single, Single]:
    """Return the pilot's residual (K, R, C), and the variance of the noise (R, C), NaN if unknown.

    The mean size of the residual sees a few large ones less than the mean of its square: a
    sharp bend of the surface is no noise.
    """
    rows, columns = votes.shape
    down, along, pairs = _axis(rows), _axis(columns), _pairs(rows, columns)
    residual = np.asarray(data - down.pilot @ data @ along.pilot.T, np.float32)
    left = 1 - pairs.pilot_own
    square = np.square(residual).mean(axis=0) / np.maximum(left, 1e-3)
    size = np.asarray(np.sqrt(square), np.float32)
    usable = left > 0.05
    if not whole:
        support = down.pilot_share @ votes.astype(np.float32) @ along.pilot_share.T
        usable &= votes & (support >= LEAST_SUPPORT)
    if usable.all():
        mean = down.near_noise @ size @ along.near_noise.T
    else:
        size = np.where(usable, size, np.float32(0))
        near = down.near_noise @ usable.astype(np.float32) @ along.near_noise.T
        mean = down.near_noise @ size @ along.near_noise.T
        mean = np.where(near > 1e-6, mean / np.maximum(near, 1e-6), np.float32(np.nan))
    expected = _expected_size(residual, size)
    floor = max(_FLOOR * float(np.square(data).mean()), _LEAST)
    noise = np.square(mean / np.float32(expected)) + np.float32(floor)
    return residual, np.asarray(noise, np.float32)


def _noise_along(data: Single, votes: Bools, noise: Single) -> Single:
    """Return the least of the noise's variances that both axes together, each alone and each
    diagonal alone show, (R, C).

    Along an edge the surface is smooth, however sharply it bends across. The least of five is
    too small by a known share where all show the same noise.
    """
    down, along = _axis(votes.shape[0]), _axis(votes.shape[1])
    least = noise
    for residual, own in (
        (data - down.pilot @ data, down.pilot_own[:, None]),
        (data - data @ along.pilot.T, along.pilot_own[None]),
        *_along_diagonals(data),
    ):
        usable = votes & (own < 0.95)
        near = down.near_noise @ usable.astype(np.float32) @ along.near_noise.T
        square = np.square(residual).mean(axis=0) / np.maximum(1 - own, 0.05)
        size = np.where(usable, np.asarray(np.sqrt(square), np.float32), np.float32(0))
        mean = down.near_noise @ size @ along.near_noise.T / np.maximum(near, np.float32(1e-6))
        alone = np.square(mean / np.float32(_expected_size(residual, size)))
        least = np.where(near > 1e-6, np.minimum(least, alone), least)
    chosen: Single = np.minimum(noise, least * np.float32(_LEAST_OF_FIVE))
    return chosen


def _along_diagonals(data: Single) -> list[tuple[Single, Single]]:
    """Return what the pilot along each diagonal leaves, (K, R, C), and each node's own weight in
    it, (R, C); the weight is 1 within three nodes of the border. A lattice of fewer than 7 rows
    or columns has none.
    """
    _, rows, columns = data.shape
    if min(rows, columns) < len(_SEVEN):
        return []
    inside = np.s_[3 : rows - 3, 3 : columns - 3]
    own = np.ones((rows, columns), np.float32)
    own[inside] = _SEVEN[3]
    found = []
    for sense in (1, -1):
        residual = np.zeros_like(data)
        middle = residual[:, *inside]
        middle += data[:, *inside]
        for step, weight in enumerate(_SEVEN, -3):
            left = 3 + sense * step
            around = data[:, 3 + step : rows - 3 + step, left : left + columns - 6]
            middle -= np.float32(weight) * around
        found.append((residual, own))
    return found


def _expected_size(residual: Single, size: Single) -> float:
    """Return the mean of a residual's size where its variance per coordinate is 1.

    That size is taken as chi-distributed, with as many degrees of freedom as there are
    directions of like variance: those of the residuals, weighted so that few large ones do not
    decide. residual: (K, R, C). size: (R, C), 0 where it is unknown.
    """
    count = len(residual)
    relative = size / max(float(size.max()), 1e-30)
    weights = np.where(size > 0, 1 / np.maximum(relative, 1e-8), 0)
    flat = residual.reshape(count, -1)
    common = (flat * weights.reshape(-1)) @ flat.T
    square = float(np.square(common).sum())
    freedom = float(np.trace(common)) ** 2 / square if square > 0 else float(count)
    share: float = math.sqrt(2 / freedom)
    return share * math.gamma(freedom / 2 + 0.5) / math.gamma(freedom / 2)


def _suspects(residual: Single, noise: Single, votes: Bools) -> Bools:
    """Return the nodes whose residual is too large, and the largest among its eight neighbours'."""
    size = np.where(votes, np.square(residual).mean(axis=0), 0)
    pairs = _pairs(*votes.shape)
    with np.errstate(invalid="ignore"):
        large: Bools = size > REFUSED**2 * noise * (1 - pairs.pilot_own)
    if not large.any():
        return large
    padded = np.pad(size, 1)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    largest: Bools = large & (size >= around)
    return largest


def _mixture(
    data: Single,
    votes: Bools,
    residual: Single,
    noise: Single,
    chosen_noise: Single,
    part: Bools,
    box: Box,
    *,
    bends: bool,
) -> _Mixture:
    count, rows, columns = data.shape
    down, along = (_axis(n, bends=bends) for n in (rows, columns))
    pairs = _pairs(rows, columns, bends=bends)
    known = np.isfinite(noise)
    s2 = np.where(known, np.maximum(chosen_noise, np.float32(_LEAST)), np.float32(1))
    smooth = _smooth(data, bends=bends)
    risk = _scratch("risk", pairs.own.shape)
    apart = np.empty_like(risk)
    np.multiply(pairs.own, 2 * count * s2, out=risk)  # the loss, until it is averaged
    for coordinate in range(count):
        np.subtract(smooth[coordinate], data[coordinate], out=apart)
        risk += np.square(apart, out=apart)
    whole = bool(votes.all())
    if not whole:
        risk *= votes
    np.matmul(down.near_risk, np.matmul(risk, along.near_risk.T, out=apart), out=risk)
    if whole:
        risk *= 1 / (count * s2)
    else:
        there = votes.astype(np.float32)
        near = down.near_risk @ there @ along.near_risk.T
        risk *= 1 / (count * s2 * np.maximum(near, np.float32(1e-6)))
        support = (down.share @ there)[:, None] @ along.share.transpose(0, 2, 1)
        bad = (support < LEAST_SUPPORT) | ~known | (near < 1e-6)
        bad[0, 0] = False
        risk[bad] = 1e30
    weights = np.subtract(risk.min(axis=(0, 1)), risk, out=apart)
    weights *= np.float32(_SHARPNESS)
    np.exp(weights, out=weights)
    weights *= 1 / weights.sum(axis=(0, 1))
    values = np.stack([_over_pairs(weights, each) for each in smooth])
    gain = _over_pairs(weights, pairs.gain)
    own = _over_pairs(weights, pairs.own) if chosen_noise is not noise else np.float32(0)
    mean_risk = _over_pairs(weights, risk)
    more = noise - chosen_noise  # the choice takes less noise for granted than the errors do
    expected = chosen_noise * mean_risk + 2 * more * own - noise
    variance = np.maximum(expected, noise * gain)
    return _Mixture(
        box=box,
        part=part,
        bends=bends,
        data=data,
        votes=votes,
        residual=residual,
        weights=weights,
        values=values,
        raw_variance=noise,
        variance=variance,
        gain=gain,
    )


def _smooth(data: Single, *, bends: bool) -> Single:
    """Apply each pair of filters: (K, R, C) -> (K, A, B, R, C).

    Every product is of matrices no larger than the lattice: those are too small for BLAS to
    share out over threads, which costs milliseconds where other work keeps the cores busy.
    """
    count, rows, columns = data.shape
    down, along = (_axis(n, bends=bends) for n in (rows, columns))
    shape = (count, len(down.filters), len(along.filters), rows, columns)
    smooth = _scratch("smooth", shape)
    smooth[:, 0, 0] = data
    np.matmul(down.filters[1:], data[:, None], out=smooth[:, 1:, 0])
    np.matmul(smooth[:, :, :1], along.columns, out=smooth[:, :, 1:])
    return smooth


def _scratch(name: str, shape: tuple[int, ...]) -> Single:
    """Return memory of that shape, reused by this thread under that name; its content is random.

    Fresh memory costs a page fault for every 4 kB, a third of the time of the filter.
    """
    size = math.prod(shape)
    if size > _MOST_KEPT:
        return np.empty(shape, np.float32)
    kept: Single | None = vars(_kept).get(name)
    if kept is None or kept.size < size:
        kept = np.empty(size, np.float32)
        vars(_kept)[name] = kept
    return kept[:size].reshape(shape)


def _over_pairs(weights: Single, values: Single) -> Single:
    """Sum over pairs: (A, R, B, C) -> (R, C)."""
    total: Single = np.einsum("abrc,abrc->rc", weights, values)
    return total


def _filled(data: Single, votes: Bools) -> Single:
    """Return the data with predictions where there is no vote: a quadratic surface through the
    votes around, 0 where those are too few.
    """
    result = np.where(votes, data, np.float32(0))
    holes = np.argwhere(~votes)
    for reach in _FILL_REACH:
        if not len(holes):
            break
        predicted, sure = _predicted(data, votes, holes, reach)
        at = holes[sure]
        result[:, at[:, 0], at[:, 1]] = predicted[sure].T
        holes = holes[~sure]
    return result


def _predicted(
    data: Single, votes: Bools, holes: NDArray[np.int64], reach: int
) -> tuple[Array, Bools]:
    """Return (H, K) predictions for H nodes from what lies within `reach`, and whether they are
    sure."""
    offset = np.arange(-reach, reach + 1)
    r, c = (
        each.reshape(-1).astype(np.float64) for each in np.meshgrid(offset, offset, indexing="ij")
    )
    terms = np.stack([np.ones_like(r), r, c, r * r, r * c, c * c], axis=1)
    near = np.exp(-(r * r + c * c) / (2 * (reach / 2) ** 2))
    rows = holes[:, 0, None] + r.astype(np.int64) + reach
    columns = holes[:, 1, None] + c.astype(np.int64) + reach
    weight = near * np.pad(votes, reach)[rows, columns]
    padded = np.pad(data, ((0, 0), (reach, reach), (reach, reach)))
    around = padded[:, rows, columns].astype(np.float64)
    normal = np.einsum("hs,si,sj->hij", weight, terms, terms)
    right = np.einsum("hs,si,khs->hik", weight, terms, around)
    ridge = np.diag([0, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])
    sure = np.count_nonzero(weight, axis=1) >= 8
    normal[~sure] = np.eye(6)
    predicted = np.linalg.solve(normal + ridge, right)[:, 0]
    return predicted, sure
