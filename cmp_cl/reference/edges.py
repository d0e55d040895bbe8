"""Edge points around a corner, and lines through them (section 3.5, Fig. 9), in float64.

Three rings around the rounded centroid of the response meet the four boundaries between
black and white sectors. Boundaries are e0 to e3 clockwise, e0 from white to black, so that e0
to e1 and e2 to e3 are black. All positions are relative to the rounded centroid, the start.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage
from cmp_cl.reference.paper.ring import ring_greys

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RADII = (3, 4, 5)  # px
LEAST_POINTS = 3  # of a line
LEAST_SIN = 0.17  # least sine of the angle between two lines


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class EdgePoints:
    """The points at which the rings around N starts cross their four boundaries.

    point: (N, 3, 4, 2) per ring and boundary, (x, y) from the start.
    valid: (N, 3) rings that have four boundaries.
    seen: (N, 3, 4) points of valid rings that lie in the image: where rings leave it, border pixels
        are repeated, which bends edges.
    direction: (N, 4, 2) per boundary the sum of the unit vectors to its points on valid rings.
    margin: (N,) as in `Refined`.
    """

    point: Floats
    valid: Bools
    seen: Bools
    direction: Floats
    margin: Floats


def circle(radius: int) -> tuple[tuple[int, int], ...]:
    """Return the refinement ring of a radius, (dx, dy) clockwise from twelve o'clock.

    The points are (x, round(sqrt(r^2 - x^2))) for 0 <= x <= y, and their reflections: 16, 24 and 28
    for the radii 3, 4 and 5.
    """
    octant = [(x, round(math.sqrt(radius**2 - x**2))) for x in range(radius + 1)]
    octant = [(x, y) for x, y in octant if x <= y]
    ring = {
        (a * sign_a, b * sign_b)
        for x, y in octant
        for a, b in ((x, y), (y, x))
        for sign_a in (-1, 1)
        for sign_b in (-1, 1)
    }
    return tuple(sorted(ring, key=lambda point: math.atan2(point[0], -point[1]) % math.tau))


def ring_samples(image: GreyImage, start: NDArray[np.int64], radius: int) -> tuple[Floats, Floats]:
    """Return (samples, 2) offsets and (N, samples) grey levels of a refinement ring."""
    x, y = start.T
    offsets = circle(radius)
    return np.array(offsets, np.float64), ring_greys(image, x, y, offsets).astype(np.float64)


def threshold(grey: Floats) -> Floats:
    """Return the middle between the means of the lowest and the highest quarter of a ring, (N,)."""
    ordered = np.sort(grey, axis=1)
    quarter = grey.shape[1] // 4
    low, high = ordered[:, :quarter].mean(axis=1), ordered[:, -quarter:].mean(axis=1)
    result: Floats = (low + high) / 2
    return result


def edge_points(image: GreyImage, start: NDArray[np.int64]) -> EdgePoints:
    """Match the edge points of all rings.

    If the first black sector of a ring lies opposite that of the smallest valid ring, its (e0, e1)
    and (e2, e3) are swapped.
    """
    rings = [ring_samples(image, start, radius) for radius in RADII]
    level = threshold(rings[0][1])
    found = [_ring_edges(offset, grey - level[:, None]) for offset, grey in rings]
    point = np.stack([each[0] for each in found], axis=1)
    valid = np.stack([each[1] for each in found], axis=1)

    axis = (point[:, :, 0] + point[:, :, 1] - point[:, :, 2] - point[:, :, 3]) / 2
    smallest = axis[np.arange(len(start)), np.argmax(valid, axis=1)]
    dot = (axis * smallest[:, None]).sum(axis=2)
    point = np.where((dot < 0)[..., None, None], np.roll(point, 2, axis=2), point)
    cosine = np.abs(dot) / np.maximum(norm(axis) * norm(smallest)[:, None], 1e-12)
    margin = np.where(valid, cosine, np.inf).min(axis=1)

    unit = point / np.maximum(norm(point), 1e-12)[..., None]
    direction = np.where(valid[..., None, None], unit, 0).sum(axis=1)
    place = point + start[:, None, None]
    last = np.array(image.shape[::-1]) - 0.5
    seen = valid[..., None] & ((place >= -0.5) & (place <= last)).all(axis=3)
    return EdgePoints(point=point, valid=valid, seen=seen, direction=direction, margin=margin)


def _ring_edges(offset: Floats, d: Floats) -> tuple[Floats, Bools]:
    """Return the edge points (N, 4, 2), and whether there are four (N,).

    d: (N, samples) grey minus threshold, black where negative. A ring without four boundaries is
        smoothed once by the majority of three samples.
    """
    black = d < 0
    four = _changes(black).sum(axis=1) == 4
    votes = black.astype(np.int64) + np.roll(black, 1, axis=1) + np.roll(black, -1, axis=1)
    black = np.where(four[:, None], black, votes >= 2)
    changes = _changes(black)
    four = changes.sum(axis=1) == 4

    first_four = np.argsort(~changes, axis=1, kind="stable")[:, :4]
    rows = np.arange(len(d))[:, None]
    to_white = black[rows[:, 0], first_four[:, 0]]
    boundary = np.where(to_white[:, None], np.roll(first_four, -1, axis=1), first_four)
    after = (boundary + 1) % d.shape[1]
    near, far = d[rows, boundary], d[rows, after]
    difference = near - far
    with np.errstate(invalid="ignore", divide="ignore"):
        fraction = np.where(difference == 0, 0.5, np.clip(near / difference, 0, 1))
    point = offset[boundary] + fraction[..., None] * (offset[after] - offset[boundary])
    return point, four


def _changes(black: Bools) -> Bools:
    """Return whether sample k and the next differ in colour."""
    changes: Bools = black != np.roll(black, -1, axis=1)
    return changes


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """N lines: a point on each (N, 2), its angle (N,), its residual and its margin.

    residual: (N,) mean of the squared distances of the points from the line.
    margin: (N,) in 0..1, 0 if the points have no direction.
    """

    centre: Floats
    angle: Floats
    residual: Floats
    margin: Floats


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Meeting:
    """The intersections of N pairs of lines: position (N, 2) from the start, accepted, margin
    (N,)."""

    position: Floats
    accepted: Bools
    margin: Floats


def fit_lines(point: Floats, valid: Bools) -> Lines:
    """Fit lines to the valid ones of (N, K, 2) points by total least squares."""
    weight = valid[..., None].astype(np.float64)
    count = np.maximum(weight.sum(axis=1), 1)
    centre = (weight * point).sum(axis=1) / count
    dx, dy = np.moveaxis(np.where(valid[..., None], point - centre[:, None], 0), 2, 0)
    sxx, syy, sxy = (dx * dx).sum(axis=1), (dy * dy).sum(axis=1), (dx * dy).sum(axis=1)
    spread = np.hypot(sxx - syy, 2 * sxy)
    return Lines(
        centre=centre,
        angle=np.arctan2(2 * sxy, sxx - syy) / 2,
        residual=np.maximum(sxx + syy - spread, 0) / 2 / count[:, 0],
        margin=spread / np.maximum(sxx + syy, 1e-12),
    )


def both_lines(points: EdgePoints) -> tuple[Lines, Lines]:
    """Return the line through e0 and e2, and the one through e1 and e3."""
    return fit_lines(*line_points(points, 0)), fit_lines(*line_points(points, 1))


def line_points(points: EdgePoints, first: int) -> tuple[Floats, Bools]:
    """Return the points of the boundaries `first` and `first` + 2 on all rings, (N, 6, 2), and a
    mask of those that are seen, (N, 6)."""
    chosen, _ = boundary_points(points, (first, first + 2))
    return chosen, points.seen[:, :, [first, first + 2]].reshape(len(chosen), -1)


def enough_points(points: EdgePoints) -> Bools:
    """Return whether two rings have four boundaries, and each line has LEAST_POINTS, (N,)."""
    counts = [line_points(points, first)[1].sum(axis=1) for first in (0, 1)]
    enough: Bools = (points.valid.sum(axis=1) >= 2) & (np.min(counts, axis=0) >= LEAST_POINTS)
    return enough


def boundary_points(points: EdgePoints, boundaries: tuple[int, ...]) -> tuple[Floats, Bools]:
    """Return the points of some boundaries on all rings, (N, K, 2), and a mask of valid ones, (N,
    K)."""
    chosen = points.point[:, :, list(boundaries)]
    valid = np.repeat(points.valid, len(boundaries), axis=1)
    return chosen.reshape(len(chosen), -1, 2), valid


def intersect(first: Lines, second: Lines) -> Meeting:
    """Return the intersections, accepted if |sin| of the angle between the lines exceeds
    LEAST_SIN."""
    sin = np.sin(second.angle - first.angle)
    accepted = np.abs(sin) > LEAST_SIN
    a, b = along_of(first), along_of(second)
    distance = cross(second.centre - first.centre, b) / np.where(accepted, sin, 1)
    margin = np.abs(np.abs(sin) - LEAST_SIN) / LEAST_SIN
    return Meeting(
        position=first.centre + distance[:, None] * a,
        accepted=accepted,
        margin=np.min([margin, first.margin, second.margin], axis=0),
    )


def bounded(meeting: Meeting, quantity: Floats, most: float) -> Meeting:
    """Return the intersections, accepted only if a quantity (N,) is at most a bound."""
    near = np.abs(quantity - most) / max(most, 1e-6)
    return Meeting(
        position=meeting.position,
        accepted=meeting.accepted & (quantity <= most),
        margin=np.minimum(meeting.margin, np.where(meeting.accepted, near, np.inf)),
    )


def within(meeting: Meeting, max_shift: float) -> Meeting:
    """Return the intersections, accepted only within max_shift of the start."""
    return bounded(meeting, norm(meeting.position), max_shift)


def along_of(line: Lines) -> Floats:
    """Return (N, 2): a unit vector along each line."""
    return np.stack([np.cos(line.angle), np.sin(line.angle)], axis=1)


def normal_of(line: Lines) -> Floats:
    """Return (N, 2): a unit normal of each line; its sign drops out, with that of c."""
    return np.stack([-np.sin(line.angle), np.cos(line.angle)], axis=1)


def norm(vector: Floats) -> Floats:
    result: Floats = np.sqrt((vector * vector).sum(axis=-1))
    return result


def cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
