"""The mixture of all filters at each node, weighted by Stein's unbiased risk estimate."""

import dataclasses
import functools
import math
import threading

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.holes import filled
from cmp_cl.filter.noise import (
    LEAST_VARIANCE,
    PASSED,
    noise_along,
    noise_of,
    outliers,
    shared_with_neighbours,
)
from cmp_cl.filter.polynomials import (
    LEAST_SUPPORT,
    RISK_REACH,
    axis_of,
    grams_of,
    pairs_of,
    window_mean,
)

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]
Box = tuple[slice, slice]

_SHARPNESS = 2 * math.pi * RISK_REACH**2 / 3  # exponent of the weights, per unit of risk
_ROUNDS = 3  # rounds of the search for outliers
_MOST_KEPT = 1 << 20  # most numbers in a thread's scratch memory
_kept = threading.local()


@dataclasses.dataclass(frozen=True, eq=False)
class Mixture:
    """The filtered values of a connected part, in its rectangle of nodes; all float32.

    part: (R, C), the nodes of the part. votes: (R, C), those that influence others.
    bends: see `filter_grid`.
    data: (K, R, C), before the filter, with predictions in the holes. values: (K, R, C), after it.
    residual: (K, R, C), of the pilot. weights: (A, B, R, C), of each pair of filters at each node.
    raw_variance, variance: (R, C), variances of the data and of the values. gain: (R, C), the share
    of the noise's variance that the weights leave.
    """

    box: Box
    part: Bools
    bends: bool
    data: Single
    votes: Bools
    residual: Single
    weights: Single
    values: Single
    raw_variance: Single
    variance: Single
    gain: Single

    @functools.cached_property
    def common(self) -> Array:
        """Return the covariance of the coordinates around each node, scaled to a mean diagonal of
        1, (R, C, K, K)."""
        rows, columns = self.votes.shape
        down, along = axis_of(rows), axis_of(columns)
        residual = np.where(self.votes, self.residual, 0).astype(np.float64)
        products = residual[:, None] * residual[None]
        sums = down.near_noise @ products @ along.near_noise.T
        sums = sums.transpose(2, 3, 0, 1)
        count = len(residual)
        mean = np.trace(sums, axis1=2, axis2=3)[..., None, None] / count
        alike = np.broadcast_to(np.eye(count), sums.shape)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(mean > 0, sums / mean, alike)

    def slope_variance(self, *, smoothed: bool) -> Array:
        """Return (R, C, 2) float64, see `Filtered.slope_variance`.

        A slope is a quadratic form of the weights W (A, B) of the pairs of filters, times the
        deviation of the noise: its variance is tr(G W H W'), with G and H the products of the
        slopes, or of the means, of the filters along the columns and along the rows.
        """
        shared = shared_with_neighbours(self.data, self.votes, self.raw_variance)
        (down_mean, down_slope), (along_mean, along_slope) = (
            grams_of(n, bends=self.bends).of_noise(part)
            for n, part in zip(self.votes.shape, shared, strict=True)
        )
        ways = (down_mean, along_slope), (down_slope, along_mean)
        found: list[Array]
        if smoothed:
            size = np.sqrt(self.variance / self.gain)
            mean = window_mean(self.weights * size, self.votes & np.isfinite(size))
            around = mean.transpose(2, 3, 0, 1)
            found = [(g[:, None] @ around @ h * around).sum(axis=(2, 3)) for g, h in ways]
            return np.stack(found, axis=2)
        # The first filter changes nothing. What neighbours share passes the pilot, so that the
        # variance of the noise is too small by that.
        s2 = self.raw_variance / (1 - PASSED * sum(shared))
        found = [np.outer(g[:, 0, 0], h[:, 0, 0]) * s2 for g, h in ways]
        return np.stack(found, axis=2)


def mixed(
    data: Single, votes: Bools, part: Bools, most: Single, box: Box, *, bends: bool
) -> Mixture:
    """Return the mixture for data (K, R, C), without the nodes that are rejected.

    votes, part, box, bends: as in `Mixture`. most: (R, C), an upper bound on the standard deviation
        of the noise, NaN where unknown.
    """
    whole = bool(votes.all())
    if not whole:
        data = filled(data, votes)
    residual, noise = noise_of(data, votes, whole=whole)
    allowed = votes
    for _ in range(_ROUNDS):
        rejected = outliers(residual, noise, allowed)
        if not rejected.any():
            break
        allowed = allowed & ~rejected
        data = filled(np.where(votes, data, 0), allowed)
        residual, noise = noise_of(data, allowed, whole=False)
    shape_noise = noise_along(data, allowed, noise) if bends else noise
    if not np.isnan(most).all():
        shape_noise = np.where(np.isnan(noise), noise, np.fmin(shape_noise, np.square(most)))
    return _mixture(data, allowed, residual, noise, shape_noise, part, box, bends=bends)


