"""The tables of the filter's kernels, for lattices of one shape."""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from cmp_cl.fits import bend_half, derivatives, polynomial

Array = NDArray[np.float64]
Single = NDArray[np.float32]

FILTERS = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # half width in nodes, degree
LANES = 8  # numbers of a vector, as in kernels/field.clh
NOISE_NODES, RISK_NODES = 10, 8  # nodes on each side in the Gaussian means, as there
_NOISE_REACH = 2.0  # nodes, standard deviation of the Gaussian that averages the noise
_RISK_REACH = 1.5  # nodes, standard deviation of the Gaussian that averages the risk


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AxisTables:
    """The tables along an axis of n nodes with F filters.

    sides: (F,) int32, the nodes on each side in their windows. filters: (F, n, n), the weight of
    each node in the values of all; the first filter changes nothing. own, gain: (F, n), the weight
    of a node in its own value, and the sum of the squares of all in it. pilot, pilot_own,
    pilot_side: the same for the filter that shows the noise. bend: (n, 3, S), the weights of the
    value of the line and of the first and second derivative of the parabola fitted to S nodes.
    """

    sides: NDArray[np.int32]
    filters: Single
    own: Single
    gain: Single
    pilot: Single
    pilot_own: Single
    pilot_side: int
    bend: Single


@functools.lru_cache(maxsize=16)
def axis_tables(n: int) -> AxisTables:
    """Return the tables along an axis of n nodes."""
    fitting = [(side, degree) for side, degree in FILTERS if n >= 2 * side + 1]
    filters = np.stack([polynomial(n, *each) for each in fitting])
    pilot_side, pilot_degree = (3, 5) if n >= 8 else (2, 3) if n >= 5 else (0, 0)
    pilot = polynomial(n, pilot_side, pilot_degree)
    return AxisTables(
        sides=np.array([side for side, _ in fitting], np.int32),
        filters=filters.transpose(0, 2, 1).astype(np.float32),
        own=np.diagonal(filters, axis1=1, axis2=2).astype(np.float32),
        gain=np.square(filters).sum(axis=2).astype(np.float32),
        pilot=pilot.T.astype(np.float32),
        pilot_own=np.diag(pilot).astype(np.float32),
        pilot_side=pilot_side,
        bend=np.stack([_windows(each, bend_half(n)) for each in derivatives(n)], axis=1),
    )


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


def _windows(matrix: Array, side: int) -> Single:
    """Return the weights of each row of a matrix (n, n) within its window, (n, 2 side + 1)."""
    n, size = len(matrix), 2 * side + 1
    first = np.clip(np.arange(n) - side, 0, n - size)
    window = first[:, None] + np.arange(size)
    return np.take_along_axis(matrix, window, axis=1).astype(np.float32)
