"""The strain of a filtered displacement and its standard deviation, node by node, in float64.

1. A plane in (column, row) is fitted to the valid nodes of the 5 x 5 around a node, at rest and
   now. A node has no strain with fewer than six of them, or if they lie on a line.
2. Q are orthonormal axes of the tangent plane at rest, axis 1 along its first slope, and F the
   current slopes along them: E = (F F' - I) / 2.
3. The slope of a filtered displacement is a combination of nodes before the filter. Each node has
   the weights w_ab of the pairs of filters, times the root of its variance over its gain. They are
   replaced by their mean over the valid nodes of the 5 x 5, and the 5 x 5 by all of them that lie
   inside the lattice: the variance of the slope is the sum of the squares of the weights of all
   nodes, for the mean along one axis and the slope of a line along the other.
4. To first order dE = sym(F' dG + (F - (2 E + I) Q)' dA) plus the turn of axis 1 by Q2 . dA1, with
   dG and dA the errors of the slopes of the displacement and of the position at rest along Q. The
   errors of different axes of the lattice are independent; those of the coordinates correlate as
   their covariance says.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH = 2


def slope_variances(
    weights: Floats, size: Floats, valid: Bools, filters: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return the variances of the slopes by column and by row, (R, C).

    weights: (A, B, R, C). size: (R, C), the root of the variance over the gain. filters: (A, R, R)
    and (B, C, C).
    """
    shape = valid.shape
    by_column, by_row = np.full(shape, np.nan), np.full(shape, np.nan)
    scaled = np.where(valid, weights * size, 0)
    for r, c in zip(*np.nonzero(valid), strict=True):
        rows, columns = (_window(i, n) for i, n in zip((r, c), shape, strict=True))
        box = np.ix_(rows, columns)
        mean = scaled[:, :, rows][..., columns].sum(axis=(2, 3)) / np.count_nonzero(valid[box])
        down, along = filters[0][:, rows], filters[1][:, columns]
        (mean_down, line_down), (mean_along, line_along) = (
            _mean_and_line(down),
            _mean_and_line(along),
        )
        for result, one, two in (
            (by_column, mean_down, line_along),
            (by_row, line_down, mean_along),
        ):
            result[r, c] = np.square(np.einsum("ab,ai,bj->ij", mean, one, two)).sum()
    return by_column, by_row


def _window(i: int, n: int) -> NDArray[np.intp]:
    return np.arange(max(i - REACH, 0), min(i + REACH + 1, n))


def _mean_and_line(rows: Floats) -> tuple[Floats, Floats]:
    """Return the mean and the slope over axis 1 of (A, S, n)."""
    off = np.arange(rows.shape[1]) - (rows.shape[1] - 1) / 2
    return rows.mean(axis=1), np.einsum("s,asn->an", off, rows) / max(np.square(off).sum(), 1)


def strain(
    rest: Floats,
    displacement: Floats,
    covariances: tuple[Floats, Floats],
    slopes: tuple[tuple[Floats, Floats], tuple[Floats, Floats]],
) -> tuple[Floats, Floats]:
    """Return E11 E22 E12 (R, C, 3), and their standard deviations.

    rest, displacement: (R, C, 3). covariances: (R, C, 3, 3), of rest and displacement. slopes: of
    rest and displacement, the variances by column and by row.
    """
    shape = rest.shape[:2]
    valid = np.isfinite(displacement[..., 0])
    found, deviation = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
    for r, c in zip(*np.nonzero(valid), strict=True):
        near = [
            node
            for node in itertools.product(
                *(_window(i, n) for i, n in zip((r, c), shape, strict=True))
            )
            if valid[node]
        ]
        terms = np.array([(1.0, j - c, i - r) for i, j in near])
        if len(near) < 6 or np.linalg.matrix_rank(terms) < 3:
            continue
        fit = np.linalg.pinv(terms)[1:]
        a = fit @ np.array([rest[node] for node in near])
        b = a + fit @ np.array([displacement[node] for node in near])
        inverse = np.linalg.inv(np.linalg.cholesky(a @ a.T))
        q, f = inverse @ a, inverse @ b
        e = (f @ f.T - np.eye(2)) / 2
        found[r, c] = e[0, 0], e[1, 1], e[0, 1]
        # Derivatives of E11, E22, E12 by the slopes along both axes, at rest and now.
        off, none = f - (2 * e + np.eye(2)) @ q, np.zeros(3)
        turned = q[1]
        now = [(f[0], none), (none, f[1]), (f[1] / 2, f[0] / 2)]
        before = [
            (off[0] + 2 * e[0, 1] * turned, none),
            (-2 * e[0, 1] * turned, off[1]),
            (off[1] / 2 + (e[1, 1] - e[0, 0]) * turned, off[0] / 2),
        ]
        for k in range(3):
            variance = 0.0
            for gradient, covariance, (by_column, by_row) in zip(
                (before[k], now[k]), covariances, slopes, strict=True
            ):
                alike = covariance[r, c] * 3 / np.trace(covariance[r, c])
                steps = np.diag([by_column[r, c], by_row[r, c]])
                by_step = inverse.T @ np.array(gradient)
                variance += np.trace(by_step @ alike @ by_step.T @ steps)
            deviation[r, c, k] = np.sqrt(variance)
    return found, deviation
