"""The tables of the field's kernels, for lattices of one shape."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.polynomials import (
    BENDING_FILTERS,
    NOISE_REACH,
    RISK_REACH,
    Grams,
    axis_of,
    grams_of,
    polynomial,
)

Single = NDArray[np.float32]

TAPS = 15  # of the widest filter, as in kernels/filter.cl
LANES = 8  # numbers of a vector, as in kernels/field.clh
NOISE_NODES, RISK_NODES = 10, 8  # nodes on each side in the Gaussian means, as there


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class AxisTables:
    """The tables along an axis of n nodes with F filters.

    sides: (F,) int32, the nodes on each side in their windows. filters: (F, n, TAPS), the weights
    in the window of each node. matrices: (F, n, n), the weight of each node in the values of all.
    own, gain: (F, n), of the node itself, and the sum of the squares.
    pilot, pilot_matrix, pilot_own, pilot_side: the same for the pilot. bend: (n, 3, S), the weights
    of the value of the line and of the first and second derivative of the parabola fitted to S
    nodes.
    grams: the products of the filters behind the mean and the slope of the window of a strain.
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
    grams: Grams


def axis_tables(n: int) -> AxisTables:
    """Return the tables along an axis of n nodes."""
    axis = axis_of(n, bends=True)
    sides = [side for side, _ in BENDING_FILTERS if n >= 2 * side + 1]
    pilot_side = 3 if n >= 8 else 2 if n >= 5 else 0
    bend_side = min(2, (n - 1) // 2)
    bend = np.zeros((n, 3, 2 * bend_side + 1), np.float32)
    if bend_side:
        for order, (degree, derivative) in enumerate(((1, 0), (2, 1), (2, 2))):
            bend[:, order] = _windows(polynomial(n, bend_side, degree, derivative), bend_side)
    return AxisTables(
        sides=np.array(sides, np.int32),
        filters=np.stack(
            [_windows(one, side, TAPS) for one, side in zip(axis.filters, sides, strict=True)]
        ),
        matrices=axis.filters.transpose(0, 2, 1),
        own=axis.own,
        gain=axis.gain,
        pilot=_windows(axis.pilot, pilot_side, TAPS),
        pilot_matrix=axis.pilot.T,
        pilot_own=axis.pilot_own,
        pilot_side=pilot_side,
        bend=bend,
        grams=grams_of(n, bends=True),
    )


def gaussian(deviation: float, reach: int) -> Single:
    """Return Gaussian weights (2 reach + 1,) of sum 1; deviation: in nodes."""
    weights = np.exp(-np.square(np.arange(-reach, reach + 1) / deviation) / 2)
    single: Single = (weights / weights.sum()).astype(np.float32)
    return single


NOISE_GAUSSIAN = gaussian(NOISE_REACH, NOISE_NODES)
RISK_GAUSSIAN = gaussian(RISK_REACH, RISK_NODES)


def in_lines(rows: Single) -> Single:
    """Return rows (..., n) with zeros behind them, up to a whole number of vectors."""
    missing = -rows.shape[-1] % LANES
    return np.pad(rows, [(0, 0)] * (rows.ndim - 1) + [(0, missing)])


def _windows(matrix: NDArray[np.floating], side: int, taps: int | None = None) -> Single:
    """Return the weights of each row of a matrix (n, n) within its window, (n, taps)."""
    n, size = len(matrix), 2 * side + 1
    first = np.clip(np.arange(n) - side, 0, n - size)
    found = np.zeros((n, taps or size), np.float32)
    found[:, :size] = np.take_along_axis(matrix, first[:, None] + np.arange(size), axis=1)
    return found
