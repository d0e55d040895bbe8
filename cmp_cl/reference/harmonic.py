"""Corners by the second harmonic of eight grey levels on a ring, in integers.

On a ring around a corner the grey level rises and falls twice, so that its second harmonic is
large. Two quantities that are small at a corner are subtracted: differences between opposite
samples (the odd harmonics), and the difference of the centre from the mean of its ring.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import RingHarmonic
from cmp_cl.corners import HarmonicMaps
from cmp_cl.image import GreyImage
from cmp_cl.reference.paper import gate, nms

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
WIDE: Ring = (8, 6)
LEAST_SIDE = 48  # px, of a halved frame
OCTAVE_SHARE = 48  # least response of a corner of a halved frame, 1/128 of the reference
OCTAVE_APART = 5  # px of the halved frame: nearer to a corner found before it is that corner
STRONG = 2  # a response of half the reference needs nothing beside it
CLEAR = 8  # a fine one needs 3/4 of it, or so many times its noise bound
NEIGHBOURS = 24  # px in x and y: the corners of narrower cells have neighbours in there
ALIGNED = 7  # of them that are opposed or alike suffice
OPPOSED = 2  # of them, or no aligned one, beside one that the frame halved once has too
SEEN = 1  # px of the frame halved once
UNIT = 15  # of a direction, about


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
class Octave:
    """A frame that was halved `halvings` times, and its maxima of the 5 px ring that pass the
    checks.

    image: (H, W). once, thrice: S1 and S3. response: R5, (H, W). bound: its least by noise.
    x, y: (N,) pixels of the maxima in raster order.
    """

    halvings: int
    image: GreyImage
    once: Whole
    thrice: Whole
    response: Whole
    bound: int
    x: Whole
    y: Whole

    def levels(self) -> Whole:
        """Return the responses of the maxima."""
        return self.response[self.y, self.x]


class Candidates(NamedTuple):
    """Maxima of the frame that are strong enough, of one ring: (N,) each, direction (N, 2)."""

    x: Whole
    y: Whole
    response: Whole
    direction: Whole


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Corners:
    """The corners of a frame in raster order of their pixels, with their responses and bounds.

    x, y: (N,) pixels of the octave in which each was found. halvings: (N,) of that octave.
    fine: (N,) bool, found by the 3 px ring. response: (N,) of the ring that found them.
    centroid, rounded: (N, 2), of the positive responses around each, in its octave.
    images: of the octaves. bounds: least responses by noise of the 5 px and of the 3 px ring.
    reference: W. maps: every intermediate image of the frame.
    """

    x: Whole
    y: Whole
    halvings: Whole
    fine: NDArray[np.bool_]
    response: Whole
    centroid: NDArray[np.float64]
    rounded: Whole
    images: list[GreyImage]
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
    octaves = list(octaves_of(image, rule, nms_radius, full_scale, mask))
    frame = octaves[0]
    level = greatest = max(reference(each.levels()) for each in octaves)
    bounds = noise_bounds(image, rule, full_scale)
    rings = [(candidates(frame, rule, level), frame.response)]
    fine_response = None
    if rule.fine:
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        fine_response = fine_measure(harmonics(frame.once, rows, columns, FINE))
        y, x = np.nonzero(maxima(fine_response, bounds[1], nms_radius) & mask)
        passed = looks_alike_when_squeezed(frame.once, y, x)
        y, x = y[passed], x[passed]
        level = level or reference(fine_response[y, x])
        strong = 128 * fine_response[y, x] >= rule.fine_share * level
        y, x = y[strong], x[strong]
        direction = direction_of(harmonics(frame.once, y, x, FINE))
        rings.append((Candidates(x, y, fine_response[y, x], direction), fine_response))
    every = Candidates(*map(np.concatenate, zip(*(found for found, _ in rings), strict=True)))

    kept = np.zeros(image.shape, np.bool_)
    found = []
    for is_fine, (each, response) in enumerate(rings):
        free = nms.largest_within(kept.astype(np.int64), nms_radius)[each.y, each.x] == 0
        if len(octaves) > 1:
            weak = STRONG * each.response < level
            if is_fine:
                close = each.response < CLEAR * bounds[1]
                weak |= close & (4 * each.response < 3 * level)
            weak &= free
            asked = Candidates(*(of[weak] for of in each))
            opposed, aligned, askew = around(asked, every, nms_radius)
            seen = is_seen(asked, octaves[1], rule, level)
            seen &= (aligned == 0) | (opposed >= OPPOSED)
            free[weak] = (opposed >= 2 * askew) & (seen | (aligned >= ALIGNED))
        x, y = each.x[free], each.y[free]
        kept[y, x] = True
        found.append((x, y, frame, response, bool(is_fine)))
    for octave in octaves[1:]:
        strong = of_octave(octave, level) & far_from(kept, octave)
        x, y = octave.x[strong], octave.y[strong]
        kept[to_frame(y, octave.halvings), to_frame(x, octave.halvings)] = True
        found.append((x, y, octave, octave.response, False))

    parts = []
    for x, y, octave, response, is_fine in found:
        centroid, rounded = nms.centroids(np.maximum(response, 0), x, y)
        alike = np.full(len(x), is_fine), np.full(len(x), octave.halvings)
        parts.append((x, y, *alike, response[y, x], centroid, rounded))
    x, y, fine, halvings, levels, centroid, rounded = map(np.concatenate, zip(*parts, strict=True))
    order = np.lexsort((to_frame(x, halvings), to_frame(y, halvings)))
    return Corners(
        x=x[order],
        y=y[order],
        halvings=halvings[order],
        fine=fine[order],
        response=levels[order],
        centroid=centroid[order],
        rounded=rounded[order],
        images=[each.image for each in octaves],
        bounds=bounds,
        reference=greatest,
        maps=HarmonicMaps(
            fine=frame.once.astype(np.uint16),
            coarse=frame.thrice.astype(np.uint16),
            coarse_response=frame.response.astype(np.int32),
            fine_response=None if fine_response is None else fine_response.astype(np.int32),
            maximum=kept,
        ),
    )


# --- octaves -----------------------------------------------------------------------------


def octaves_of(
    image: GreyImage,
    rule: RingHarmonic,
    nms_radius: int,
    full_scale: int,
    mask: NDArray[np.bool_],
) -> Iterator[Octave]:
    """Yield the frame, and then halved frames while the shorter side has LEAST_SIDE px."""
    for halvings in range(rule.octaves + 1):
        if halvings:
            image = halved(image)
            if min(image.shape) < LEAST_SIDE:
                return
        once, thrice = smoothed(image, full_scale)
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        response = coarse_measure(harmonics(thrice, rows, columns, COARSE))
        bound = noise_bounds(image, rule, full_scale)[0]
        allowed = mask[to_frame(rows, halvings), to_frame(columns, halvings)]
        y, x = np.nonzero(maxima(response, bound, nms_radius) & allowed)
        passed = looks_alike(once, thrice, y, x, response[y, x])
        yield Octave(
            halvings=halvings,
            image=image,
            once=once,
            thrice=thrice,
            response=response,
            bound=bound,
            x=x[passed],
            y=y[passed],
        )


def halved(image: GreyImage) -> GreyImage:
    """Return the image at half size, (sum of 2 x 2 + 2) >> 2; an odd last row or column is left
    out."""
    height, width = (length & ~1 for length in image.shape)
    grey = image[:height, :width].astype(np.int64)
    total = grey[::2, ::2] + grey[1::2, ::2] + grey[::2, 1::2] + grey[1::2, 1::2]
    half = (total + 2) >> 2
    return half.astype(np.uint8) if image.dtype == np.uint8 else half.astype(np.uint16)


def to_frame(pixel: Whole, halvings: int | Whole) -> Whole:
    """Return the pixel of the frame nearest to a pixel of a halved frame, along one axis.

    That pixel lies at (p + .5) 2^n - .5; of two as near, the later one.
    """
    return (pixel << halvings) + (1 << np.asarray(halvings) >> 1)


def candidates(frame: Octave, rule: RingHarmonic, level: int) -> Candidates:
    """Return the maxima of the frame that are strong enough against the reference.

    Clean ones may be half as strong; with octaves only if the ring of 8 px responds half as much:
    noise that looks like a corner on one ring is independent of it on the next.
    """
    response, seen = frame.levels(), harmonics(frame.thrice, frame.y, frame.x, COARSE)
    clean = is_clean(response, seen)
    if rule.octaves:
        clean &= 2 * wide_response(frame) >= response
    strong = np.where(clean, 256, 128) * response >= rule.coarse_share * level
    return Candidates(*(of[strong] for of in (frame.x, frame.y, response, direction_of(seen))))


def of_octave(octave: Octave, level: int) -> NDArray[np.bool_]:
    """Return (N,): the maxima of a halved frame that are at least a share of the reference, and to
    which the ring of 8 px responds at least a quarter as much."""
    response = octave.levels()
    strong: NDArray[np.bool_] = 128 * response >= OCTAVE_SHARE * level
    return strong & (4 * wide_response(octave) >= response)


def is_seen(asked: Candidates, half: Octave, rule: RingHarmonic, level: int) -> NDArray[np.bool_]:
    """Return (N,): whether the halved frame has a maximum within SEEN of the pixel that a candidate
    lies in, in both axes.

    There, noise is weaker, and independent of that of the frame; the corners of wide cells stay.
    """
    there = 128 * half.levels() >= rule.coarse_share * level
    apart_x = np.abs((asked.x[:, None] >> 1) - half.x[there])
    apart_y = np.abs((asked.y[:, None] >> 1) - half.y[there])
    seen: NDArray[np.bool_] = (np.maximum(apart_x, apart_y) <= SEEN).any(axis=1)
    return seen


def direction_of(seen: Harmonics) -> Whole:
    """Return (N, 2), the second harmonic at a length of about UNIT, rounded."""
    vector, length = np.stack([seen.a, seen.b], axis=1), seen.length[:, None]
    direction: Whole = (2 * UNIT * vector + length) // np.maximum(2 * length, 1)
    return direction


def around(asked: Candidates, every: Candidates, nms_radius: int) -> Whole:
    """Return (3, N): how many of the candidates around one are opposed to it, how many are opposed
    or alike, and how many askew.

    Those of a checkerboard are opposed or alike; those of noise have any direction.
    """
    found = np.zeros((3, len(asked.x)), np.int64)
    for n, (x, y, _, direction) in enumerate(zip(*asked, strict=True)):
        apart = np.maximum(np.abs(every.x - x), np.abs(every.y - y))
        near = every.direction[(apart > nms_radius) & (apart <= NEIGHBOURS)]
        along = near @ direction
        askew = 3 * along**2 < 2 * (direction @ direction) * (near**2).sum(axis=1)
        found[:, n] = (~askew & (along < 0)).sum(), (~askew).sum(), askew.sum()
    return found


def wide_response(octave: Octave) -> Whole:
    """Return (N,), the response of the ring of 8 px at the maxima."""
    return coarse_measure(harmonics(octave.thrice, octave.y, octave.x, WIDE))


def far_from(kept: NDArray[np.bool_], octave: Octave) -> NDArray[np.bool_]:
    """Return (N,): the maxima of a halved frame without a corner within OCTAVE_APART of its px in
    both axes.

    kept: (H, W), the corners of the frame and of the octaves before. A corner of an octave is at
        its place in that octave, half a px of the frame before its pixel here, which decides alike.
    """
    size = 2**octave.halvings
    corner_y, corner_x = (2 * at + 1 for at in np.nonzero(kept))  # twice the place, and one more
    x, y = ((2 * at + 1) * size for at in (octave.x, octave.y))
    near = np.zeros(len(x), np.bool_)
    for n in range(len(x)):
        beside = np.maximum(abs(corner_x - x[n]), abs(corner_y - y[n]))
        near[n] = (beside <= 2 * OCTAVE_APART * size).any()
    return ~near


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
    once: Whole, thrice: Whole, y: Whole, x: Whole, response: Whole
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
