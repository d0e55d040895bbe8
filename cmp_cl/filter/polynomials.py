"""The filters along one axis of a lattice: local polynomials, as matrices."""

import dataclasses
import functools
import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]

AXIS_FILTERS = ((0, 0), (2, 1), (2, 3), (4, 3), (7, 3))  # half width in nodes, degree
BENDING_FILTERS = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # for sharply bent values
LEAST_SUPPORT = 0.75  # least share of a window's nodes that are measured
NOISE_REACH = 2.0  # nodes, standard deviation of the Gaussian that averages the noise
STRAIN_REACH = 2  # nodes on each side of a node to which the planes of a strain are fitted
RISK_REACH = 1.5  # nodes, standard deviation of the Gaussian that averages the risk


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """The filters along an axis of n nodes, A of them.

    filters: (A, n, n) float32, a row per node; the first one changes nothing. own: (A, n), the
        weight of the node itself. gain: (A, n), the sum of the squared weights. share: (A, n, n), 1
        / window inside the window, 0 outside. pilot, pilot_own, pilot_share: the same for the
        filter that shows the noise. near_noise, near_risk: (n, n) Gaussians, rows of sum 1.
        columns: (A - 1, n, n), the filters after the first one as factors on the right.
        pilot_columns, noise_columns, risk_columns: the same for the pilot and the Gaussians. A
        product takes half the time if its factor lies in memory in the order in which it is read.
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
    pilot_columns: Single
    noise_columns: Single
    risk_columns: Single


def polynomial(n: int, half: int, degree: int, order: int = 0) -> Array:
    """Return the matrix (n, n) of the value at each node of the polynomial fitted to its window.

    half: half width of the window, nodes; it is moved inwards at the ends. degree: of the
        polynomial.
    order: the derivative to take, 0 for the value.
    """
    whole = np.zeros((n, n))
    for node in range(n):
        first = min(max(node - half, 0), n - 2 * half - 1)
        window = np.arange(first, first + 2 * half + 1)
        powers = (window - node)[:, None].astype(np.float64) ** np.arange(degree + 1)
        whole[node, window] = math.factorial(order) * np.linalg.pinv(powers)[order]
    return whole


def _gaussian(n: int, deviation: float) -> Single:
    """Return (n, n): Gaussian weights of all nodes around each node, rows of sum 1."""
    apart = np.arange(n)[:, None] - np.arange(n)
    weights = np.exp(-np.square(apart / deviation) / 2)
    rows: Single = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    return rows


@functools.lru_cache(maxsize=64)
def axis_of(n: int, *, bends: bool = False) -> Axis:
    """Return the filters along n nodes whose windows fit; bends: see `filter_grid`."""
    usual = BENDING_FILTERS if bends else AXIS_FILTERS
    fitting = [(half, degree) for half, degree in usual if n >= 2 * half + 1]
    filters = np.stack([polynomial(n, *each) for each in fitting])
    pilot = polynomial(n, *((3, 5) if n >= 8 else (2, 3) if n >= 5 else (0, 0)))
    windows = [np.not_equal(each, 0) | np.eye(n, dtype=np.bool_) for each in [*filters, pilot]]
    share = np.stack([each / each.sum(axis=1, keepdims=True) for each in windows])

    def single(values: Array | Single) -> Single:
        return np.ascontiguousarray(values, np.float32)

    near_noise, near_risk = _gaussian(n, NOISE_REACH), _gaussian(n, RISK_REACH)
    return Axis(
        filters=single(filters),
        columns=single(filters[1:].transpose(0, 2, 1)),
        own=single(np.diagonal(filters, axis1=1, axis2=2)),
        gain=single(np.square(filters).sum(axis=2)),
        share=single(share[:-1]),
        pilot=single(pilot),
        pilot_own=single(np.diag(pilot)),
        pilot_share=single(share[-1]),
        near_noise=near_noise,
        near_risk=near_risk,
        pilot_columns=single(pilot.T),
        noise_columns=single(near_noise.T),
        risk_columns=single(near_risk.T),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Pairs:
    """The weights of each pair of filters: one along the columns (A), one along the rows (B).

    own, gain: (A, B, R, C), as in `Axis`. pilot_own: (R, C).
    """

    own: Single
    gain: Single
    pilot_own: Single


@functools.lru_cache(maxsize=64)
def pairs_of(rows: int, columns: int, *, bends: bool = False) -> Pairs:
    """Return the weights of all pairs of filters on a lattice of rows x columns nodes."""
    down, along = axis_of(rows, bends=bends), axis_of(columns, bends=bends)
    return Pairs(
        own=down.own[:, None, :, None] * along.own[:, None],
        gain=down.gain[:, None, :, None] * along.gain[:, None],
        pilot_own=np.outer(down.pilot_own, along.pilot_own),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Grams:
    """What the filters of an axis have in common over the window of a strain around each node.

    mean: (2, n, A, A), the products of the weights of the nodes behind the mean over the window of
        what each filter gives: of a node with itself, and with its two neighbours. slope: the same
        for the slope of a line fitted to the window.
    """

    mean: Array
    slope: Array

    def of_noise(self, shared: float) -> tuple[Array, Array]:
        """Return those of the mean and of the slope, (n, A, A), for noise of variance 1.

        shared: the correlation of the noise of neighbours.
        """
        return self.mean[0] + shared * self.mean[1], self.slope[0] + shared * self.slope[1]


@functools.lru_cache(maxsize=64)
def grams_of(n: int, *, bends: bool) -> Grams:
    """Return the products of the filters along n nodes. Windows are cut at the ends."""
    filters = axis_of(n, bends=bends).filters.astype(np.float64)
    mean, slope = np.zeros((2, n, n))
    for node in range(n):
        window = np.arange(max(node - STRAIN_REACH, 0), min(node + STRAIN_REACH + 1, n))
        offset = window - window.mean()
        mean[node, window] = 1 / len(window)
        slope[node, window] = offset / max(np.square(offset).sum(), 1)
    apart = np.abs(np.arange(n)[:, None] - np.arange(n))
    found = []
    for over_window in (mean, slope):
        weights = np.einsum("iw,awj->iaj", over_window, filters)
        found.append(
            np.stack([weights @ (apart == lag) @ weights.transpose(0, 2, 1) for lag in (0, 1)])
        )
    return Grams(*found)


def window_mean(values: Array | Single, valid: Bools) -> Array:
    """Return the means of values (..., R, C) over the valid nodes of the window of a strain around
    each node, NaN without any."""
    down, along = (
        (np.abs(np.arange(n)[:, None] - np.arange(n)) <= STRAIN_REACH).astype(np.float64)
        for n in valid.shape
    )
    sums = down @ np.where(valid, values, 0) @ along.T
    count = down @ valid.astype(np.float64) @ along.T
    mean: Array = sums / np.where(count > 0, count, np.nan)
    return mean
