"""The filter of a lattice: each connected part gets its own mixture of filters."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import GridError, as_numbers
from cmp_cl.filter.mixture import Mixture, mixed

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Box = tuple[slice, slice]

_OPENED = 3.0  # largest ratio of the wear of a strained print to its wear at rest


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Filtered:
    """A filtered lattice of R x C nodes with K coordinates.

    values: (R, C, K) float64, in the unit of the input, NaN where that is NaN. A rejected
        node keeps its own value.
    sigma: (R, C) float64, standard deviation of `values` per coordinate, NaN where it has too few
        neighbours.
    noise: (R, C) float64, standard deviation of the values before the filter.
    refused: (R, C) bool, the rejected nodes, which are more than REJECTED standard deviations from
        the prediction of their neighbours. They have no influence on others.
    """

    values: Array
    sigma: Array
    noise: Array
    refused: Bools
    _mixtures: "tuple[Mixture, ...]"

    def covariance_of(self, sigma: Array) -> Array:
        """Return the covariance of the coordinates of each node, (R, C, K, K) float64.

        sigma: `sigma` or `noise`. The mean of the diagonal is its square. The correlation of the
        coordinates comes from the residuals around the node. It is NaN where sigma is.
        """
        count = self.values.shape[2]
        whole = np.full((*sigma.shape, count, count), np.nan)
        for mixture in self._mixtures:
            box, part = mixture.box, mixture.part
            covariance = mixture.common * np.square(sigma[box])[..., None, None]
            whole[box] = np.where(part[..., None, None], covariance, whole[box])
        return whole

    def slope_variance(self, *, smoothed: bool) -> Array:
        """Return the variances by coordinate of the slopes per step along a row and along a column,
        (R, C, 2) float64, fitted to all 5 x 5 values around each node.

        smoothed: whether the values are the filtered ones, or those before the filter.

        Neighbours share much of their noise, so that a slope between them is more certain than
        their own sigma suggests. The noise and the weights of the filters are taken as constant
        within the window; the weights are averaged over it. It is NaN where sigma is.
        """
        whole = np.full((*self.sigma.shape, 2), np.nan)
        for mixture in self._mixtures:
            box, part = mixture.box, mixture.part & np.isfinite(self.sigma[mixture.box])
            found = mixture.slope_variance(smoothed=smoothed)
            whole[box] = np.where(part[..., None], found, whole[box])
        return whole


def filter_grid(
    values: ArrayLike,
    *,
    measured: ArrayLike | None = None,
    bends: bool = False,
    most_noise: ArrayLike | None = None,
) -> Filtered:
    """Filter a lattice over its rows and columns.

    values: (R, C, K), K >= 1 coordinates in one unit, with the same noise; a node with a NaN is
    missing. measured: (R, C) bool, the nodes that may influence others; the rest get the prediction
    of their neighbours. None means all. A deformation is filtered as one array of displacements,
    not as two of positions: wear that travels with the material cancels in their difference.
    bends: whether the values may bend sharply along an axis, as a deformation does at the edge of a
        contact. The noise is then also estimated along single directions, the axes and the
        diagonals, to tell it from such a bend. Leave it out for positions, because wear that
        neighbours share would be taken for their shape. most_noise: (R, C), an upper bound on the
        standard deviation of the noise, in the unit of the values, NaN where unknown.
        `filter_positions` takes it from the images and from the wear at rest. A residual beyond the
        bound is taken for shape and kept.

    Raises GridError if the arrays have other shapes.
    """
    given = as_numbers("values", values, GridError)
    if given.ndim != 3 or not given.shape[2]:
        raise GridError(f"values must be (R, C, K), K >= 1, not {given.shape}")
    there = functools.reduce(np.logical_and, np.isfinite(given.transpose(2, 0, 1)))
    given[~there] = np.nan
    votes = there.copy()
    if measured is not None:
        allowed = as_numbers("measured", measured, GridError).astype(np.bool_)
        if allowed.shape != there.shape:
            raise GridError(f"measured must be {there.shape}, not {allowed.shape}")
        votes &= allowed
    bound = np.full(there.shape, np.nan) if most_noise is None else most_noise
    most = as_numbers("most_noise", bound, GridError)
    if most.shape != there.shape:
        raise GridError(f"most_noise must be {there.shape}, not {most.shape}")
    sigma = np.full(there.shape, np.nan)
    noise = sigma.copy()
    refused = np.zeros(there.shape, np.bool_)
    mixtures = []
    for part in _components(votes):
        box = _box(votes & part)
        mixture, plane = _of_component(
            given[box], votes[box], part[box], most[box], box, bends=bends
        )
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
    """Filter positions at rest, see `filter_grid`.

    values, measured: as in `filter_grid`. The last few results are kept, because the frames of a
        recording share their positions at rest. The arrays of a result are read-only.
    """
    given, votes = (
        np.asarray(values, np.float64),
        as_numbers("measured", measured, GridError).astype(np.bool_),
    )
    return _at_rest(given.shape, given.tobytes(), votes.tobytes())


@functools.lru_cache(maxsize=4)
def _at_rest(shape: tuple[int, ...], values: bytes, measured: bytes) -> Filtered:
    votes = np.frombuffer(measured, np.bool_).reshape(shape[:2])
    found = filter_grid(np.frombuffer(values).reshape(shape), measured=votes)
    for array in (found.values, found.sigma, found.noise, found.refused):
        array.flags.writeable = False
    return found


def noise_of_change(
    at_rest: Filtered, own_rest: NDArray[np.floating[Any]], own_now: NDArray[np.floating[Any]]
) -> Array:
    """Return an upper bound on the standard deviation of the noise of now - rest, (R, C).

    at_rest: the filtered positions at rest. own_rest, own_now: (R, C), the standard deviations of
        the corners from their own images, NaN or 0 where unknown. The noise at rest that they do
        not explain is wear. Wear moves with the material, but strain may open it: in the difference
        it is assumed to be at most three times its size at rest. A print without wear at rest has
        only the noise of its images.
    """
    before, after = (
        np.where(own > 0, np.square(own, dtype=np.float64), np.nan) for own in (own_rest, own_now)
    )
    wear = np.maximum(np.square(at_rest.noise) - before, 0)
    most: Array = np.sqrt(before + after + _OPENED**2 * wear)
    return most


def _of_component(
    given: Array, votes: Bools, part: Bools, most: Array, box: Box, *, bends: bool
) -> "tuple[Mixture, Array]":
    """Return the mixture for the residual of the best bilinear surface, and that surface, (R, C,
    K)."""
    votes = votes & part
    plane = bilinear_surface(given, votes)
    data = np.where(votes[..., None], given - plane, 0).transpose(2, 0, 1)
    single = np.ascontiguousarray(data, np.float32)
    return mixed(single, votes, part, most.astype(np.float32), box, bends=bends), plane


def _components(votes: Bools) -> list[Bools]:
    """Return the parts of the lattice with votes, each with up to one more node around it.

    Gaps of one or two nodes do not separate parts.
    """
    if votes.all():
        return [votes] if votes.size else []
    grown = cv2.dilate(votes.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, label = cv2.connectedComponents(grown, connectivity=8)
    return [label == number for number in range(1, count)]


def _box(votes: Bools) -> Box:
    """Return the slices of the smallest rectangle with all votes."""
    rows, columns = np.nonzero(votes.any(axis=1))[0], np.nonzero(votes.any(axis=0))[0]
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


@functools.lru_cache(maxsize=64)
def _bilinear(rows: int, columns: int) -> tuple[Array, Array]:
    """Return 1, r, c and r c, from -1 to 1, orthogonal over all nodes, (R C, 4), and the projection
    of the values of all nodes on them, (4, R C)."""
    r = np.linspace(-1, 1, rows)[:, None] if rows > 1 else np.full((1, 1), 1e-9)
    c = np.linspace(-1, 1, columns)[None, :] if columns > 1 else np.full((1, 1), 1e-9)
    terms = np.stack(np.broadcast_arrays(1.0, r, c, r * c), axis=-1).reshape(-1, 4)
    return terms, np.ascontiguousarray((terms / np.square(terms).sum(axis=0)).T)


def bilinear_surface(values: Array, votes: Bools) -> Array:
    """Return the bilinear surface that fits the values best, (R, C, K).

    values: (R, C, K). votes: (R, C) bool, the nodes to fit. The filters do not change such
    surfaces; without the surface, float32 is exact enough for the residual.
    """
    rows, columns = votes.shape
    terms, projector = _bilinear(rows, columns)
    fit: Array
    if votes.all():
        fit = np.dot(projector, values.reshape(rows * columns, -1))
    else:
        fit = np.asarray(np.linalg.lstsq(terms[votes.ravel()], values[votes], rcond=None)[0], float)
    plane: Array = terms @ fit
    return plane.reshape(values.shape)
