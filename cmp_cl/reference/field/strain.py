"""The strain of a filtered displacement and its covariance, node by node, in float64.

1. A surface in (column, row) is fitted to the nodes around a node, at rest and now, and has slopes
   at the node. In the middle of 5 x 5 nodes it is a cubic one. Else it is a quadratic one of 3 x 3;
   if one of the nine is missing, of the valid ones of 5 x 5, 3 on lines of three or four nodes. At
   a border windows are moved inwards. A node has no strain if these nodes do not determine the
   surface, or if errors of variance 1 give a slope of a variance of more than 10.
2. On a surface, Q are orthonormal axes of the tangent plane at rest, axis 1 along its first slope;
   in a plane they are x and y. F are the current slopes along them: E = (F F' - I) / 2.
3. The slope of a filtered displacement is a combination of nodes before the filter. Each node has
   the weights w_ab of the pairs of filters, times the deviation of its noise. They are replaced by
   their mean over the votes of the 3 x 3, of which all nodes count: the slope weighs them by the
   value of a line at the node along one axis and the slope of a parabola along the other. The
   variance of its noise is the sum of the products of these weights over all pairs of nodes, times
   their correlation, times 1.15, since the weights were chosen by the noise that they average. The
   coordinates covary as the residuals of the votes around do.
4. Neighbours in a column correlate by a, those in a row by b. Let r be the second differences along
   rows of the second differences along columns, over the deviation of the noise, where all nine
   nodes have votes. For noise of variance v, the mean of r r is (36 - 48 a - 48 b) v, that of r and
   the r of the next row (42 a + 32 b - 24) v, of the next column (32 a + 42 b - 24) v. a and b are
   clipped to 0 and 1/4.
5. The variance is that times the variance of the slope of independent errors by 1, over the same
   by 3: less at a corner. Where a node of the 3 x 3 is missing it is not less, since errors of
   neighbours are alike. A slope whose variance is unknown has that of independent errors. What a
   surface cannot follow shows in how far apart the slopes of the displacement are in a cubic and in
   the quadratic one: three times the square of that is added. The cubic one is that of the valid of
   the 5 x 5 nodes around. Where they do not determine it, or not to a variance of 10, or the
   lattice ends, the 5 x 5 are those with the next nearest middle that hold the node. Across a tear
   both surfaces go as wrong. There the fourth difference along an axis is large: a fiftieth of the
   square of its mean over the lines of the 5 x 5 without a missing node is added too.
6. To first order dE = sym(F' dG + (F - (2 E + I) Q)' dA), with dG and dA the errors of the slopes
   of the displacement and of the position at rest along Q; on a surface the turn of axis 1 by
   Q2 . dA1 comes on top. The errors of different axes of the lattice are independent; those of the
   coordinates correlate as their covariance says.
"""

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.reference.field.filter import window

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH, WIDE_REACH = 1, 2
CHOSEN, APART, TORN = 1.15, 3, 0.02
FOURTH = (1, -4, 6, -4, 1)
MOST_SHARED = 0.25
MOST_VARIANCE = 10


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
    common: Floats,
) -> Floats:
    """Return the covariances of the slopes by column and by row, (R, C, 2, K, K), by 3.

    weights: (A, B, R, C). size: (R, C), the deviation of the noise. filters: (A, R, R) and (B, C,
    C). correlations: a and b of 4. common: (R, C, K, K), the covariance of the noise over its mean
    diagonal.
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
        rows, columns = (window(i, n, REACH) for i, n in zip((r, c), shape, strict=True))
        count = np.count_nonzero(votes[np.ix_(rows, columns)])
        if not count:
            continue
        mean = scaled[:, :, rows][..., columns].sum(axis=(2, 3)) / count
        down, along = filters[0][:, rows], filters[1][:, columns]
        (value_down, slope_down), (value_along, slope_along) = (
            _line_and_parabola(r, rows),
            (_line_and_parabola(c, columns)),
        )
        for step, (one, two) in enumerate(((value_down, slope_along), (slope_down, value_along))):
            slope = np.einsum("ab,s,asi,t,btj->ij", mean, one, down, two, along, optimize=True)
            variance = (slope * (together[0] @ slope @ together[1])).sum()
            found[r, c, step] = CHOSEN * variance * common[r, c]
    return found


def _line_and_parabola(i: int, nodes: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return the weights of the nodes of a window in the value at node i of the line, and in the
    slope there of the parabola, that fit them best."""
    off = (nodes - i).astype(np.float64)
    line, parabola = (np.linalg.pinv(np.vander(off, n, increasing=True)) for n in (2, 3))
    return line[0], parabola[1]


