"""Predictions for the nodes of a lattice that are missing."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Bools = NDArray[np.bool_]

_FILL_REACH = (3, 6)  # nodes around a hole that predict its value


def filled(data: Single, votes: Bools) -> Single:
    """Return the data with predictions where there is no vote: a quadratic surface through the
    votes around, 0 where those are too few.
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
    """Return (H, K) predictions for H nodes from what lies within `reach`, and whether they are
    sure."""
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