def _mixture(
    data: Single,
    votes: Bools,
    residual: Single,
    noise: Single,
    chosen_noise: Single,
    part: Bools,
    box: Box,
    *,
    bends: bool,
) -> Mixture:
    count, rows, columns = data.shape
    down, along = (axis_of(n, bends=bends) for n in (rows, columns))
    pairs = pairs_of(rows, columns, bends=bends)
    known = np.isfinite(noise)
    s2 = np.where(known, np.maximum(chosen_noise, np.float32(LEAST_VARIANCE)), np.float32(1))
    smooth = _smooth(data, bends=bends)
    risk = _scratch("risk", pairs.own.shape)
    apart = np.empty_like(risk)
    np.multiply(pairs.own, 2 * count * s2, out=risk)  # the loss, before it is averaged
    for coordinate in range(count):
        np.subtract(smooth[coordinate], data[coordinate], out=apart)
        risk += np.square(apart, out=apart)
    whole = bool(votes.all())
    if not whole:
        risk *= votes
    np.matmul(down.near_risk, np.matmul(risk, along.risk_columns, out=apart), out=risk)
    if whole:
        risk *= 1 / (count * s2)
    else:
        there = votes.astype(np.float32)
        near = down.near_risk @ there @ along.risk_columns
        risk *= 1 / (count * s2 * np.maximum(near, np.float32(1e-6)))
        support = (down.share @ there)[:, None] @ along.share.transpose(0, 2, 1)
        bad = (support < LEAST_SUPPORT) | ~known | (near < 1e-6)
        bad[0, 0] = False
        risk[bad] = 1e30
    weights = np.subtract(risk.min(axis=(0, 1)), risk, out=apart)
    weights *= np.float32(_SHARPNESS)
    np.exp(weights, out=weights)
    weights *= 1 / weights.sum(axis=(0, 1))
    values = np.stack([_over_pairs(weights, each) for each in smooth])
    gain = _over_pairs(weights, pairs.gain)
    own = _over_pairs(weights, pairs.own) if chosen_noise is not noise else np.float32(0)
    mean_risk = _over_pairs(weights, risk)
    more = noise - chosen_noise  # the pilot's noise beyond it; the filters remove it too
    expected = chosen_noise * mean_risk + 2 * more * own - noise
    variance = np.maximum(expected, chosen_noise * gain)
    return Mixture(
        box=box,
        part=part,
        bends=bends,
        data=data,
        votes=votes,
        residual=residual,
        weights=weights,
        values=values,
        raw_variance=noise,
        variance=variance,
        gain=gain,
    )


def _smooth(data: Single, *, bends: bool) -> Single:
    """Apply each pair of filters: (K, R, C) -> (K, A, B, R, C).

    The matrices are no larger than the lattice. They are too small for BLAS to use several threads,
    which would cost milliseconds while other work keeps the cores busy.
    """
    count, rows, columns = data.shape
    down, along = (axis_of(n, bends=bends) for n in (rows, columns))
    shape = (count, len(down.filters), len(along.filters), rows, columns)
    smooth = _scratch("smooth", shape)
    smooth[:, 0, 0] = data
    np.matmul(down.filters[1:], data[:, None], out=smooth[:, 1:, 0])
    np.matmul(smooth[:, :, :1], along.columns, out=smooth[:, :, 1:])
    return smooth


def _scratch(name: str, shape: tuple[int, ...]) -> Single:
    """Return an array of that shape, which this thread reuses under that name; its content is
        undefined.

    Fresh memory costs a page fault for every 4 kB, a third of the time of the filter.
    """
    size = math.prod(shape)
    if size > _MOST_KEPT:
        return np.empty(shape, np.float32)
    kept: Single | None = vars(_kept).get(name)
    if kept is None or kept.size < size:
        kept = np.empty(size, np.float32)
        vars(_kept)[name] = kept
    return kept[:size].reshape(shape)


def _over_pairs(weights: Single, values: Single) -> Single:
    """Sum over pairs: (A, R, B, C) -> (R, C)."""
    total: Single = np.einsum("abrc,abrc->rc", weights, values)
    return total