def strain(
    rest: Floats,
    displacement: Floats,
    covariances: tuple[Floats, Floats],
    slopes: tuple[Floats, Floats],
) -> tuple[Floats, Floats]:
    """Return E11 E22 E12 (R, C, 3), and their covariance, (R, C, 3, 3).

    rest, displacement: (R, C, D). covariances: (R, C, D, D), of rest and displacement. slopes: the
    same by column and by row, by 3, (R, C, 2, D, D), NaN where unknown.
    """
    shape, size = rest.shape[:2], rest.shape[2]
    valid = np.isfinite(displacement[..., 0])
    still, moved = (
        np.where(valid[..., None], each, 0).reshape(-1, size) for each in (rest, displacement)
    )
    found, covariance = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    for r, c in zip(*np.nonzero(valid), strict=True):
        near, wide = (
            [window(i, n, reach) for i, n in zip((r, c), shape, strict=True)]
            for reach in (REACH, WIDE_REACH)
        )
        down, along = (_line_and_parabola(*each) for each in zip((r, c), near, strict=True))
        whole = bool(valid[np.ix_(*near)].all())
        fit = _slopes_of_surface((r, c), near if whole else wide, valid, 2)
        if fit is None:
            continue
        apart, torn = np.zeros((2, 2, size))
        nearest = _nearest_cubic((r, c), valid)
        if nearest is not None:
            around, cubic = nearest
            apart, torn = (cubic - fit) @ moved, _fourth(around, valid) @ moved
            whole_around = min(r, c) >= 2 and valid[r - 2 : r + 3, c - 2 : c + 3].sum() == 25
            fit = cubic if whole_around else fit
        own = np.square(fit).sum(axis=1)
        if max(own) > MOST_VARIANCE:
            continue
        more = own / [
            np.square(np.outer(*pair)).sum() for pair in ((down[0], along[1]), (down[1], along[0]))
        ]
        more = more if whole else np.maximum(more, 1)
        a = fit @ still
        b = a + fit @ moved
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
        wrong = APART * _squares(apart) + TORN * _squares(torn)
        moments = zip((before, now), covariances, slopes, (0 * wrong, wrong), strict=True)
        for gradients, of_values, of_slopes, more_by in moments:
            by_step = np.array([inverse.T @ np.array(each) for each in gradients])  # (3, 2, D)
            for k, slope in enumerate(of_slopes[r, c]):
                step = own[k] * of_values[r, c] if np.isnan(slope).any() else more[k] * slope
                step = step + more_by[k]
                total += by_step[:, k] @ step @ by_step[:, k].T
        covariance[r, c] = total
    return found, covariance


def _squares(vectors: Floats) -> Floats:
    """Return the products of the coordinates of each vector, (N, D, D)."""
    products: Floats = vectors[:, :, None] * vectors[:, None]
    return products


def _nearest_cubic(
    node: tuple[int, int], valid: Bools
) -> tuple[list[NDArray[np.intp]], Floats] | None:
    """Return the 5 x 5 of the cubic surface of 5 and the weights of `_slopes_of_surface` for it,
    None if there is none."""
    steps = sorted(itertools.product(range(-2, 3), repeat=2), key=lambda step: math.hypot(*step))
    for step in steps:
        middle = np.add(node, step)
        if min(middle) < 2 or (middle > np.subtract(valid.shape, 3)).any():
            continue
        around = [np.arange(m - 2, m + 3) for m in middle]
        cubic = _slopes_of_surface(node, around, valid, 3)
        if cubic is not None and np.square(cubic).sum(axis=1).max() <= MOST_VARIANCE:
            return around, cubic
    return None


def _fourth(around: list[NDArray[np.intp]], valid: Bools) -> Floats:
    """Return the weights (2, R * C) of all nodes in the mean fourth differences of the rows and of
    the columns of 5 x 5 nodes, of those without a missing node; 0 without one."""
    there, weights = valid[np.ix_(*around)], np.zeros((2, *valid.shape))
    for axis, (lines, weight) in enumerate(zip((there, there.T), weights, strict=True)):
        whole = lines.all(axis=1)
        each = np.outer(whole / max(whole.sum(), 1), FOURTH)
        weight[np.ix_(*around)] = each.T if axis else each
    return weights.reshape(2, -1)


def _slopes_of_surface(
    node: tuple[int, int], around: list[NDArray[np.intp]], valid: Bools, degree: int
) -> Floats | None:
    """Return the weights (2, R * C) of all nodes in the slopes by column and by row, at a node, of
    the surface that fits the valid ones of a window best; None if they do not determine it."""
    there = np.zeros_like(valid)
    there[np.ix_(*around)] = True
    near = np.nonzero(there & valid)
    v, u = near[0] - node[0], near[1] - node[1]
    powers = [(p, total - p) for total in range(degree + 1) for p in range(total, -1, -1)]
    terms = np.stack([u**p * v**q for p, q in powers], axis=1).astype(np.float64)
    if np.linalg.matrix_rank(terms) < len(powers):
        return None
    weights = np.zeros((2, *valid.shape))
    weights[:, near[0], near[1]] = np.linalg.pinv(terms)[1:3]
    return weights.reshape(2, -1)
