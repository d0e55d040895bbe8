"""The filter of a lattice: each connected part gets a mixture of its own."""

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import GridError
from cmp_cl.grid.filter.mixture import Mixture, mixed

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Box = tuple[slice, slice]

_OPENED = 3.0  # times, at most, that strain makes wear larger than it is at rest


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Filtered:
    """A filtered lattice of R x C nodes with K coordinates.

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
    _mixtures: "tuple[Mixture, ...]"

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
            covariance = mixture.common * np.square(sigma[box])[..., None, None]
            whole[box] = np.where(part[..., None, None], covariance, whole[box])
        return whole

    def deviation_of(self, stencil: ArrayLike) -> Array:
        """Return (R, C) float64: the standard deviation of a linear combination around each node.

        stencil: (R, C, S, S), S odd, the weights of the filtered neighbours, the node itself in
        the middle; weights of what lies beyond the lattice or is NaN must be 0. Neighbours
        share much of their noise: a slope between them is more certain than their own sigma
        says. NaN where sigma is. Raises GridError if the stencil has another shape.
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
    values: ArrayLike,
    *,
    measured: ArrayLike | None = None,
    bends: bool = False,
    most_noise: ArrayLike | None = None,
) -> Filtered:
    """Filter a lattice over its rows and columns.

    values: (R, C, K), K >= 1 coordinates in one unit and of like noise; a node with a NaN is
    missing. measured: (R, C) bool, the nodes that others may rely on; the rest get what their
    neighbours predict. None means all. A deformation is filtered as one array of displacements,
    not as two of positions: wear that travels with the material cancels in their difference.
    bends: the values may bend sharply along an axis, as a deformation does at the edge of what
    presses. What bends is then told from noise by looking along one direction alone, too: an
    axis or a diagonal. Leave it out for positions: wear that neighbours share would be taken
    for the shape. most_noise: (R, C), the largest standard deviation of the noise that can be, in
    the unit of the values, NaN where nobody knows, as `filter_positions` knows it from the images
    and from the wear at rest. What is more than that is shape, and is kept.

    Raises GridError if the arrays have other shapes.
    """
    given = np.array(values, np.float64)
    if given.ndim != 3 or not given.shape[2]:
        raise GridError(f"values must be (R, C, K), K >= 1, not {given.shape}")
    there = functools.reduce(np.logical_and, np.isfinite(given.transpose(2, 0, 1)))
    given[~there] = np.nan
    votes = there.copy()
    if measured is not None:
        allowed = np.asarray(measured, np.bool_)
        if allowed.shape != there.shape:
            raise GridError(f"measured must be {there.shape}, not {allowed.shape}")
        votes &= allowed
    most = np.full(there.shape, np.nan) if most_noise is None else np.asarray(most_noise, float)
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

    The results of the last few are kept: the frames of a film share their positions at rest. The
    arrays of a result are read-only.
    """
    given, votes = np.asarray(values, np.float64), np.asarray(measured, np.bool_)
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
    """Return the largest standard deviation (R, C) that the noise of now - rest can have.

    at_rest: the positions at rest. own_rest, own_now: (R, C), the standard deviations that the
    corners' own images tell, NaN or 0 where unknown. What they do not explain of the noise at rest
    is wear. Wear travels with the material, but strain may open it: in the difference it counts for
    at most three times what it is at rest. A print that shows no wear at rest has the noise of its
    images alone.
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
    """Return the mixture for the residual of the best bilinear surface; the surface, (R, C, K)."""
    votes = votes & part
    plane = bilinear_surface(given, votes)
    data = np.where(votes[..., None], given - plane, 0).transpose(2, 0, 1)
    single = np.ascontiguousarray(data, np.float32)
    return mixed(single, votes, part, most.astype(np.float32), box, bends=bends), plane


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
def _bilinear(rows: int, columns: int) -> tuple[Array, Array]:
    """Return 1, r, c and r c, from -1 to 1, orthogonal over all nodes, (R C, 4), and what projects
    values of all nodes on them, (4, R C).
    """
    r = np.linspace(-1, 1, rows)[:, None] if rows > 1 else np.full((1, 1), 1e-9)
    c = np.linspace(-1, 1, columns)[None, :] if columns > 1 else np.full((1, 1), 1e-9)
    terms = np.stack(np.broadcast_arrays(1.0, r, c, r * c), axis=-1).reshape(-1, 4)
    return terms, np.ascontiguousarray((terms / np.square(terms).sum(axis=0)).T)


def bilinear_surface(values: Array, votes: Bools) -> Array:
    """Return (R, C, K): the bilinear surface that fits best. The filters leave such surfaces as
    they are; without it float32 is exact enough for the residual.
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
