"""The noise of a lattice, from the residual of a local polynomial, and the outliers in it."""

import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.filter.polynomials import LEAST_SUPPORT, axis_of, pairs_of

Single = NDArray[np.float32]
Bools = NDArray[np.bool_]

REJECTED = 6.0  # standard deviations from what the neighbours predict
LEAST_VARIANCE = 1e-30  # of the noise
_FLOOR = 1e-10  # of the variance of the noise, relative to the mean square of the values
# Variance of white noise, over the mean of the least of its five estimates below.
_LEAST_OF_FIVE = 1.29
_MOST_SHARED = 0.25  # of the noise of a node, by coordinate: half of that across an edge
# The pilot's residual of white noise has 0.678 of its variance. If the noise of neighbours
# correlates by a and b, it has 0.678 - 0.421 (a + b).
PASSED = 0.421 / 0.678
_SEVEN = np.array([5, -30, 75, 131, 75, -30, 5]) / 231  # weights of the pilot away from the border


def noise_of(data: Single, votes: Bools, *, whole: bool) -> tuple[Single, Single]:
    """Return the pilot's residual (K, R, C), and the variance of the noise (R, C), NaN if unknown.

    data: (K, R, C). votes: (R, C). The noise comes from the mean size of the residual. A few large
        residuals, as at a sharp bend of the surface, change that less than the mean square.
    """
    rows, columns = votes.shape
    down, along, pairs = axis_of(rows), axis_of(columns), pairs_of(rows, columns)
    residual = np.asarray(data - down.pilot @ data @ along.pilot_columns, np.float32)
    left = 1 - pairs.pilot_own
    square = np.square(residual).mean(axis=0) / np.maximum(left, 1e-3)
    size = np.asarray(np.sqrt(square), np.float32)
    usable = left > 0.05
    if not whole:
        support = down.pilot_share @ votes.astype(np.float32) @ along.pilot_share.T
        usable &= votes & (support >= LEAST_SUPPORT)
    if usable.all():
        mean = down.near_noise @ size @ along.noise_columns
    else:
        size = np.where(usable, size, np.float32(0))
        near = down.near_noise @ usable.astype(np.float32) @ along.noise_columns
        mean = down.near_noise @ size @ along.noise_columns
        mean = np.where(near > 1e-6, mean / np.maximum(near, 1e-6), np.float32(np.nan))
    expected = _expected_size(residual, size)
    floor = max(_FLOOR * float(np.square(data).mean()), LEAST_VARIANCE)
    noise = np.square(mean / np.float32(expected)) + np.float32(floor)
    return residual, np.asarray(noise, np.float32)


def noise_along(data: Single, votes: Bools, noise: Single) -> Single:
    """Return the least of five estimates of the noise's variance, (R, C): from both axes together,
    from each axis and from each diagonal.

    Along an edge the surface is smooth, however sharply it bends across it. If all five show the
    same noise, the least is too small by a known factor.
    """
    down, along = axis_of(votes.shape[0]), axis_of(votes.shape[1])
    least = noise
    for residual, own in (
        (data - down.pilot @ data, down.pilot_own[:, None]),
        (data - data @ along.pilot_columns, along.pilot_own[None]),
        *_along_diagonals(data),
    ):
        usable = votes & (own < 0.95)
        near = down.near_noise @ usable.astype(np.float32) @ along.noise_columns
        square = np.square(residual).mean(axis=0) / np.maximum(1 - own, 0.05)
        size = np.where(usable, np.asarray(np.sqrt(square), np.float32), np.float32(0))
        mean = down.near_noise @ size @ along.noise_columns / np.maximum(near, np.float32(1e-6))
        alone = np.square(mean / np.float32(_expected_size(residual, size)))
        least = np.where(near > 1e-6, np.minimum(least, alone), least)
    chosen: Single = np.minimum(noise, least * np.float32(_LEAST_OF_FIVE))
    return chosen


