"""The tables of the filter's kernels, for lattices of one shape."""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter import STRAIN_REACH, polynomial

Array = NDArray[np.float64]
Single = NDArray[np.float32]

FILTERS = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # half width in nodes, degree
TAPS = 15  # of the widest filter, as in kernels/filter.cl
LANES = 8  # numbers of a vector, as in kernels/field.clh
NOISE_NODES, RISK_NODES = 10, 8  # nodes on each side in the Gaussian means, as there
_NOISE_REACH = 2.0  # nodes, standard deviation of the Gaussian that averages the noise
_RISK_REACH = 1.5  # nodes, standard deviation of the Gaussian that averages the risk


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AxisTables:
    """The tables along an axis of n nodes with F filters.

    sides: (F,) int32, the nodes on each side in their windows. filters: (F, n, TAPS), the weights
    in the window of each node; the first filter changes nothing. matrices: (F, n, n), the weight of
    each node in the values of all. own, gain: (F, n), of the node itself, and the sum of the
    squares. pilot, pilot_matrix, pilot_own, pilot_side: the same for the filter that shows the
    noise. bend: (n, 3, S), the weights of the value of the line and of the first and second
    derivative of the parabola fitted to S nodes.
    span: (2, n, W), the weights of the W nodes of the window of a strain in their mean, and in the
    slope of the line fitted to them, 0 beyond the axis.
    gram_mean: (2, n, F, F), the products of the weights of the nodes behind this mean of what each
    filter gives: of a node with itself, and with its two neighbours. gram_slope: the same for the
    slope.
    """

    sides: NDArray[np.int32]
    filters: Single
    matrices: Single
    own: Single
    gain: Single
    pilot: Single
    pilot_matrix: Single
    pilot_own: Single
    pilot_side: int
    bend: Single
    span: Single
    gram_mean: Single
    gram_slope: Single


@functools.lru_cache(maxsize=16)
def axis_tables(n: int) -> AxisTables:
    """Return the tables along an axis of n nodes."""
    fitting = [(side, degree) for side, degree in FILTERS if n >= 2 * side + 1]
    filters = np.stack([polynomial(n, *each) for each in fitting])
    pilot_side, pilot_degree = (3, 5) if n >= 8 else (2, 3) if n >= 5 else (0, 0)
    pilot = polynomial(n, pilot_side, pilot_degree)
    bend_side = min(2, (n - 1) // 2)
    bend = np.zeros((n, 3, 2 * bend_side + 1), np.float32)
    if bend_side:
        for order, (degree, derivative) in enumerate(((1, 0), (2, 1), (2, 2))):
            bend[:, order] = _windows(polynomial(n, bend_side, degree, derivative), bend_side)
    span = _spans(n)
    gram_mean, gram_slope = (_gram(each, filters) for each in span)
    return AxisTables(
        sides=np.array([side for side, _ in fitting], np.int32),
        filters=np.stack(
            [_windows(one, side, TAPS) for one, (side, _) in zip(filters, fitting, strict=True)]
        ),
        matrices=filters.transpose(0, 2, 1).astype(np.float32),
        own=np.diagonal(filters, axis1=1, axis2=2).astype(np.float32),
        gain=np.square(filters).sum(axis=2).astype(np.float32),
        pilot=_windows(pilot, pilot_side, TAPS),
        pilot_matrix=pilot.T.astype(np.float32),
        pilot_own=np.diag(pilot).astype(np.float32),
        pilot_side=pilot_side,
        bend=bend,
        span=np.stack([_around(each) for each in span]),
        gram_mean=gram_mean,
        gram_slope=gram_slope,
    )


def _spans(n: int) -> Array:
    """Return the weights of all nodes in the mean of the window of a strain around each node, and
    in the slope of the line fitted to it, (2, n, n). Windows are cut at the ends."""
    spans = np.zeros((2, n, n))
    for node in range(n):
        window = np.arange(max(node - STRAIN_REACH, 0), min(node + STRAIN_REACH + 1, n))
        offset = window - window.mean()
        spans[0, node, window] = 1 / len(window)
        spans[1, node, window] = offset / max(np.square(offset).sum(), 1)
    return spans


def _around(span: Array) -> Single:
    """Return the weights (n, n) of the nodes from STRAIN_REACH before each to as many behind."""
    padded = np.pad(span, [(0, 0), (STRAIN_REACH, STRAIN_REACH)])
    wide = 2 * STRAIN_REACH + 1
    return np.stack([row[i : i + wide] for i, row in enumerate(padded)]).astype(np.float32)


def _gram(span: Array, filters: Array) -> Single:
    """Return `gram_mean` or `gram_slope` of filters (F, n, n)."""
    n = len(span)
    apart = np.abs(np.arange(n)[:, None] - np.arange(n))
    weights = np.einsum("iw,awj->iaj", span, filters)
    products = [weights @ (apart == lag) @ weights.transpose(0, 2, 1) for lag in (0, 1)]
    return np.stack(products).astype(np.float32)


def _gaussian(deviation: float, reach: int) -> Single:
    """Return Gaussian weights (2 reach + 1,) of sum 1; deviation: in nodes."""
    weights = np.exp(-np.square(np.arange(-reach, reach + 1) / deviation) / 2)
    single: Single = (weights / weights.sum()).astype(np.float32)
    return single


NOISE_GAUSSIAN = _gaussian(_NOISE_REACH, NOISE_NODES)
RISK_GAUSSIAN = _gaussian(_RISK_REACH, RISK_NODES)


def in_lines(rows: Single) -> Single:
    """Return rows (..., n) with zeros behind them, up to a whole number of vectors."""
    missing = -rows.shape[-1] % LANES
    return np.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, missing)])


def _windows(matrix: Array, side: int, taps: int | None = None) -> Single:
    """Return the weights of each row of a matrix (n, n) within its window, (n, taps)."""
    n, size = len(matrix), 2 * side + 1
    first = np.clip(np.arange(n) - side, 0, n - size)
    found = np.zeros((n, taps or size), np.float32)
    found[:, :size] = np.take_along_axis(matrix, first[:, None] + np.arange(size), axis=1)
    return found
