"""Predictions for the nodes of a lattice that are missing."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]

_FILL_REACH = (3, 6)  # nodes around a hole that predict its value


def completed(positions: Array) -> Array:
    """Return positions (R, C, K), NaN where missing, with predictions there, if any is known."""
    there = np.asarray(np.isfinite(positions).all(axis=2), np.bool_)
    if there.all() or not there.any():
        return positions
    plane = bilinear_surface(positions, there)
    bent = np.where(there[..., None], positions - plane, 0).transpose(2, 0, 1)
    whole: Array = plane + filled(bent.astype(np.float32), there).transpose(1, 2, 0)
    return whole


def bilinear_surface(values: Array, votes: NDArray[np.bool_]) -> Array:
    """Return the bilinear surface that fits the values best, (R, C, K).

    values: (R, C, K). votes: (R, C) bool, the nodes to fit, at least one. The filters do not change
    such surfaces; without the surface, float32 is exact enough for the residual.
    """
    r, c = np.meshgrid(*(np.linspace(-1, 1, n) for n in votes.shape), indexing="ij")
    terms = np.stack([np.ones_like(r), r, c, r * c], axis=-1)
    fit, *_ = np.linalg.lstsq(terms[votes], values[votes], rcond=None)
    plane: Array = terms @ fit
    return plane


def filled(data: Single, votes: Bools) -> Single:
    """Return the data with predictions at nodes without a vote.

    A prediction comes from a quadratic surface through the votes around the node, and is 0 if there
    are too few.
    data: (K, R, C). votes: (R, C) bool.
    """
    result = np.where(votes, data, np.float32(0))
    holes = np.argwhere(~votes)
    for reach in _FILL_REACH:
        if not len(holes):
            break
        predicted, sure = _predicted(data, votes, holes, reach)
        at = holes[sure]
        result[:, at[:, 0], at[:, 1]] = predicted[sure].T
        holes = holes[~sure]
    return result


def _predicted(
    data: Single, votes: Bools, holes: NDArray[np.int64], reach: int
) -> tuple[Array, Bools]:
    """Return predictions (H, K) for H holes from the votes within `reach` nodes, and a mask of
    those with enough votes."""
    offset = np.arange(-reach, reach + 1)
    r, c = (
        each.reshape(-1).astype(np.float64) for each in np.meshgrid(offset, offset, indexing="ij")
    )
    terms = np.stack([np.ones_like(r), r, c, r * r, r * c, c * c], axis=1)
    near = np.exp(-(r * r + c * c) / (2 * (reach / 2) ** 2))
    rows = holes[:, 0, None] + r.astype(np.int64) + reach
    columns = holes[:, 1, None] + c.astype(np.int64) + reach
    weight = near * np.pad(votes, reach)[rows, columns]
    padded = np.pad(data, ((0, 0), (reach, reach), (reach, reach)))
    around = padded[:, rows, columns].astype(np.float64)
    normal = np.einsum("hs,si,sj->hij", weight, terms, terms)
    right = np.einsum("hs,si,khs->hik", weight, terms, around)
    ridge = np.diag([0, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])
    sure = np.count_nonzero(weight, axis=1) >= 8
    normal[~sure] = np.eye(6)
    predicted = np.linalg.solve(normal + ridge, right)[:, 0]
    return predicted, sure
