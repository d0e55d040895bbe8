"""The strain of a filtered displacement and its covariance, node by node, in float64.

1. A plane in (column, row) is fitted to the valid nodes of the 5 x 5 around a node, at rest and
   now. A node has no strain with fewer than six of them, or if they lie on a line.
2. On a surface, Q are orthonormal axes of the tangent plane at rest, axis 1 along its first slope;
   in a plane they are x and y. F are the current slopes along them: E = (F F' - I) / 2.
3. The slope of a filtered displacement is a combination of nodes before the filter. Each node has
   the weights w_ab of the pairs of filters, times the deviation of its noise. They are replaced by
   their mean over the votes of the 5 x 5, and the 5 x 5 by all of it that lies inside the lattice:
   the slope weighs all nodes, by the mean along one axis and the slope of a line along the other.
   The variance of its noise is the sum of the products of these weights over all pairs of nodes,
   times their correlation. The coordinates covary as the residuals of the votes around do. The bias
   of smoothing shows in how far apart the pairs are: half the covariance of their slopes, under the
   weights of the node in the middle, is added.
4. Neighbours in a column correlate by a, those in a row by b. Let r be the second differences along
   rows of the second differences along columns, over the deviation of the noise, where all nine
   nodes have votes. For noise of variance v, the mean of r r is (36 - 48 a - 48 b) v, that of r and
   the r of the next row (42 a + 32 b - 24) v, of the next column (32 a + 42 b - 24) v. a and b are
   clipped to 0 and 1/4.
5. Where nodes of the 5 x 5 are missing, the variance grows as that of the slope of independent
   errors does. A slope whose variance is unknown has that of independent errors.
6. To first order dE = sym(F' dG + (F - (2 E + I) Q)' dA), with dG and dA the errors of the slopes
   of the displacement and of the position at rest along Q; on a surface the turn of axis 1 by
   Q2 . dA1 comes on top. The errors of different axes of the lattice are independent; those of the
   coordinates correlate as their covariance says.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH = 2
MOST_SHARED = 0.25


def shared(data: Floats, votes: Bools, variance: Floats) -> tuple[float, float]:
    """Return a and b, see 4. data: (R, C, K). variance: (R, C), of the noise."""
    second = np.array([1.0, -2.0, 1.0])
    rough: dict[tuple[int, int], Floats] = {}
    for r, c in itertools.product(*(range(1, n - 1) for n in votes.shape)):
        box = np.s_[r - 1 : r + 2, c - 1 : c + 2]
        if votes[box].all():
            rough[r, c] = np.einsum("i,j,ijk->k", second, second, data[box]) / np.sqrt(
                variance[r, c]
            )
    means = []
    for down, along in ((0, 0), (1, 0), (0, 1)):
        products = [
            r * rough[i + down, j + along]
            for (i, j), r in rough.items()
            if (i + down, j + along) in rough
        ]
        if not products:
            return 0.0, 0.0
        means.append(np.mean(products))
    v, of_rows, of_columns = np.linalg.solve(
        [[36, -48, -48], [-24, 42, 32], [-24, 32, 42]], np.array(means)
    )
    if v <= 0:
        return 0.0, 0.0
    return float(np.clip(of_rows / v, 0, MOST_SHARED)), float(
        np.clip(of_columns / v, 0, MOST_SHARED)
    )


def slope_covariances(
    weights: Floats,
    size: Floats,
    votes: Bools,
    filters: tuple[Floats, Floats],
    correlations: tuple[float, float],
    estimates: Floats,
    common: Floats,
) -> Floats:
    """Return the covariances of the slopes by column and by row, (R, C, 2, K, K), over windows
    without a hole.

    weights: (A, B, R, C). size: (R, C), the deviation of the noise. filters: (A, R, R) and (B, C,
    C). correlations: a and b of 4. estimates: (A, B, R, C, K). common: (R, C, K, K), the covariance
    of the noise over its mean diagonal.
    """
    shape = votes.shape
    found = np.full((*shape, 2, *common.shape[2:]), np.nan)
    votes = votes & np.isfinite(size)
    scaled = np.where(votes, weights * size, 0)
    together = [
        np.eye(n) + part * (np.eye(n, k=1) + np.eye(n, k=-1))
        for n, part in zip(shape, correlations, strict=True)
    ]
    for r, c in np.ndindex(*shape):
        rows, columns = (_window(i, n) for i, n in zip((r, c), shape, strict=True))
        count = np.count_nonzero(votes[np.ix_(rows, columns)])
        if not count:
            continue
        mean = scaled[:, :, rows][..., columns].sum(axis=(2, 3)) / count
        down, along = filters[0][:, rows], filters[1][:, columns]
        (mean_down, line_down), (mean_along, line_along) = (
            _mean_and_line(down),
            _mean_and_line(along),
        )
        near = estimates[:, :, rows][:, :, :, columns]
        for step, (one, two) in enumerate(((mean_down, line_along), (line_down, mean_along))):
            slope = np.einsum("ab,ai,bj->ij", mean, one, two)
            variance = (slope * (together[0] @ slope @ together[1])).sum()
            spread = _spread(weights[:, :, r, c], near, 3 - step)
            found[r, c, step] = variance * common[r, c] + spread / 2
    return found


def _window(i: int, n: int) -> NDArray[np.intp]:
    return np.arange(max(i - REACH, 0), min(i + REACH + 1, n))


def _spread(weights: Floats, near: Floats, axis: int) -> Floats:
    """Return the covariance (K, K) of the slopes along an axis of windows (A, B, S, T, K) under
    weights (A, B)."""
    lines = near.mean(axis=5 - axis)  # (A, B, n, K)
    off = np.arange(lines.shape[2]) - (lines.shape[2] - 1) / 2
    slopes = np.einsum("n,abnk->abk", off, lines) / max(np.square(off).sum(), 1)
    apart = slopes - np.einsum("ab,abk->k", weights, slopes)
    return np.asarray(np.einsum("ab,abj,abk->jk", weights, apart, apart))


def _mean_and_line(rows: Floats) -> tuple[Floats, Floats]:
    """Return the mean and the slope over axis 1 of (A, S, n)."""
    off = np.arange(rows.shape[1]) - (rows.shape[1] - 1) / 2
    return rows.mean(axis=1), np.einsum("s,asn->an", off, rows) / max(np.square(off).sum(), 1)


def strain(
    rest: Floats,
    displacement: Floats,
    covariances: tuple[Floats, Floats],
    slopes: tuple[Floats, Floats],
) -> tuple[Floats, Floats]:
    """Return E11 E22 E12 (R, C, 3), and their covariance, (R, C, 3, 3).

    rest, displacement: (R, C, D). covariances: (R, C, D, D), of rest and displacement. slopes: the
    same by column and by row of whole windows, (R, C, 2, D, D), NaN where unknown.
    """
    shape, size = rest.shape[:2], rest.shape[2]
    valid = np.isfinite(displacement[..., 0])
    found, covariance = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    for r, c in zip(*np.nonzero(valid), strict=True):
        whole = list(
            itertools.product(*(_window(i, n) for i, n in zip((r, c), shape, strict=True)))
        )
        near = [node for node in whole if valid[node]]
        of_whole, of_near = (
            np.array([(1.0, j - c, i - r) for i, j in each]) for each in (whole, near)
        )
        if len(near) < 6 or np.linalg.matrix_rank(of_near) < 3:
            continue
        fit = np.linalg.pinv(of_near)[1:]
        own = np.square(fit).sum(axis=1)
        more = own / np.square(np.linalg.pinv(of_whole)[1:]).sum(axis=1)
        a = fit @ np.array([rest[node] for node in near])
        b = a + fit @ np.array([displacement[node] for node in near])
        inverse = np.linalg.inv(a if size == 2 else np.linalg.cholesky(a @ a.T))
        q, f = inverse @ a, inverse @ b
        e = (f @ f.T - np.eye(2)) / 2
        found[r, c] = e[0, 0], e[1, 1], e[0, 1]
        # Derivatives of E11, E22, E12 by the slopes along both axes, at rest and now.
        off, none = f - (2 * e + np.eye(2)) @ q, np.zeros(size)
        turned = q[1] if size == 3 else none
        now = [(f[0], none), (none, f[1]), (f[1] / 2, f[0] / 2)]
        before = [
            (off[0] + 2 * e[0, 1] * turned, none),
            (-2 * e[0, 1] * turned, off[1]),
            (off[1] / 2 + (e[1, 1] - e[0, 0]) * turned, off[0] / 2),
        ]
        total = np.zeros((3, 3))
        for gradients, of_values, of_slopes in zip((before, now), covariances, slopes, strict=True):
            by_step = np.array([inverse.T @ np.array(each) for each in gradients])  # (3, 2, D)
            for k, slope in enumerate(of_slopes[r, c]):
                step = own[k] * of_values[r, c] if np.isnan(slope).any() else more[k] * slope
                total += by_step[:, k] @ step @ by_step[:, k].T
        covariance[r, c] = total
    return found, covariance
