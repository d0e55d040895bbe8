"""Refinement (section 3.5) in float64: positions from centroids of the response."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeLines, EdgeStep, Midlines
from cmp_cl.results import GreyImage, Method


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Refined:
    """Refined corners; fields as in `cmp_cl.results.Corners`, and margin (N,) float64."""

    xy: NDArray[np.float64]
    method: NDArray[np.uint8]
    sigma: NDArray[np.float64]
    edges: NDArray[np.float64]
    doubtful: NDArray[np.bool_]
    margin: NDArray[np.float64]


def refine(
    image: GreyImage,
    start: NDArray[np.int64],
    centroid: NDArray[np.float64],
    refinement: EdgeLines | EdgeStep | Midlines | None,
    scale: float,
) -> Refined:
    """Positions without refinement: the centroids."""
    if refinement is not None:
        raise NotImplementedError(refinement)
    count = len(start)
    return Refined(
        xy=centroid,
        method=np.full(count, Method.CENTROID, np.uint8),
        sigma=np.full(count, np.nan),
        edges=np.full((count, 4), np.nan),
        doubtful=np.zeros(count, np.bool_),
        margin=np.full(count, np.inf),
    )
