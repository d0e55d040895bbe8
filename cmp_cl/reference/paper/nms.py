"""Non-maximum suppression and the centroid of the response (section 3.5)."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import HarmonicMaps, Maps
from cmp_cl.image import GreyImage

TENT = (1, 2, 3, 2, 1)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """The corners of a frame before refinement, in raster order of their pixels.

    x, y: (N,) pixels of the octave in which each was found. halvings: (N,) of that octave.
    response: (N,). centroid, rounded: (N, 2), of the positive responses around each, in its octave.
    images: in which they are refined: the frame, and one of each octave.
    maps: every intermediate image of the frame.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    halvings: NDArray[np.int64]
    response: NDArray[np.int64]
    centroid: NDArray[np.float64]
    rounded: NDArray[np.int64]
    images: list[GreyImage]
    maps: Maps | HarmonicMaps


def score(response: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return S: the response convolved with the tent [1 2 3 2 1] x [1 2 3 2 1], 0 outside."""
    height, width = response.shape
    padded = np.pad(response, 2)
    rows = np.zeros((height, width + 4), np.int32)
    total = np.zeros((height, width), np.int32)
    for k, weight in enumerate(TENT):
        rows += weight * padded[k : k + height]
    for k, weight in enumerate(TENT):
        total += weight * rows[:, k : k + width]
    return total


def maxima(response: NDArray[np.int32], score: NDArray[np.int32], radius: int) -> NDArray[np.bool_]:
    """Return (H, W): pixels with R > 0 whose key is the largest in their (2 radius + 1)^2 window.

    The key is 10 S + R. Of equal keys the one with the lower raster index counts as larger.
    """
    key = np.where(response > 0, without_ties(10 * score.astype(np.int64) + response), -1)
    kept: NDArray[np.bool_] = (response > 0) & (key == largest_within(key, radius, outside=-1))
    return kept


def without_ties(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return keys in the same order; of equal ones that of the lower raster index is larger."""
    index = np.arange(key.size).reshape(key.shape)
    return key * key.size + (key.size - 1 - index)


def largest_within(
    values: NDArray[np.int64], radius: int, *, outside: int = -(1 << 62)
) -> NDArray[np.int64]:
    """Return the largest of the (2 radius + 1)^2 window around each pixel."""
    height, width = values.shape
    padded = np.pad(values, radius, constant_values=outside)
    window = range(2 * radius + 1)
    rows = np.max([padded[k : k + height] for k in window], axis=0)
    largest: NDArray[np.int64] = np.max([rows[:, k : k + width] for k in window], axis=0)
    return largest


def centroids(
    response: NDArray[np.int32], x: NDArray[np.int64], y: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the R-weighted centroid of 5 x 5 around N maxima, and rounded: (N, 2) each, (x, y).

    Rounded is floor((2 sum(R dx) + sum R) / (2 sum R)) beside the maximum.
    """
    padded = np.pad(response.astype(np.int64), 2)
    offsets = np.arange(-2, 3)
    patch = padded[y[:, None, None] + 2 + offsets[:, None], x[:, None, None] + 2 + offsets[None, :]]
    total = patch.sum(axis=(1, 2))
    moment = np.stack(
        [(patch * offsets).sum(axis=(1, 2)), (patch * offsets[:, None]).sum(axis=(1, 2))], axis=1
    )
    pixel = np.stack([x, y], axis=1)
    centroid = pixel + moment / total[:, None]
    rounded = pixel + (2 * moment + total[:, None]) // (2 * total[:, None])
    return centroid, rounded
