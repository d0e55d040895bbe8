"""Corners by the second harmonic of eight grey levels on a ring, in integers.

On a ring around a corner the grey level rises and falls twice, so that its second harmonic is
large. Two quantities that are small at a corner are subtracted: differences between opposite
samples (the odd harmonics), and the difference of the centre from the mean of its ring.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

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
CLEAN, DEEP = 1, 2
LEAST_SIDE = 48  # px, of a halved frame
OCTAVE_WIDE = 4  # the ring of 8 px responds at least one in so many
OCTAVE_SHARE = 48  # least response of a corner of a halved frame, 1/128 of the reference
OCTAVE_APART = 5  # px of the halved frame: nearer to a corner found before it is that corner
STRONG = 1.5  # one in so many of the reference is a response that needs nothing beside it
OUTDONE = 2  # a frame may be noise if its own reference is less than one in so many of W
NEIGHBOURS = 32  # px of the octave, x and y: corners of narrower cells have neighbours in there
SEEN = 1.5  # px of the next octave
ASKEW, CONFIRMED = 2, 6  # a neighbour that is askew, and the next octave, in aligned neighbours
NEEDED, SPARED = 16, 20  # of them for a response of 0 in the frame, and fewer by this times R/W
UNIT = 15  # of a direction, about


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Harmonics:
    """The harmonics of a ring at some pixels, each int64 of one shape.

    a, b: the second harmonic, a vector. length: about the length of that vector.
    odd: sum of the differences between opposite samples. total: sum of the samples.
    centre: |total - 8 C|.
    """

    a: Whole
    b: Whole
    length: Whole
    odd: Whole
    total: Whole
    centre: Whole


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Maxima:
    """The maxima of one ring in a frame that was halved `halvings` times, in raster order, that
    pass the checks.

    fine: whether the ring is that of 3 px. x, y: (N,) pixels of the halved frame. response, length,
    total: (N,), of the ring. wide: (N,), the response of the ring of 8 px; 0 if `fine`. direction:
    (N, 2), of the second harmonic, about UNIT long.
    """

    halvings: int
    fine: bool
    x: Whole
    y: Whole
    response: Whole
    length: Whole
    wide: Whole
    total: Whole
    direction: Whole

    def of(self, some: NDArray[np.bool_]) -> "Maxima":
        """Return some of them."""
        lists: dict[str, Any] = {
            name: values[some]
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return dataclasses.replace(self, **lists)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Layer:
    """The frame or a halved one as one ring sees it: S1, S3, responses, (H, W) each, and the
    maxima."""

    once: Whole
    thrice: Whole
    response: Whole
    maxima: Maxima


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Corners(nms.Found):
    """The corners of a frame; their images are the frame, and S3 of each octave.

    fine: (N,) bool, found by the 3 px ring. bounds: least responses by noise of the 5 px and of the
    3 px ring. reference: W.
    """

    fine: NDArray[np.bool_]
    bounds: tuple[int, int]
    reference: int


def corners(
    image: GreyImage,
    rule: RingHarmonic,
    nms_radius: int,
    full_scale: int,
    mask: NDArray[np.bool_],
) -> Corners:
    """Find the corners of an image.

    mask: (H, W), where maxima may be kept. Maxima elsewhere still suppress their neighbours.
    """
    layers = list(layers_of(image, rule, nms_radius, full_scale, mask))
    coarse = [each for each in layers if not each.maxima.fine]
    level, kept = decided([each.maxima for each in layers], rule, nms_radius)
    maximum = np.zeros(image.shape, np.bool_)
    parts: list[dict[str, NDArray[Any]]] = []
    for layer, found in zip(layers, kept, strict=True):
        centroid, rounded = nms.centroids(np.maximum(layer.response, 0), found.x, found.y)
        each = dict(x=found.x, y=found.y, response=found.response)
        each |= {name: np.full(len(found.x), vars(found)[name]) for name in ("fine", "halvings")}
        parts.append(each | dict(centroid=centroid, rounded=rounded))
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    y, x = (in_frame(whole[axis], whole["halvings"]) for axis in "yx")
    maximum[y, x] = True
    order = np.lexsort((x, y))
    fine_response = layers[1].response.astype(np.int32) if rule.fine else None
    return Corners(
        **{name: values[order] for name, values in whole.items()},
        images=[image, *(in_levels(each.thrice, image.dtype) for each in coarse[1:])],
        bounds=noise_bounds(image, rule, full_scale),
        reference=level,
        maps=HarmonicMaps(
            fine=layers[0].once.astype(np.uint16),
            coarse=layers[0].thrice.astype(np.uint16),
            coarse_response=layers[0].response.astype(np.int32),
            fine_response=fine_response,
            maximum=maximum,
        ),
    )


# --- the maxima of every octave ------------------------------------------------------------


def layers_of(
    image: GreyImage,
    rule: RingHarmonic,
    nms_radius: int,
    full_scale: int,
    mask: NDArray[np.bool_],
) -> Iterator[Layer]:
    """Yield the frame as the ring of 5 px sees it, as that of 3 px sees it, and then halved frames
    while the shorter side has LEAST_SIDE px."""
    for halvings in range(rule.octaves + 1):
        if halvings:
            image = halved(image)
            if min(image.shape) < LEAST_SIDE:
                return
        once, thrice = smoothed(image, full_scale)
        rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
        allowed = mask[in_frame(rows, halvings), in_frame(columns, halvings)]
        bounds = noise_bounds(image, rule, full_scale)
        for fine in (False, True) if rule.fine and not halvings else (False,):
            plane, ring, measure = (
                (once, FINE, fine_measure) if fine else (thrice, COARSE, coarse_measure)
            )
            response = measure(harmonics(plane, rows, columns, ring))
            y, x = np.nonzero(maxima(response, bounds[fine], nms_radius) & allowed)
            passed = (
                looks_alike_when_squeezed(once, y, x)
                if fine
                else looks_alike(once, thrice, y, x, response[y, x])
            )
            y, x = y[passed], x[passed]
            seen = harmonics(plane, y, x, ring)
            wide = coarse_measure(harmonics(thrice, y, x, WIDE))
            found = Maxima(
                halvings=halvings,
                fine=fine,
                x=x,
                y=y,
                response=response[y, x],
                length=seen.length,
                wide=np.where(fine, 0, wide),
                total=seen.total,
                direction=direction_of(seen),
            )
            yield Layer(once=once, thrice=thrice, response=response, maxima=found)


def halved(image: GreyImage) -> GreyImage:
    """Return the image at half size, (sum of 2 x 2 + 2) >> 2; an odd last row or column is left
    out."""
    height, width = (length & ~1 for length in image.shape)
    grey = image[:height, :width].astype(np.int64)
    total = grey[::2, ::2] + grey[1::2, ::2] + grey[::2, 1::2] + grey[1::2, 1::2]
    half = (total + 2) >> 2
    return half.astype(np.uint8) if image.dtype == np.uint8 else half.astype(np.uint16)


def in_frame(pixel: Whole, halvings: int | Whole) -> Whole:
    """Return the pixel of the frame nearest to a pixel of a halved frame, along one axis.

    That pixel lies at (p + .5) 2^n - .5; of two as near, the later one.
    """
    return (pixel << halvings) + (1 << np.asarray(halvings) >> 1)


def direction_of(seen: Harmonics) -> Whole:
    """Return (N, 2), the second harmonic at a length of about UNIT, rounded."""
    vector, length = np.stack([seen.a, seen.b], axis=1), seen.length[:, None]
    return (2 * UNIT * vector + length) // np.maximum(2 * length, 1)


# --- which of them are corners -------------------------------------------------------------


def decided(
    layers: Sequence[Maxima], rule: RingHarmonic, nms_radius: int
) -> tuple[int, list[Maxima]]:
    """Return the reference W, and which maxima of each layer are corners.

    One of the ring of 3 px must be far from those of 5 px, and one of a halved frame from all
    before it. W is the greatest reference of the frame and of its halves: noise fades with halving,
    corners do not.
    """
    octaves = [each for each in layers if not each.fine]
    references = [reference(each.response) for each in octaves]
    level = max(references)
    strong = [strong_enough(each, rule, level) for each in layers]
    enough = [
        each.of((256 << weakened(each)) * each.response >= rule.coarse_share * level)
        for each in octaves
    ]
    every = [[each for each in strong if not each.halvings], *([each] for each in enough[1:])]
    kept: list[Maxima] = []
    for each in strong:
        n, reach = each.halvings, OCTAVE_APART if each.halvings else nms_radius
        corner = ~is_near(each, kept, reach)
        if n + 1 < len(octaves):
            weak = (STRONG * each.response < level) | (OUTDONE * references[0] < level)
            asked = corner & (weak | (n > 0))
            corner[asked] = ~is_lone(each.of(asked), every[n], enough[n + 1], level, nms_radius)
        kept.append(each.of(corner))
    return level, kept


def strong_enough(found: Maxima, rule: RingHarmonic, level: int) -> Maxima:
    """Return the maxima that are strong enough against the reference.

    In a halved frame only deep ones may be weaker, and the ring of 8 px must respond a quarter as
    much: noise that looks like a corner on one ring is independent of it on the next.
    """
    if found.fine:
        return found.of(128 * found.response >= rule.fine_share * level)
    if found.halvings:
        strong = (128 << (weakened(found) & DEEP)) * found.response >= OCTAVE_SHARE * level
        return found.of(strong & (OCTAVE_WIDE * found.wide >= found.response))
    return found.of((128 << weakened(found)) * found.response >= rule.coarse_share * level)


def weakened(found: Maxima) -> Whole:
    """Return how often each response may be half as weak: DEEP times if it is a fifth of the
    samples' sum, weak at most in light, which multiplies both; else CLEAN times if little was
    subtracted from the length, weak at most in contrast; dirt loses more."""
    deep, clean = 5 * found.response >= found.total, 4 * found.response >= 3 * found.length
    return np.where(deep, DEEP, np.where(clean, CLEAN, 0))


def is_lone(
    asked: Maxima, every: Sequence[Maxima], following: Maxima, level: int, nms_radius: int
) -> NDArray[np.bool_]:
    """Return which maxima of an octave have less evidence beside them than they need.

    every: the neighbours: aligned ones are evidence for a corner, and askew ones against it.
    following: the maxima of the next octave. Noise is weaker there, and independent of that before;
        the corners of wide cells stay, and need no more if no neighbour is askew.
    level: W. In the frame a weak response needs more.
    """
    aligned, askew = around(asked, every, nms_radius)
    seen = is_near(asked, [following], SEEN)
    evidence = aligned - ASKEW * askew + CONFIRMED * seen
    needed = 0 if asked.halvings else NEEDED * level - SPARED * asked.response
    lone: NDArray[np.bool_] = (level * evidence < needed) & ((askew > 0) | ~seen)
    return lone


def is_near(found: Maxima, others: Sequence[Maxima], reach: float) -> NDArray[np.bool_]:
    """Return (N,): whether one of the others is within reach in x and in y, px of the smaller of
    the two frames."""
    near = np.zeros(len(found.x), np.bool_)
    for other in others:
        size, others_size = 2**found.halvings, 2**other.halvings
        x, y = ((2 * at + 1) * others_size for at in (other.x, other.y))  # twice the place, and 1
        furthest = 2 * reach * max(size, others_size)
        for n in range(len(near)):
            apart_x = np.abs(x - (2 * found.x[n] + 1) * size)
            apart_y = np.abs(y - (2 * found.y[n] + 1) * size)
            near[n] |= (np.maximum(apart_x, apart_y) <= furthest).any()
    return near


def around(asked: Maxima, every: Sequence[Maxima], nms_radius: int) -> Whole:
    """Return (2, N): how many maxima around each are aligned with it, opposed or alike, and how
    many are askew.

    Those of a checkerboard are aligned; those of noise have any direction, and more than half of
    them are askew.
    """
    x, y, direction = (
        np.concatenate([getattr(each, name) for each in every]) for name in ("x", "y", "direction")
    )
    found = np.zeros((2, len(asked.x)), np.int64)
    for n, own in enumerate(asked.direction):
        apart = np.maximum(np.abs(x - asked.x[n]), np.abs(y - asked.y[n]))
        near = direction[(apart > nms_radius) & (apart <= NEIGHBOURS)]
        askew = 3 * (near @ own) ** 2 < 2 * (own @ own) * (near**2).sum(axis=1)
        found[:, n] = (~askew).sum(), askew.sum()
    return found


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


def in_levels(plane: Whole, dtype: np.dtype[Any]) -> GreyImage:
    """Return a smoothed image as one of pixels: in grey levels of 255 if they have 8 bits, else in
    sixteenths of these."""
    return ((plane + 8) >> 4).astype(np.uint8) if dtype == np.uint8 else plane.astype(np.uint16)


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
    a, b, total = sums[0] - sums[2], sums[1] - sums[3], np.sum(sums, axis=0)
    smaller, larger = np.minimum(abs(a), abs(b)), np.maximum(abs(a), abs(b))
    return Harmonics(
        a=a,
        b=b,
        length=larger + (smaller >> 2) + (smaller >> 3),
        odd=odd,
        total=total,
        centre=np.abs(total - 8 * values[y, x]),
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
    return seen.length - (other - (other >> 2))


def _dot(one: Harmonics, other: Harmonics) -> Whole:
    return one.a * other.a + one.b * other.b


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


def looks_alike_when_squeezed(once: Whole, y: Whole, x: Whole) -> NDArray[np.bool_]:
    """Return (N,): the maxima of the 3 px ring that the 2 px ring confirms."""
    small, large = harmonics(once, y, x, FINEST), harmonics(once, y, x, FINE)
    return FINE_ALIGNMENT * _dot(small, large) >= _dot(large, large)


def reference(responses: Whole) -> int:
    """Return W, the response at which the sum of squares, in descending order, reaches its half.

    Without responses it is 0. Many weak maxima in texture hardly lower it.
    """
    falling = np.sort(responses)[::-1]
    squares = np.cumsum(falling**2)
    if not len(falling):
        return 0
    return int(falling[np.argmax(2 * squares >= squares[-1])])
