"""The second look: edge lines on several sets of rings around the prediction of a missing node."""

import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage

Points = NDArray[np.complex128]
Float = NDArray[np.float64]

RADII = (3, 4, 5, 6)
RINGS = np.array(  # the radii that each look uses
    [[1, 1, 1, 0], [0, 1, 1, 0], [0, 0, 1, 1], [0, 1, 1, 1], [1, 1, 0, 0]], np.bool_
)
STARTS = np.array([0, 1.5, -1.5, 1.5j, -1.5j])  # px from the prediction
LOOKS = 3  # iterations; the last step must be shorter than STILL
STILL = 0.5  # px
NEAR = 0.25  # cells from the prediction
LEAST_SINE = 0.17  # of the angle between two edge lines; with less their intersection is uncertain
SINE = 0.3  # least |sin| of the angle between the edge lines
ALONG = 0.7  # least |cos| between the line of e0 and e2 and its expected direction


def second_look(image: GreyImage, at: Points, cell: Float, line: Points) -> Points:
    """Return the corners at these predictions, (M,) complex px; NaN where none is accepted.

    image: (H, W). at: (M,) the predictions. cell: (M,), side of a cell there, px. line: (M,) unit
        numbers along the boundaries e0 and e2.

    The first accepted look is taken, in the order of the sets of rings, then of the starts.
    """
    found = _look(image, at, at, RINGS[:1].repeat(len(at), 0), cell, line)
    left = np.flatnonzero(np.isnan(found.real))
    if not len(left):
        return found
    rings = np.repeat(RINGS, len(STARTS), 0)
    starts = np.tile(STARTS, len(RINGS))
    each = left.repeat(len(starts))
    seen = _look(
        image,
        at[each],
        at[each] + np.tile(starts, len(left)),
        np.tile(rings, (len(left), 1)),
        cell[each],
        line[each],
    ).reshape(len(left), len(starts))
    first = (~np.isnan(seen.real)).argmax(axis=1)
    found[left] = seen[np.arange(len(left)), first]
    return found


def _look(
    image: GreyImage,
    at: Points,
    start: Points,
    rings: NDArray[np.bool_],
    cell: Float,
    line: Points,
) -> Points:
    before = start
    here, along, sine = edge_lines(image, start, rings)
    for _ in range(1, LOOKS):
        moved = np.flatnonzero(np.abs(np.rint(here) - np.rint(before)) > 0)
        before = here.copy()
        if len(moved):  # from the same pixel the result is the same
            here[moved], along[moved], sine[moved] = edge_lines(image, here[moved], rings[moved])
    good = (
        (np.abs(here - at) < NEAR * cell)
        & (np.abs(here - before) < STILL)
        & (np.abs(sine) > SINE)
        & (np.abs((along * line.conj()).real) > ALONG)
    )
    return np.where(good, here, complex(np.nan, np.nan))


def ring(radius: int) -> NDArray[np.complex128]:
    """Return points (x, round(sqrt(r^2 - x^2))), 0 <= x <= y, reflected, clockwise from twelve."""
    octant = [(x, round(math.sqrt(radius * radius - x * x))) for x in range(radius + 1)]
    points = {
        complex(sx * a, sy * b)
        for x, y in octant
        if x <= y
        for a, b in ((x, y), (y, x))
        for sx in (1, -1)
        for sy in (1, -1)
    }
    return np.array(sorted(points, key=lambda p: math.atan2(p.real, -p.imag) % (2 * math.pi)))


OFFSETS = tuple(ring(radius) for radius in RADII)
STARTS_OF = np.cumsum([0, *map(len, OFFSETS)])[:-1]  # of each ring among all samples
RING_OF = np.repeat(np.arange(len(RADII)), list(map(len, OFFSETS)))
SAMPLES = np.concatenate(OFFSETS)
ACROSS, DOWN = SAMPLES.real.astype(np.int64), SAMPLES.imag.astype(np.int64)
AFTER, BEFORE = (
    np.concatenate(
        [
            first + np.roll(np.arange(len(own)), by)
            for first, own in zip(STARTS_OF, OFFSETS, strict=True)
        ]
    )
    for by in (-1, 1)
)


