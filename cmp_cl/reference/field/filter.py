"""The adaptive lattice filter, node by node, in float64.

1. Nodes that were not measured, and those rejected below, have no vote. Of positions the bilinear
   surface that fits the votes best is subtracted, and added at the end.
2. A hole gets the value of the quadratic surface through the votes within 3 nodes, or within 6 if
   those are fewer than 8. The weights are exp(-r^2 / (2 (reach / 2)^2)), and a ridge of 1e-3 on
   the slopes and 1e-2 on the curvatures pulls the surface slightly towards a constant.
3. An axis filter (h, p) fits a polynomial of degree p to the 2 h + 1 nodes around a node, and
   gives the node its value there; at an end the window stays inside. A pair is one filter along
   the column and one along the row.
4. The pilot is (3, 5), (2, 3) for fewer than 8 nodes, none for fewer than 5. Its residual is r; k
   is the node's own weight in it. The variance of the noise is
   s2 = G2(|r| / root(K (1 - k)))^2 (1 + .55 / f), over the votes with k < 0.95 and at least three
   quarters of the window measured, whose coordinates covary as C = G2(r r^T / (1 - k)). G is a
   Gaussian of that standard deviation, in nodes, whose weights sum to 1. f = trace(C)^2 / |C|^2 is
   the effective number of directions: 1 + .55 / f is the mean square of a chi variable with f
   degrees of freedom over the square of its mean, within 1.3 %.
5. A node is rejected if |r|^2 / K > 46 s2 (1 - k) / (1 + .55 / f), at six standard deviations if
   all directions are alike, and no neighbour has a larger |r|. For a rough corner |r| counts twice,
   and it is rejected too where less than three quarters of the pilot's window are measured. This is
   done up to three times. Its result is its own value, or that of a rough one the mean of its
   neighbours.
6. Each pair gives the estimate E, the loss Q = |X - E|^2 / K + 2 s2 H, with H the node's own weight
   in the pair, and the risk G1.5(Q) / s2 over the votes. The result is the mean of the E with
   weights w proportional to exp(-(risk - least risk) 2 pi 1.5^2 / 3).
7. The noise in it has the variance s2 sum w V, V the sum of the squares of the pair's weights, and
   by coordinates the shape of C. What s2 (sum w risk - 1) exceeds it by is the square of a bias of
   any direction: it is added to the variance of each axis.
8. If the values may bend sharply, as displacements, the pairs are chosen with s1 in place of
   s2. s1 is 1.29 times the least of s2 and of the same estimates from the pilot along one axis
   alone or along one diagonal alone, but at most s2. Along a diagonal the pilot is (3, 5), and
   is used only where its window fits. Then s1 sum w risk + 2 (s2 - s1) sum w H - s2 takes the place
   of s2 (sum w risk - 1). If an upper bound of the noise is known, s1 is at most its square.
9. A node may be worse than the lattice shows. Of displacements the images say so, if their variance
   now exceeds four times the sum of s2 and of what the upper bound exceeds that variance by; of all
   values their mean squared distance from the result does, if it exceeds 9 s2. With v the larger of
   these, the variance before the filter is v, and (sum w H)^2 v is added to that of the result. A
   rejected node has v, but for a rough one where three quarters of the pilot's window vote.
"""

import dataclasses
import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Source = NDArray[np.uint8]

LEAST_OF_FIVE, MOST_OWN, CHI = 1.29, 0.95, 0.55
PAIRED = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # half width in nodes, degree


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Filtered:
    """A filtered lattice.

    values: (R, C, K); a rejected node keeps its own value, unless it is rough. covariance: (R, C,
    K, K), of the values; in the plane both axes have the same variance. noise: (R, C), standard
    deviation of those before the filter. Both are NaN where unknown. refused: (R, C), the rejected
    nodes. margin: the smallest relative distance from its bound of a quantity that rejects or
    accepts a node; if it is tiny, float32 may decide otherwise.
    """

    values: Floats
    covariance: Floats
    noise: Floats
    refused: Bools
    margin: float


