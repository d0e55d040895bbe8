"""Corners by the second harmonic of eight grey levels on a ring, in integers.

On a ring around a corner the grey level rises and falls twice, so that its second harmonic is
large. Two quantities that are small at a corner are subtracted: differences between opposite
samples (the odd harmonics), and the difference of the centre from the mean of its ring.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import RingHarmonic
from cmp_cl.image import GreyImage
from cmp_cl.maps import HarmonicMaps
from cmp_cl.reference import gate, nms

Whole = NDArray[np.int64]
Ring = tuple[int, int]

LARGEST = 4080  # 255 grey levels in sixteenths
LEAST = 80  # a step of two grey levels of 255 may have this response
COARSE: Ring = (5, 4)  # distance along the axes and along the diagonals, px
MIDDLE: Ring = (4, 3)
FINE: Ring = (3, 2)
FINEST: Ring = (2, 1)
ALIGNMENT, FINE_ALIGNMENT = 8, 4
SUPPORT = 32


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Harmonics:
    """The harmonics of a ring at some pixels, each int64 of one shape.

    a, b: the second harmonic, a vector. length: about the length of that vector.
    odd: sum of the differences between opposite samples. centre: |sum of the samples - 8 C|.
    """

    a: Whole
    b: Whole
    length: Whole
    odd: Whole
    centre: Whole


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Corners:
    """The corners of a frame in raster order, with their responses and bounds.

    x, y: (N,) pixels. fine: (N,) bool, found by the 3 px ring. response: (N,) of the ring that
    found them. bounds: least responses by noise of the 5 px and of the 3 px ring.
    reference: W. maps: every intermediate image.
    """

    x: Whole
    y: Whole
    fine: NDArray[np.bool_]
    response: Whole
    bounds: tuple[int, int]
    reference: int
    maps: HarmonicMaps


def corners(
    image: GreyImage,
    rule: RingHarmonic,
    nms_radius: int,
    full_scale: int,
    mask: NDArray[np.bool_],
) -> Corners:
    """Find the corners of an image at working size.

    mask: (H, W), where maxima may be kept. Maxima elsewhere still suppress their neighbours.
    """
    once, thrice = smoothed(image, full_scale)
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    coarse_response = coarse_measure(harmonics(thrice, rows, columns, COARSE))
    bounds = noise_bounds(image, rule, full_scale)

    y, x = np.nonzero(maxima(coarse_response, bounds[0], nms_radius) & mask)
    passed = looks_alike(once, thrice, y, x, coarse_response[y, x], rule)
    y, x = y[passed], x[passed]
    level = reference(coarse_response[y, x])
    share = math.floor(128 * rule.relative + 0.5)
    clean = is_clean(coarse_response[y, x], harmonics(thrice, y, x, COARSE))
    strong = np.where(clean, 256, 128) * coarse_response[y, x] >= share * level
    kept = np.zeros(image.shape, np.bool_)
    kept[y[strong], x[strong]] = True

    fine_response = None
    fine_kept = np.zeros(image.shape, np.bool_)
    if rule.fine:
        fine_response = fine_measure(harmonics(once, rows, columns, FINE))
        y, x = np.nonzero(maxima(fine_response, bounds[1], nms_radius) & mask)
        passed = looks_alike_when_squeezed(once, y, x)
        y, x = y[passed], x[passed]
        least = (5 * share + 1) // 3 * (level or reference(fine_response[y, x]))
        strong = 128 * fine_response[y, x] >= least
        strong &= nms.largest_within(kept.astype(np.int64), nms_radius)[y, x] == 0
        fine_kept[y[strong], x[strong]] = True

    y, x = np.nonzero(kept | fine_kept)
    of_fine = fine_kept[y, x]
    response = coarse_response[y, x]
    if fine_response is not None:
        response = np.where(of_fine, fine_response[y, x], response)
    return Corners(
        x=x,
        y=y,
        fine=of_fine,
        response=response,
        bounds=bounds,
        reference=level,
        maps=HarmonicMaps(
            fine=once.astype(np.uint16),
            coarse=thrice.astype(np.uint16),
            coarse_response=coarse_response.astype(np.int32),
            fine_response=None if fine_response is None else fine_response.astype(np.int32),
            maximum=kept | fine_kept,
        ),
    )


def centroids(found: Corners) -> tuple[NDArray[np.float64], Whole]:
    """Return the centroids of the positive responses at the corners, and rounded: (N, 2) each."""
    shape = (len(found.x), 2)
    centroid, rounded = np.zeros(shape), np.zeros(shape, np.int64)
    for response, here in (
        (found.maps.coarse_response, ~found.fine),
        (found.maps.fine_response, found.fine),
    ):
        if response is not None:
            positive = np.maximum(response, 0)
            centroid[here], rounded[here] = nms.centroids(positive, found.x[here], found.y[here])
    return centroid, rounded


# --- smoothing ---------------------------------------------------------------------------


def smoothed(image: GreyImage, full_scale: int) -> tuple[Whole, Whole]:
    """Return S1 and S3: the image smoothed once and three times, 1/16 of a grey level of 255.

    Grey levels above full scale count as full scale.
    """
    grey = np.minimum(image.astype(np.int64), full_scale)
    if full_scale == 255:
        once = binomial(grey)
    else:
        once = (binomial((grey * LARGEST + full_scale // 2) // full_scale) + 8) >> 4
    twice = (binomial(once) + 8) >> 4
    return once, (binomial(twice) + 8) >> 4


def binomial(values: Whole) -> Whole:
    """Convolve with [1 2 1]^T [1 2 1], border pixels repeated."""
    padded = np.pad(values, 1, mode="edge")
    rows = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    total: Whole = rows[:, :-2] + 2 * rows[:, 1:-1] + rows[:, 2:]
    return total


# --- the ring ----------------------------------------------------------------------------


def harmonics(values: Whole, y: Whole, x: Whole, ring: Ring) -> Harmonics:
    """Sample the ring around pixels (x, y); samples outside the image repeat its border."""
    height, width = values.shape
    far, near = ring
    offsets = ((0, -far), (near, -near), (far, 0), (near, near))
    sums, odd = [], np.zeros(y.shape, np.int64)
    for dx, dy in offsets:
        one, opposite = (
            values[np.clip(y + side * dy, 0, height - 1), np.clip(x + side * dx, 0, width - 1)]
            for side in (1, -1)
        )
        sums.append(one + opposite)
        odd += np.abs(one - opposite)
    a, b = sums[0] - sums[2], sums[1] - sums[3]
    smaller, larger = np.minimum(abs(a), abs(b)), np.maximum(abs(a), abs(b))
    return Harmonics(
        a=a,
        b=b,
        length=larger + (smaller >> 2) + (smaller >> 3),
        odd=odd,
        centre=np.abs(sum(sums) - 8 * values[y, x]),
    )


def coarse_measure(seen: Harmonics) -> Whole:
    """Return R, the second harmonic minus 3/4 of the odd ones and 3/8 of the centre's
    difference."""
    response: Whole = (
        seen.length - (seen.odd - (seen.odd >> 2)) - ((seen.centre >> 2) + (seen.centre >> 3))
    )
    return response


def fine_measure(seen: Harmonics) -> Whole:
    """Return R', the second harmonic minus 3/4 of the odd ones and of the centre's difference."""
    other = seen.odd + seen.centre
    response: Whole = seen.length - (other - (other >> 2))
    return response


def _dot(one: Harmonics, other: Harmonics) -> Whole:
    product: Whole = one.a * other.a + one.b * other.b
    return product


# --- what is kept ------------------------------------------------------------------------


def noise_bounds(image: GreyImage, rule: RingHarmonic, full_scale: int) -> tuple[int, int]:
    """Return the least responses of the 5 px and of the 3 px ring from the noise of the image."""
    amplitude, pixels = gate.noise_amplitude(image)
    if not pixels:
        return LEAST, LEAST
    deviations = math.floor(334 * rule.noise + 0.5)
    coarse, fine = (
        max(LEAST, -(-factor * amplitude * 255 // (100 * pixels * full_scale)))
        for factor in (deviations, 2 * deviations)
    )
    return coarse, fine


def maxima(response: Whole, bound: int, radius: int) -> NDArray[np.bool_]:
    """Return (H, W): responses above the bound, largest in their (2 radius + 1)^2 window.

    Of equal responses the one with the lower raster index is the maximum.
    """
    key = nms.without_ties(response)
    kept: NDArray[np.bool_] = (response > bound) & (key == nms.largest_within(key, radius))
    return kept


def looks_alike(
    once: Whole, thrice: Whole, y: Whole, x: Whole, response: Whole, rule: RingHarmonic
) -> NDArray[np.bool_]:
    """Return (N,) bool, True for maxima of the 5 px ring that smaller rings confirm, and that no
        stripe causes.

    Around the middle of a stripe the grey level also rises and falls twice. But there the centre
    differs from the mean of its ring, and the small ring, inside the stripe, has a weak second
    harmonic. So the centre may differ by 11/8 of the length, and by more if the small ring's
    harmonic is strong.
    """
    small, large = harmonics(once, y, x, FINE), harmonics(thrice, y, x, COARSE)
    along, whole = _dot(small, large), _dot(large, large)
    passed: NDArray[np.bool_] = 8 * large.centre * whole <= large.length * (11 * whole + 8 * along)
    passed &= ALIGNMENT * along >= whole
    middle = coarse_measure(harmonics(thrice, y, x, MIDDLE))
    passed &= (SUPPORT * middle >= response) & (middle <= 2 * response)
    return passed


def is_clean(response: Whole, seen: Harmonics) -> NDArray[np.bool_]:
    """Return True where the response is at least 3/4 of the length of the second harmonic.

    Such a corner is weak at most in contrast: torn corners, dirt and texture lose more.
    """
    clean: NDArray[np.bool_] = 4 * response >= 3 * seen.length
    return clean


def looks_alike_when_squeezed(once: Whole, y: Whole, x: Whole) -> NDArray[np.bool_]:
    """Return (N,): the maxima of the 3 px ring that the 2 px ring confirms."""
    small, large = harmonics(once, y, x, FINEST), harmonics(once, y, x, FINE)
    passed: NDArray[np.bool_] = FINE_ALIGNMENT * _dot(small, large) >= _dot(large, large)
    return passed


def reference(responses: Whole) -> int:
    """Return W, the response at which the sum of squares, in descending order, reaches its half.

    Without responses it is 0. Many weak maxima in texture hardly lower it.
    """
    falling = np.sort(responses)[::-1]
    squares = np.cumsum(falling**2)
    if not len(falling):
        return 0
    return int(falling[np.argmax(2 * squares >= squares[-1])])
