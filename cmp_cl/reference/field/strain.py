"""The strain of a filtered displacement and its covariance, node by node, in float64.

1. A surface in (column, row) is fitted to the nodes around a node, at rest and now, and has slopes
   at the node. In the middle of 5 x 5 nodes it is a cubic one. Else it is a quadratic one of 3 x 3;
   if one of the nine is missing, of the valid ones of 5 x 5, 3 on lines of three or four nodes. At
   a border windows are moved inwards. A node has no strain if these nodes do not determine the
   surface, or if errors of variance 1 give a slope of a variance of more than 10.
2. On a surface, Q are orthonormal axes of the tangent plane at rest, axis 1 along its first slope;
   in a plane they are x and y. F are the current slopes along them: E = (F F' - I) / 2.
3. The covariance of a slope is half the sum of those of the nodes, each times the square of its
   weight: errors of filtered neighbours are alike. In a lattice too small to filter, with fewer
   than 5 nodes along both axes, it is the whole sum. What a surface cannot follow shows in how far
   apart the slopes of the displacement are in a cubic and in the quadratic one: five times the
   square of that is added. The cubic one is that of the valid of the 5 x 5 nodes around, moved
   inwards at a border. Across a tear both surfaces go as wrong. There the fourth difference along
   an axis is large: .06 of the square of its mean over the lines of the 5 x 5 without a missing
   node is added too. Where the 5 x 5 do not determine the cubic one, or not to a variance of 10,
   nothing is added.
4. To first order dE = sym(F' dG + (F - (2 E + I) Q)' dA), with dG and dA the errors of the slopes
   of the displacement and of the position at rest along Q; on a surface the turn of axis 1 by
   Q2 . dA1 comes on top. The errors of different axes of the lattice are independent; those of the
   coordinates correlate as their covariance says.
"""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.reference.field.filter import window

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

REACH, WIDE_REACH = 1, 2
ALIKE, APART, TORN = 0.5, 5, 0.06
FOURTH = (1, -4, 6, -4, 1)
MOST_VARIANCE = 10


def strain(
    rest: Floats, displacement: Floats, covariances: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return E11 E22 E12 (R, C, 3), and their covariance, (R, C, 3, 3).

    rest, displacement: (R, C, D). covariances: (R, C, D, D), of both.
    """
    shape, size = rest.shape[:2], rest.shape[2]
    valid = np.isfinite(displacement[..., 0])
    still, moved = (
        np.where(valid[..., None], each, 0).reshape(-1, size) for each in (rest, displacement)
    )
    found, covariance = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan)
    alike = ALIKE if max(shape) >= 5 else 1.0
    for r, c in zip(*np.nonzero(valid), strict=True):
        near, wide = (
            [window(i, n, reach) for i, n in zip((r, c), shape, strict=True)]
            for reach in (REACH, WIDE_REACH)
        )
        whole = bool(valid[np.ix_(*near)].all())
        fit = _slopes_of_surface((r, c), near if whole else wide, valid, 2)
        if fit is None:
            continue
        apart, torn = np.zeros((2, 2, size))
        cubic = _slopes_of_surface((r, c), wide, valid, 3)
        if cubic is not None and np.square(cubic).sum(axis=1).max() <= MOST_VARIANCE:
            apart, torn = (cubic - fit) @ moved, _fourth(wide, valid) @ moved
            whole_around = min(r, c) >= 2 and valid[r - 2 : r + 3, c - 2 : c + 3].sum() == 25
            fit = cubic if whole_around else fit
        if np.square(fit).sum(axis=1).max() > MOST_VARIANCE:
            continue
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
        moments = zip((before, now), covariances, (0 * wrong, wrong), strict=True)
        for gradients, of_values, more_by in moments:
            by_step = np.array([inverse.T @ np.array(each) for each in gradients])  # (3, 2, D)
            for k, weight in enumerate(fit):
                used = weight != 0
                of_nodes = of_values.reshape(-1, size, size)[used]
                step = alike * np.tensordot(weight[used] ** 2, of_nodes, 1)
                total += by_step[:, k] @ (step + more_by[k]) @ by_step[:, k].T
        covariance[r, c] = total
    return found, covariance


def _squares(vectors: Floats) -> Floats:
    """Return the products of the coordinates of each vector, (N, D, D)."""
    products: Floats = vectors[:, :, None] * vectors[:, None]
    return products


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
