"""The bilinear surface of a lattice."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