def edge_lines(
    image: GreyImage, at: Points, rings: NDArray[np.bool_]
) -> tuple[Points, Points, Float]:
    """Return the intersection of the two edge lines around each start (EDGE_LINES).

    image: (H, W). at: (M,) complex, px. rings: (M, 4) bool, the RADII to use. The threshold comes
        from the smallest ring used.

    Returns the intersection, the direction of the line through e0 and e2, and the sine of the
    angle between the lines; NaN where fewer than two rings have four boundaries.
    """
    known = ~np.isnan(at.real)
    middle = np.rint(np.where(known, at, 0))
    samples = _samples(image, middle)
    threshold = _threshold(samples, rings.argmax(axis=1))
    valid, edges = _edge_points(samples, threshold, rings & known[:, None])
    pairs = np.zeros((*valid.shape, 2, 2), np.complex128)  # e0 e1, e2 e3; zeros add nothing
    pairs[valid] = edges.reshape(-1, 2, 2)
    total, squares = pairs.sum(2).sum(1), (pairs**2).sum(2).sum(1)
    count = valid.sum(axis=1)
    points = 2 * np.maximum(count, 1)[:, None]
    mean, spread = total / points, squares - total**2 / points
    first, second = np.sqrt(spread / np.maximum(np.abs(spread), 1e-12)).T
    sine = (first.conj() * second).imag
    enough = (count >= 2) & (np.abs(sine) > LEAST_SINE)
    gap = (mean[:, 1] - mean[:, 0]).conj() * second
    meet = middle + mean[:, 0] + gap.imag / np.where(enough, sine, 1) * first
    return np.where(enough, meet, complex(np.nan, np.nan)), first, sine


def _samples(image: GreyImage, middle: Points) -> GreyImage:
    """Return the grey levels around each start, (M, n); beyond the image its border is repeated."""
    rows, columns = image.shape
    x = middle.real.astype(np.int64)[:, None] + ACROSS
    y = middle.imag.astype(np.int64)[:, None] + DOWN
    x, y = np.minimum(np.maximum(x, 0), columns - 1), np.minimum(np.maximum(y, 0), rows - 1)
    levels: GreyImage = image[y, x]
    return levels


def _threshold(samples: GreyImage, ring_of: NDArray[np.int64]) -> Float:
    """Return the mean of the mean of the lowest and of the highest quarter of that ring, (M,)."""
    level = np.empty(len(samples))
    for number in set(ring_of.tolist()):
        some = ring_of == number
        start, own = STARTS_OF[number], len(OFFSETS[number])
        ordered = np.sort(samples[some, start : start + own], axis=1)
        quarter = own // 4
        ends = ordered[:, :quarter].sum(1) + ordered[:, -quarter:].sum(1)
        level[some] = ends / (2 * quarter)
    return level


def _edge_points(
    samples: GreyImage, threshold: Float, rings: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Points]:
    """Return a mask (M, 4) of the rings with four boundaries, and their edge points e0 to e3,
    relative to the middle.

    A ring without four boundaries is smoothed once by the majority of three samples.
    """
    black = samples < threshold[:, None]
    odd = (_transitions(black) != 4).take(RING_OF, axis=1)
    before, after = black.take(BEFORE, axis=1), black.take(AFTER, axis=1)
    majority = (black & (before | after)) | (before & after)
    black = np.where(odd, majority, black)
    valid = rings & (_transitions(black) == 4)
    row, k = np.nonzero((black != black.take(AFTER, axis=1)) & valid.take(RING_OF, axis=1))
    after_k = AFTER[k]
    d, d_after = samples[row, k] - threshold[row], samples[row, after_k] - threshold[row]
    level = d == d_after
    part = np.minimum(np.maximum(d / np.where(level, 1, d - d_after), 0), 1)
    part[level] = 0.5
    point = (SAMPLES[k] + part * (SAMPLES[after_k] - SAMPLES[k])).reshape(-1, 4)
    to_white = black[row, k].reshape(-1, 4)[:, 0]
    return valid, np.where(to_white[:, None], point[:, [1, 2, 3, 0]], point)


def _transitions(black: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Count the boundaries of each ring, (M, 4)."""
    change = (black != black.take(AFTER, axis=1)).view(np.int8)
    count: NDArray[np.int8] = np.add.reduceat(change, STARTS_OF, axis=1)
    return count