def filter_positions(values: Floats, measured: Source, by_images: Floats) -> Filtered:
    """Filter positions (R, C, K), NaN where missing.

    measured: (R, C), 1; 0 for a node that has no vote and gets the mean of its neighbours; more
    than 1 for a rough corner. A hole is filled like a node without a vote. by_images: (R, C), the
    variance that the images show, NaN where unknown.
    """
    votes = np.isfinite(values).all(axis=2) & (measured > 0)
    surface = _plane(values, votes)
    found = _filtered(values - surface, measured, by_images, None)
    return dataclasses.replace(found, values=found.values + surface)


def filter_displacements(
    values: Floats, measured: Source, by_images: Floats, most_noise: Floats
) -> Filtered:
    """Filter displacements, see 8 and `filter_positions`. by_images: now. most_noise: (R, C), NaN
    where unknown."""
    return _filtered(values, measured, by_images, most_noise)


def _filtered(values: Floats, measured: Source, by_images: Floats, most: Floats | None) -> Filtered:
    there = np.asarray(np.isfinite(values).all(axis=2), np.bool_)
    votes, rough = there & (measured > 0), measured > 1
    data = np.where(votes[..., None], values, 0)
    if not votes.all():
        data = _filled(data, votes)
    margin = math.inf
    kept = votes
    residual, s2, own, common = _noise(data, kept)
    for _ in range(3):
        usual = s2 / _over_mean(common)
        gone, near = _rejected(residual * np.where(rough, 2, 1)[..., None], usual, own, kept)
        margin = min(margin, near)
        gone |= kept & rough & ~_supported(kept)
        if not gone.any():
            break
        kept = kept & ~gone
        data = _filled(np.where(kept[..., None], data, 0), kept)
        residual, s2, own, common = _noise(data, kept)
    chosen = s2
    if most is not None:
        chosen = _least_noise(data, kept, s2, common)
        chosen = np.where(np.isnan(most), chosen, np.minimum(chosen, most**2))
    smooth, variance, bias, used = _mixture(data, kept, s2, chosen)
    gone = votes & ~kept
    off = ((values - smooth) ** 2).mean(axis=2)
    at_rest = np.nan if most is None else most**2 - by_images
    alone = np.where(by_images > 4 * (s2 + at_rest), by_images, 0)
    alone = np.maximum(alone, np.where(off > 9 * s2, off, 0))
    variance = np.where(kept, variance + used**2 * alone, s2)
    own_error = gone & (alone > 0) & ~(rough & _supported(kept))
    variance = np.where(own_error, alone, variance)
    changed = there & ~(gone & ~rough) & np.isfinite(variance)
    each_axis = np.eye(values.shape[2])
    shape = common if values.shape[2] == 3 else each_axis
    covariance = _each(variance) * shape + _each(np.where(kept, bias, 0)) * each_axis
    return Filtered(
        values=np.where(changed[..., None], smooth, values),
        covariance=np.where(_each(there), covariance, np.nan),
        noise=np.where(there, np.sqrt(s2), np.nan),
        refused=gone,
        margin=margin,
    )