def _along_diagonals(data: Single) -> list[tuple[Single, Single]]:
    """Return the pilot's residual along each diagonal, (K, R, C), and each node's own weight in it,
    (R, C).

    The weight is 1 within three nodes of the border. A lattice of fewer than 7 rows or columns has
    no such residual.
    """
    _, rows, columns = data.shape
    if min(rows, columns) < len(_SEVEN):
        return []
    inside = np.s_[3 : rows - 3, 3 : columns - 3]
    own = np.ones((rows, columns), np.float32)
    own[inside] = _SEVEN[3]
    found = []
    for sense in (1, -1):
        residual = np.zeros_like(data)
        middle = residual[:, *inside]
        middle += data[:, *inside]
        for step, weight in enumerate(_SEVEN, -3):
            left = 3 + sense * step
            around = data[:, 3 + step : rows - 3 + step, left : left + columns - 6]
            middle -= np.float32(weight) * around
        found.append((residual, own))
    return found


def _expected_size(residual: Single, size: Single) -> float:
    """Return the mean size of a residual whose variance per coordinate is 1.

    The size is assumed to be chi-distributed. Its degrees of freedom are the effective number of
    directions of the residuals, weighted so that a few large ones do not dominate. residual: (K, R,
    C). size: (R, C), its length, 0 where unknown.
    """
    count = len(residual)
    relative = size / max(float(size.max()), 1e-30)
    weights = np.where(size > 0, 1 / np.maximum(relative, 1e-8), 0)
    flat = residual.reshape(count, -1)
    common = (flat * weights.reshape(-1)) @ flat.T
    square = float(np.square(common).sum())
    freedom = float(np.trace(common)) ** 2 / square if square > 0 else float(count)
    share: float = math.sqrt(2 / freedom)
    return share * math.gamma(freedom / 2 + 0.5) / math.gamma(freedom / 2)


def shared_with_neighbours(data: Single, votes: Bools, noise: Single) -> tuple[float, float]:
    """Return the correlation of the noise of a node with that of the next node in its column, and
    in its row, by coordinate; 0 without 4 x 4 votes.

    Neighbours share the edge between them, and so a part of their errors across it. Let r be the
    second differences along rows of the second differences along columns, after J. Immerkaer, CVIU
    64, 1996. For noise of variance v with correlations a and b, r has the variance (36 - 48 a - 48
    b) v, and the covariance (42 a + 32 b - 24) v with the r of the next row, and (32 a + 42 b - 24)
    v with that of the next column. A bend of the surface within four nodes counts as noise that
    is shared. data: (K, R, C). votes: (R, C).
    """
    known = np.where(votes, data, np.nan).astype(np.float64)
    rough = np.diff(np.diff(known, 2, axis=1), 2, axis=2) / np.sqrt(noise[1:-1, 1:-1])
    lagged = rough * rough, rough[:, 1:] * rough[:, :-1], rough[:, :, 1:] * rough[:, :, :-1]
    if any(np.isnan(each).all() for each in lagged):
        return 0.0, 0.0
    of_white = np.array([[36, -48, -48], [-24, 42, 32], [-24, 32, 42]])
    v, a, b = np.linalg.solve(of_white, [np.nanmean(each) for each in lagged])
    if not v > 0:
        return 0.0, 0.0
    return float(np.clip(a / v, 0, _MOST_SHARED)), float(np.clip(b / v, 0, _MOST_SHARED))


def outliers(residual: Single, noise: Single, votes: Bools) -> Bools:
    """Return the nodes whose residual is too large, and not smaller than those of their eight
        neighbours.

    residual: (K, R, C). noise: (R, C), its variance. votes: (R, C).
    """
    size = np.where(votes, np.square(residual).mean(axis=0), 0)
    pairs = pairs_of(*votes.shape)
    with np.errstate(invalid="ignore"):
        large: Bools = size > REJECTED**2 * noise * (1 - pairs.pilot_own)
    if not large.any():
        return large
    padded = np.pad(size, 1)
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).max(axis=(2, 3))
    largest: Bools = large & (size >= around)
    return largest
