"""The contrast gate: a candidate's four sectors must differ clearly in grey level, not only in
sign."""

import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import SectorContrast
from cmp_cl.image import GreyImage
from cmp_cl.reference.paper import ring


def gate(
    image: GreyImage,
    inner: NDArray[np.uint16],
    candidate: NDArray[np.bool_],
    outer_radius: int,
    contrast: SectorContrast,
    full_scale: int,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the contrast min(sc1, sc2), (H, W), 0 off candidates, and the kept candidates, (H, W)
        bool.

    candidate: (H, W) bool, the maxima of the response that are candidates of this binary image.
    The inner ring of a candidate is never constant: both forms of the criteria exclude it.
    """
    y, x = np.nonzero(candidate)
    sc1, sc2, sm = sector_contrast(image, x, y, inner[y, x], outer_radius)
    least = contrast_bound(sc1, contrast, full_scale)
    amplitude, pixels = noise_amplitude(image)
    factor = noise_factor(contrast)
    both = np.minimum(sc1, sc2)
    kept = (both >= least) & (2 * pixels * sm >= factor * amplitude)
    contrast_map = np.zeros(image.shape, np.int32)
    contrast_map[y, x] = both
    kept_map = np.zeros(image.shape, np.bool_)
    kept_map[y, x] = kept
    return contrast_map, kept_map


def sector_contrast(
    image: GreyImage,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    inner: NDArray[np.uint16],
    outer_radius: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return sc1, sc2 and sm, each (N,) int64, of N pixels with the bits of their inner rings.

    sc1: on the inner ring, the min over white runs of their largest grey level minus the max over
    black runs of their smallest; sc2: the same on the outer ring. sm: with m = floor(8 (sum of a
    run's inner and outer greys) / its length), the min of m over white runs minus the max over
    black runs.
    """
    inner_greys = ring.ring_greys(image, x, y, ring.INNER)
    outer_greys = ring.ring_greys(image, x, y, ring.OUTER[outer_radius])
    number, black = ring.runs(inner)
    far = np.int64(1) << 40
    white_side = np.full((3, len(x)), far)
    black_side = np.full((3, len(x)), -far)
    for run in range(number.max(initial=-1) + 1):
        here = number == run
        length = here.sum(axis=1)
        mean = 8 * np.where(here, inner_greys + outer_greys, 0).sum(axis=1) // np.maximum(length, 1)
        is_black = (here & black).any(axis=1)
        is_white = (here & ~black).any(axis=1)
        largest = [np.where(here, greys, -far).max(axis=1) for greys in (inner_greys, outer_greys)]
        smallest = [np.where(here, greys, far).min(axis=1) for greys in (inner_greys, outer_greys)]
        white_side = np.where(is_white, np.minimum(white_side, [*largest, mean]), white_side)
        black_side = np.where(is_black, np.maximum(black_side, [*smallest, mean]), black_side)
    sc1, sc2, sm = white_side - black_side
    return sc1, sc2, sm


def contrast_bound(sc1: NDArray[np.int64], contrast: SectorContrast, full_scale: int) -> int:
    """Return max(floor, ceil(relative P90)), the least contrast that passes, grey levels.

    P90 is the value of rank (9 n + 9) div 10, from 1, among sc1 of the n candidates.
    Both products are taken in float64.
    """
    floor = math.ceil(contrast.minimum * full_scale / 255)
    if not len(sc1):
        return floor
    rank = (9 * len(sc1) + 9) // 10
    p90 = int(np.sort(sc1)[rank - 1])
    return max(floor, math.ceil(contrast.relative * p90))


def noise_amplitude(image: GreyImage) -> tuple[int, int]:
    """Return A and N: the sum of |[1 -2 1]^T [1 -2 1] * I| over the N interior pixels (Immerkaer).

    Both are 0 if the image has fewer than three rows or columns.
    """
    if min(image.shape) < 3:
        return 0, 0
    second = np.diff(np.diff(image.astype(np.int64), 2, axis=0), 2, axis=1)
    return int(np.abs(second).sum()), second.size


def noise_factor(contrast: SectorContrast) -> int:
    """Return F = floor(6.68 k + .5), with k the noise bound."""
    return math.floor(6.68 * contrast.noise + 0.5)