def _each(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return the numbers (R, C) of the nodes to multiply matrices with, (R, C, 1, 1)."""
    return numbers[..., None, None]


def _common(residual: Floats, own: Floats, votes: Bools) -> Floats:
    """Return the covariance of the coordinates around each node, over its mean diagonal."""
    count = residual.shape[2]
    down, along = (_gaussian(n, 2.0) for n in votes.shape)
    usable = votes & (own < MOST_OWN)
    share = np.where(usable, 1 / np.maximum(1 - own, 1 - MOST_OWN), 0)
    squares = np.einsum("rc,rci,rcj->rcij", share, residual, residual)
    sums = np.einsum("rm,mnij,cn->rcij", down, squares, along)
    mean = np.trace(sums, axis1=2, axis2=3)[..., None, None] / count
    return np.where(mean > 0, sums / np.where(mean > 0, mean, 1), np.eye(count))


def _plane(values: Floats, votes: Bools) -> Floats:
    """Return the best bilinear surface; its residual sets the scale of the least variance."""
    rows, columns = votes.shape
    r, c = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    terms = np.stack([np.ones(votes.shape), r, c, r * c], axis=-1).astype(np.float64)
    fit = np.linalg.lstsq(terms[votes], values[votes], rcond=None)[0]
    return terms @ fit


def window(i: int, n: int, half: int) -> NDArray[np.intp]:
    """Return the nodes up to `half` nodes from i, moved to lie within a line of n."""
    half = min(half, (n - 1) // 2)
    return np.arange(2 * half + 1) + min(max(i - half, 0), n - 1 - 2 * half)


@functools.cache
def axis_filter(n: int, half: int, degree: int) -> Floats:
    """Return (n, n), the weights of the nodes in each node's polynomial."""
    weights = np.zeros((n, n))
    for i in range(n):
        nodes = window(i, n, half)
        vander = np.vander((nodes - i).astype(np.float64), degree + 1, increasing=True)
        weights[i, nodes] = np.linalg.pinv(vander)[0]
    return weights


def _share(votes: Bools, halves: tuple[int, int]) -> Floats:
    """Return the share of the nodes of each node's window that vote."""
    down, along = (axis_filter(n, half, 0) for n, half in zip(votes.shape, halves, strict=True))
    share: Floats = down @ votes @ along.T
    return share


def _gaussian(n: int, deviation: float) -> Floats:
    """Return (n, n), the weights of the nodes of a line around each of them; on an endless line
    their sum is 1."""
    apart = np.arange(n)[:, None] - np.arange(n)
    weights = np.exp(-(apart**2) / (2 * deviation**2))
    return np.asarray(weights / (math.sqrt(2 * math.pi) * deviation))


def _average(values: Floats, counted: Bools, deviation: float) -> Floats:
    """Return the Gaussian mean around each node of the counted values; NaN if there are none."""
    down, along = (_gaussian(n, deviation) for n in counted.shape)
    total = down @ counted @ along.T
    mean = down @ np.where(counted, values, 0) @ along.T
    return np.where(total > 1e-6, mean / np.maximum(total, 1e-6), np.nan)


def _noise(data: Floats, votes: Bools) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the pilot's residual (R, C, K), s2, the pilot's own weights (R, C), and `_common`."""
    pilots = [_pilot(n) for n in votes.shape]
    down, along = (axis_filter(n, *each) for n, each in zip(votes.shape, pilots, strict=True))
    residual = data - np.einsum("ij,jlk,ml->imk", down, data, along)
    own = np.outer(np.diag(down), np.diag(along))
    supported = votes & _supported(votes)
    common = _common(residual, own, supported)
    return residual, _variance(residual, own, supported, common) + 1e-30, own, common


def _supported(votes: Bools) -> Bools:
    """Return where at least three quarters of the pilot's window vote."""
    down, along = (_pilot(n)[0] for n in votes.shape)
    return np.asarray(_share(votes, (down, along)) >= 0.75 - 1e-6)


def _pilot(n: int) -> tuple[int, int]:
    """Return the half width and the degree of the pilot along an axis of n nodes, see 4."""
    return (3, 5) if n >= 8 else (2, 3) if n >= 5 else (0, 0)


def _rejected(residual: Floats, usual: Floats, own: Floats, votes: Bools) -> tuple[Bools, float]:
    size = np.where(votes, (residual**2).mean(axis=2), 0)
    gone = np.zeros_like(votes)
    margin = math.inf
    for r, c in zip(*np.nonzero(votes & np.isfinite(usual)), strict=True):
        bound = 46 * usual[r, c] * (1 - own[r, c])
        around = size[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2]
        if bound > 1e-20:
            margin = min(margin, abs(size[r, c] / bound - 1))
        gone[r, c] = size[r, c] > bound and size[r, c] >= around.max()
    return gone, margin


def _mixture(
    data: Floats, votes: Bools, s2: Floats, chosen: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the values, the variance of the noise in them, the square of their bias, and the
    weight of each node in its own value."""
    rows, columns, _ = data.shape
    estimates, risks, gains, owns = [], [], [], []
    for h_row, p_row in PAIRED:
        for h_column, p_column in PAIRED:
            if rows < 2 * h_row + 1 or columns < 2 * h_column + 1:
                continue
            a, b = axis_filter(rows, h_row, p_row), axis_filter(columns, h_column, p_column)
            estimate = np.einsum("ij,jlk,ml->imk", a, data, b)
            loss = ((data - estimate) ** 2).mean(axis=2)
            own = np.outer(np.diag(a), np.diag(b))
            loss = loss + 2 * chosen * own
            risk = np.nan_to_num(_average(loss, votes, 1.5) / chosen)  # all pairs are alike there
            owns.append(own)
            estimates.append(estimate)
            risks.append(risk)
            gains.append(np.outer((a**2).sum(axis=1), (b**2).sum(axis=1)))
    risk, gain, estimate = np.array(risks), np.array(gains), np.array(estimates)
    weights = np.exp(-(risk - risk.min(axis=0)) * 2 * math.pi * 1.5**2 / 3)
    weights /= weights.sum(axis=0)
    values = np.einsum("prc,prck->rck", weights, estimate)
    mean_risk = (weights * risk).sum(axis=0)
    mean_own = (weights * np.array(owns)).sum(axis=0)
    expected = chosen * mean_risk + 2 * (s2 - chosen) * mean_own - s2
    noise = s2 * (weights * gain).sum(axis=0)
    return values, noise, np.maximum(expected - noise, 0), mean_own


def _least_noise(data: Floats, votes: Bools, s2: Floats, common: Floats) -> Floats:
    """Return the variance of the noise with which the pairs are chosen."""
    rows, columns, _ = data.shape
    least = s2
    for axis in (0, 1):
        lines = np.moveaxis(data, axis, 0)
        n = len(lines)
        filters = axis_filter(n, *_pilot(n))
        residual = np.moveaxis(lines - np.tensordot(filters, lines, 1), 0, axis)
        own = np.expand_dims(np.diag(filters), 1 - axis) * np.ones(votes.shape)
        least = np.fmin(least, _variance(residual, own, votes, common))
    pilot = axis_filter(7, 3, 5)[3]
    for sense in (1, -1):
        residual, own = np.zeros_like(data), np.ones(votes.shape)
        for r in range(3, rows - 3):
            for c in range(3, columns - 3):
                line = np.array([data[r + t, c + sense * t] for t in range(-3, 4)])
                residual[r, c], own[r, c] = data[r, c] - pilot @ line, pilot[3]
        least = np.fmin(least, _variance(residual, own, votes, common))
    return np.minimum(s2, LEAST_OF_FIVE * least)


def _variance(residual: Floats, own: Floats, votes: Bools, common: Floats) -> Floats:
    """Return the variance of the noise by a residual (R, C, K), NaN where it is unknown."""
    size = np.sqrt((residual**2).mean(axis=2) / np.maximum(1 - own, 1 - MOST_OWN))
    return _average(size, votes & (own < MOST_OWN), 2.0) ** 2 * _over_mean(common)


def _over_mean(common: Floats) -> Floats:
    """Return the mean square of a residual over the square of its mean length, (R, C)."""
    return np.asarray(1 + CHI * (common**2).mean(axis=(2, 3)))


def _filled(data: Floats, votes: Bools) -> Floats:
    """Return the data with a value in each hole."""
    result = np.where(votes[..., None], data, 0.0)
    for node in zip(*np.nonzero(~votes), strict=True):
        off = np.argwhere(votes) - node
        for reach in (3, 6):
            near = (np.abs(off) <= reach).all(axis=1)
            if np.count_nonzero(near) >= 8:
                result[node] = surface_at(off[near], data[votes][near], reach)
                break
    return result


def surface_at(off: NDArray[Any], values: Floats, reach: int) -> Floats:
    """Return the value at a node of the quadratic surface of 2 through the values (N, K) of others.

    off: (N, 2), by how many rows and columns, or other steps, these are away. reach: in such steps.
    """
    y, x = off.astype(np.float64).T
    terms = np.stack([np.ones_like(x), y, x, y * y, y * x, x * x], axis=1)
    weight = np.exp(-(x * x + y * y) / (2 * (reach / 2) ** 2))[:, None]
    normal = terms.T @ (weight * terms) + np.diag([0, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])
    by = np.linalg.solve(normal, terms.T @ (weight * (values - values[0])))
    found: Floats = values[0] + by[0]
    return found
