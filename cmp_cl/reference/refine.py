"""Refinement on the grey image (section 3.5, Fig. 9), in float64.

Three rings around the rounded centroid of the response meet the four boundaries between
black and white sectors; lines through those edge points meet at the corner. Boundaries are
e0 to e3 clockwise, e0 from white to black, so that e0 to e1 and e2 to e3 are black.

All positions are relative to the rounded centroid, the start. With a working scale s every
length in px that is given for the working image is divided by s: radii, the largest shift,
the largest step.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeLines, EdgeStep, Fit, Midlines
from cmp_cl.corners import Method, Refusal
from cmp_cl.image import GreyImage
from cmp_cl.reference.ring import ring_greys

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RADII = (3, 4, 5)
LEAST_SIN = 0.17
LARGEST_RESIDUAL = 0.5
STEP_SHIFT = 2.0
LARGEST_STEP = 0.3
BLUR = 1.2
LEAST_CONTRAST = 1e-3
LEAST_DETERMINANT = 1e-3
DOUBT = 0.010
# px: what bent edges, shading and sampling add to the noise of a position on perfect prints
LINES_ERROR = 0.02
STEP_ERROR = 0.01


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Refined:
    """Refined corners; fields as in `cmp_cl.corners.Corners`, all float64, and

    margin: (N,) the smallest relative distance of a guard's quantity from its bound. A
        float32 implementation may decide otherwise where it is below about 1e-4.
    """

    xy: Floats
    method: NDArray[np.uint8]
    refusal: NDArray[np.uint8]
    sigma: Floats
    edges: Floats
    doubtful: Bools
    margin: Floats


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class EdgePoints:
    """Where the rings around N starts meet their four boundaries.

    point: (N, 3, 4, 2) per ring and boundary, (x, y) from the start.
    valid: (N, 3) rings that have four boundaries.
    direction: (N, 4, 2) per boundary the sum of the unit vectors to its points on valid rings.
    margin: (N,) as in `Refined`.
    """

    point: Floats
    valid: Bools
    direction: Floats
    margin: Floats


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Lines:
    """N lines: a point on each (N, 2), its angle (N,), and how far it is from a round blob.

    residual: (N,) mean of the squared distances of the points from the line.
    margin: (N,) in 0..1, 0 where the points have no direction.
    """

    centre: Floats
    angle: Floats
    residual: Floats
    margin: Floats


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Meeting:
    """Where N pairs of lines meet: position (N, 2) from the start, accepted (N,), margin (N,)."""

    position: Floats
    accepted: Bools
    margin: Floats


def refine(
    image: GreyImage,
    start: NDArray[np.int64],
    centroid: Floats,
    refinement: EdgeLines | EdgeStep | Midlines | None,
    scale: float,
) -> Refined:
    """Refine the positions of N corners.

    start: (N, 2) (x, y), the rounded centroids; centroid: (N, 2), what is kept where a guard
    refuses; both in the full image, scale being the working scale they come from.
    """
    count = len(start)
    unknown = np.full(count, np.nan)
    if refinement is None or count == 0:
        return Refined(
            xy=centroid,
            method=np.full(count, Method.CENTROID, np.uint8),
            refusal=np.zeros(count, np.uint8),
            sigma=unknown,
            edges=np.full((count, 4), np.nan),
            doubtful=np.zeros(count, np.bool_),
            margin=np.full(count, np.inf),
        )
    points = edge_points(image, start, scale)
    enough = points.valid.sum(axis=1) >= 2
    max_shift = STEP_SHIFT if isinstance(refinement, EdgeStep) else refinement.max_shift
    sigma = unknown
    doubtful = np.zeros(count, np.bool_)
    if isinstance(refinement, Midlines):
        shift, method, refusal, margin = midlines(points, refinement.fit, max_shift / scale)
    else:
        shift, method, refusal, margin = edge_lines(points, max_shift / scale, scale)
        sigma = np.where(method == Method.EDGE_LINES, lines_sigma(points), np.nan)
    method = np.where(enough, method, Method.KEPT).astype(np.uint8)
    refusal = np.where(enough, refusal, Refusal.RINGS).astype(np.uint8)
    lines = np.nonzero(method == Method.EDGE_LINES)[0]
    if isinstance(refinement, EdgeStep) and len(lines):
        step = edge_step(
            image, start[lines], shift[lines], _chosen(points, lines), refinement, scale
        )
        accepted = lines[step.accepted]
        shift[accepted] = step.position[step.accepted]
        method[accepted] = Method.EDGE_STEP
        refusal[lines] = step.refusal
        sigma[accepted] = step.sigma[step.accepted]
        doubtful[lines] = step.doubtful
        margin[lines] = np.minimum(margin[lines], step.margin)
    edges = np.arctan2(points.direction[..., 1], points.direction[..., 0])
    kept = (method == Method.KEPT)[:, None]
    return Refined(
        xy=np.where(kept, centroid, start + shift),
        method=method,
        refusal=refusal,
        sigma=np.where(method == Method.KEPT, np.nan, sigma),
        edges=np.where(enough[:, None], edges, np.nan),
        doubtful=doubtful,
        margin=np.where(enough, np.minimum(margin, points.margin), points.margin),
    )


def _chosen(points: EdgePoints, rows: NDArray[np.int64]) -> EdgePoints:
    return EdgePoints(**{name: values[rows] for name, values in vars(points).items()})


# --- edge points -------------------------------------------------------------------------


def circle(radius: int) -> tuple[tuple[int, int], ...]:
    """Return the refinement ring of a radius, (dx, dy) clockwise from twelve o'clock.

    (x, round(sqrt(r^2 - x^2))) for 0 <= x <= y, reflected: 16, 24 and 28 points for the radii
    3, 4 and 5.
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


def ring_samples(
    image: GreyImage, start: NDArray[np.int64], radius: int, scale: float
) -> tuple[Floats, Floats]:
    """Return (samples, 2) offsets and (N, samples) grey levels of a refinement ring.

    At scale 1 the integer circle; else 32 samples at radius / scale, interpolated
    bilinearly, sample k at the angle k 2 pi / 32 clockwise from twelve o'clock.
    """
    x, y = start.T
    if scale == 1:
        offsets = circle(radius)
        return np.array(offsets, np.float64), ring_greys(image, x, y, offsets).astype(np.float64)
    angle = np.arange(32) * (math.tau / 32)
    offset = radius / scale * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return offset, bilinear(image, x[:, None] + offset[:, 0], y[:, None] + offset[:, 1])


def bilinear(image: GreyImage, x: Floats, y: Floats) -> Floats:
    """Interpolate the grey levels at positions, border pixels repeated."""
    height, width = image.shape
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = x - left, y - top
    columns = [np.clip(left + step, 0, width - 1) for step in (0, 1)]
    rows = [np.clip(top + step, 0, height - 1) for step in (0, 1)]
    grey = image.astype(np.float64)
    above, below = ((1 - fx) * grey[row, columns[0]] + fx * grey[row, columns[1]] for row in rows)
    result: Floats = (1 - fy) * above + fy * below
    return result


def threshold(grey: Floats) -> Floats:
    """Return (N,): halfway between the means of the lowest and the highest quarter of a ring."""
    ordered = np.sort(grey, axis=1)
    quarter = grey.shape[1] // 4
    low, high = ordered[:, :quarter].mean(axis=1), ordered[:, -quarter:].mean(axis=1)
    result: Floats = (low + high) / 2
    return result


def edge_points(image: GreyImage, start: NDArray[np.int64], scale: float) -> EdgePoints:
    """Match the edge points of all rings. A ring whose first black sector lies opposite that of the
    smallest valid ring swaps (e0, e1) with (e2, e3).
    """
    rings = [ring_samples(image, start, radius, scale) for radius in RADII]
    level = threshold(rings[0][1])
    found = [_ring_edges(offset, grey - level[:, None]) for offset, grey in rings]
    point = np.stack([each[0] for each in found], axis=1)
    valid = np.stack([each[1] for each in found], axis=1)
    margin = np.full(len(start), np.inf)
    if scale != 1:  # on the integer rings greys and threshold are exact in float32 too
        margin = np.min([each[2] for each in found], axis=0) / np.maximum(level, 1)

    axis = (point[:, :, 0] + point[:, :, 1] - point[:, :, 2] - point[:, :, 3]) / 2
    smallest = axis[np.arange(len(start)), np.argmax(valid, axis=1)]
    dot = (axis * smallest[:, None]).sum(axis=2)
    point = np.where((dot < 0)[..., None, None], np.roll(point, 2, axis=2), point)
    cosine = np.abs(dot) / np.maximum(_norm(axis) * _norm(smallest)[:, None], 1e-12)
    margin = np.minimum(margin, np.where(valid, cosine, np.inf).min(axis=1))

    unit = point / np.maximum(_norm(point), 1e-12)[..., None]
    direction = np.where(valid[..., None, None], unit, 0).sum(axis=1)
    return EdgePoints(point=point, valid=valid, direction=direction, margin=margin)


def _ring_edges(offset: Floats, d: Floats) -> tuple[Floats, Bools, Floats]:
    """Return (N, 4, 2) edge points, (N,) whether there are four, (N,) smallest |d| that decided.

    d: (N, samples) grey minus threshold, black where negative. A ring without four
    boundaries gets one majority-of-three pass.
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
    decided = np.minimum(np.abs(d).min(axis=1), np.abs(difference).min(axis=1))
    return point, four, decided


def _changes(black: Bools) -> Bools:
    """Return whether sample k and the next differ in colour."""
    changes: Bools = black != np.roll(black, -1, axis=1)
    return changes


# --- lines -------------------------------------------------------------------------------


def fit_lines(point: Floats, valid: Bools) -> Lines:
    """Fit total-least-squares lines through the valid ones of (N, K, 2) points."""
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


def _along(line: Lines) -> Floats:
    return np.stack([np.cos(line.angle), np.sin(line.angle)], axis=1)


def intersect(first: Lines, second: Lines) -> Meeting:
    """Return the intersections, accepted where |sin| of the angle between the lines is > 0.17."""
    sin = np.sin(second.angle - first.angle)
    accepted = np.abs(sin) > LEAST_SIN
    a, b = _along(first), _along(second)
    distance = _cross(second.centre - first.centre, b) / np.where(accepted, sin, 1)
    margin = np.abs(np.abs(sin) - LEAST_SIN) / LEAST_SIN
    return Meeting(
        position=first.centre + distance[:, None] * a,
        accepted=accepted,
        margin=np.min([margin, first.margin, second.margin], axis=0),
    )


def _within(meeting: Meeting, max_shift: float) -> Meeting:
    """Return the same, accepted only within a distance of the start."""
    shift = _norm(meeting.position)
    near = np.abs(shift - max_shift) / max(max_shift, 1e-12)
    return Meeting(
        position=meeting.position,
        accepted=meeting.accepted & (shift <= max_shift),
        margin=np.minimum(meeting.margin, np.where(meeting.accepted, near, np.inf)),
    )


def _straight(meeting: Meeting, first: Lines, second: Lines, scale: float) -> Meeting:
    """Return the same, accepted only where the points are near both lines."""
    largest = (LARGEST_RESIDUAL / scale) ** 2
    residual = first.residual + second.residual
    near = np.abs(residual - largest) / largest
    return Meeting(
        position=meeting.position,
        accepted=meeting.accepted & (residual <= largest),
        margin=np.minimum(meeting.margin, np.where(meeting.accepted, near, np.inf)),
    )


def _boundary_points(points: EdgePoints, boundaries: tuple[int, ...]) -> tuple[Floats, Bools]:
    """Return (N, K, 2) points of some boundaries on all rings, and (N, K) which are valid."""
    chosen = points.point[:, :, list(boundaries)]
    valid = np.repeat(points.valid, len(boundaries), axis=1)
    return chosen.reshape(len(chosen), -1, 2), valid


def edge_lines(
    points: EdgePoints, max_shift: float, scale: float
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Apply EDGE_LINES: line e0 e2 meets line e1 e3. Return shift (N, 2), method, margin.

    Returns shift (N, 2), method, refusal and margin (N,).

    Where the edge points are not on two lines, in torn corners and where the rings reach over
    squeezed cells, the centroid is nearer: the mean squared distances of both lines together
    are at most 0.25 px^2.
    """
    first, second = _both_lines(points)
    crossing = intersect(first, second)
    near = _within(crossing, max_shift)
    meeting = _straight(near, first, second, scale)
    method = np.where(meeting.accepted, Method.EDGE_LINES, Method.KEPT).astype(np.uint8)
    refusal = np.select(
        [meeting.accepted, near.accepted, crossing.accepted],
        [Refusal.NONE, Refusal.RESIDUAL, Refusal.SHIFT],
        Refusal.ANGLE,
    ).astype(np.uint8)
    return meeting.position, method, refusal, meeting.margin


def lines_sigma(points: EdgePoints) -> Floats:
    """Return the standard deviation per axis of the intersection of EDGE_LINES, px: (N,).

    A line through n points has the sum of squared distances d from them and n - 2 degrees of
    freedom; its own variance is a share 1 / n of theirs, and crossing at an angle divides it by
    sin^2. Both lines share their points' variance.
    """
    counts = 2 * points.valid.sum(axis=1)
    squares = np.zeros(len(counts))
    lines = _both_lines(points)
    for line, boundaries in zip(lines, ((0, 2), (1, 3)), strict=True):
        point, valid = _boundary_points(points, boundaries)
        normal = _normal(line)[:, None]
        apart = ((point - line.centre[:, None]) * normal).sum(axis=2)
        squares += np.where(valid, apart**2, 0).sum(axis=1)
    sin = np.sin(lines[1].angle - lines[0].angle)
    with np.errstate(all="ignore"):
        variance = squares / (2 * (counts - 2)) / counts / sin**2
    result: Floats = np.sqrt(LINES_ERROR**2 + variance)
    return result


def _both_lines(points: EdgePoints) -> tuple[Lines, Lines]:
    return (
        fit_lines(*_boundary_points(points, (0, 2))),
        fit_lines(*_boundary_points(points, (1, 3))),
    )


# --- midlines and cusps ------------------------------------------------------------------


def midlines(
    points: EdgePoints, fit: Fit, max_shift: float
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Apply MIDLINE: the centrelines of the two black sectors meet; where they do not, CUSP.

    Returns shift (N, 2), method (N,), refusal (N,), of MIDLINE, and margin (N,).
    """
    middle = (points.point[:, :, 0::2] + points.point[:, :, 1::2]) / 2
    first, second = (fit_lines(middle[:, :, sector], points.valid) for sector in (0, 1))
    meeting = intersect(first, second)
    open_ = meeting.accepted
    if fit is Fit.QUADRATIC:
        three = points.valid.all(axis=1) & meeting.accepted
        curved = _intersect_curves(first, second, middle, meeting.position)
        meeting = Meeting(
            position=np.where(three[:, None], curved.position, meeting.position),
            accepted=meeting.accepted & (curved.accepted | ~three),
            margin=np.minimum(meeting.margin, np.where(three, curved.margin, np.inf)),
        )
    straight = _within(meeting, max_shift)
    cusp = _within(cusps(points), max_shift)
    method = np.where(straight.accepted, Method.MIDLINE, Method.CUSP)
    method = np.where(straight.accepted | cusp.accepted, method, Method.KEPT).astype(np.uint8)
    refusal = np.select(
        [straight.accepted, open_], [Refusal.NONE, Refusal.SHIFT], Refusal.ANGLE
    ).astype(np.uint8)
    position = np.where(straight.accepted[:, None], straight.position, cusp.position)
    margin = np.where(straight.accepted, straight.margin, np.minimum(straight.margin, cusp.margin))
    return position, method, refusal, margin


def cusps(points: EdgePoints) -> Meeting:
    """Apply CUSP: the edge lines of each black sector meet in a cusp; take the cusps' midpoint."""
    line = [fit_lines(*_boundary_points(points, (boundary,))) for boundary in range(4)]
    one, other = intersect(line[0], line[1]), intersect(line[2], line[3])
    return Meeting(
        position=(one.position + other.position) / 2,
        accepted=one.accepted & other.accepted,
        margin=np.minimum(one.margin, other.margin),
    )


def _intersect_curves(first: Lines, second: Lines, middle: Floats, begin: Floats) -> Meeting:
    """Intersect the parabolas v = a + b u + c u^2 through three points each.

    u runs along a line, v across it, both from its centre. Four Newton steps in the two u
    from where the lines meet.
    """
    lines = (first, second)
    along = [_along(line) for line in lines]
    across = [np.stack([-each[:, 1], each[:, 0]], axis=1) for each in along]
    with np.errstate(all="ignore"):
        curves = [
            _parabola(middle[:, :, k] - lines[k].centre[:, None], along[k], across[k])
            for k in (0, 1)
        ]
        u = [_dot(begin - lines[k].centre, along[k]) for k in (0, 1)]
        least_sin = np.full(len(begin), np.inf)
        for _ in range(4):
            place = [_on_curve(lines[k], along[k], across[k], curves[k], u[k]) for k in (0, 1)]
            tangent = [
                along[k] + (curves[k][:, 1] + 2 * curves[k][:, 2] * u[k])[:, None] * across[k]
                for k in (0, 1)
            ]
            cross = _cross(tangent[0], tangent[1])
            gap = place[1] - place[0]
            u = [u[0] + _cross(gap, tangent[1]) / cross, u[1] + _cross(gap, tangent[0]) / cross]
            least_sin = np.minimum(least_sin, np.abs(cross) / _norm(tangent[0]) / _norm(tangent[1]))
        position = _on_curve(first, along[0], across[0], curves[0], u[0])
    accepted = np.isfinite(position.sum(axis=1))
    margin = np.where(accepted, least_sin, 0.0)
    return Meeting(
        position=np.where(accepted[:, None], position, 0), accepted=accepted, margin=margin
    )


def _parabola(point: Floats, along: Floats, across: Floats) -> Floats:
    """Return (N, 3): a, b, c of the parabola through (N, 3, 2) points, by divided differences."""
    u0, u1, u2 = (point * along[:, None]).sum(axis=2).T
    v0, v1, v2 = (point * across[:, None]).sum(axis=2).T
    slope = (v1 - v0) / (u1 - u0)
    c = ((v2 - v1) / (u2 - u1) - slope) / (u2 - u0)
    b = slope - c * (u0 + u1)
    return np.stack([v0 - b * u0 - c * u0 * u0, b, c], axis=1)


def _on_curve(line: Lines, along: Floats, across: Floats, curve: Floats, u: Floats) -> Floats:
    v = curve[:, 0] + curve[:, 1] * u + curve[:, 2] * u * u
    result: Floats = line.centre + u[:, None] * along + v[:, None] * across
    return result


# --- one step of a corner model ----------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """N steps: position (N, 2) from the start; the rest (N,), as in `Refined`."""

    position: Floats
    accepted: Bools
    refusal: NDArray[np.uint8]
    sigma: Floats
    doubtful: Bools
    margin: Floats


def edge_step(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    points: EdgePoints,
    refinement: EdgeStep,
    scale: float,
) -> Step:
    """Apply EDGE_STEP: one weighted linear least-squares step of a blurred corner from EDGE_LINES.

    The model of the grey around x is m + c f(n1.u) g(n2.u), f and g smooth steps of 1.2 px.
    Its radius is clamp(0.75 cell s, 4.5, 9) / s with the working scale s.
    """
    radius = min(max(0.75 * refinement.cell * scale, 4.5), 9.0) / scale
    n1, n2 = (_normal(line) for line in _both_lines(points))
    at_once = max(1, 2_000_000 // math.ceil(2 * radius + 1) ** 2)
    blocks = [slice(k, k + at_once) for k in range(0, len(start), at_once)]
    parts = [
        _step_terms(image, start[rows], shift[rows], n1[rows], n2[rows], radius) for rows in blocks
    ]
    step, solvable, variance, correlation, near = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    position = shift + step
    length, moved = _norm(step), _norm(position)
    longest, furthest = LARGEST_STEP / scale, STEP_SHIFT / scale
    accepted = solvable & (length <= longest) & (moved <= furthest)

    excess = np.zeros(len(start))
    if accepted.any():
        excess = np.maximum(0, correlation - lower_median(correlation[accepted]))
    sigma = np.sqrt(STEP_ERROR**2 + 0.25 * variance + 1000 * excess**2)
    margin = np.min(
        [
            near,
            np.where(solvable, np.abs(length - longest) / longest, np.inf),
            np.where(solvable, np.abs(moved - furthest) / furthest, np.inf),
            np.where(accepted, np.abs(excess - DOUBT) / DOUBT, np.inf),
        ],
        axis=0,
    )
    return Step(
        position=position,
        accepted=accepted,
        refusal=np.select([accepted, solvable], [Refusal.NONE, Refusal.SHIFT], Refusal.FLAT).astype(
            np.uint8
        ),
        sigma=np.where(accepted, sigma, np.nan),
        doubtful=accepted & (excess > DOUBT),
        margin=margin,
    )


def lower_median(values: Floats) -> float:
    """Return the value of rank (n - 1) // 2, from 0: one that occurs."""
    return float(np.sort(values)[(len(values) - 1) // 2])


def _normal(line: Lines) -> Floats:
    """Return (N, 2): a unit normal of each line; its sign drops out, with that of c."""
    return np.stack([-np.sin(line.angle), np.cos(line.angle)], axis=1)


def _step_terms(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    n1: Floats,
    n2: Floats,
    radius: float,
) -> tuple[Floats, Bools, Floats, Floats, Floats]:
    """Return per corner: step (N, 2), whether the system is sound, tr rho^2, ac, and a margin.

    ac is the mean of r(q) r(q + (1, 0)), weighted by w(q), over the pixels q that are, like
    their right neighbours, within the radius.
    """
    height, width = image.shape
    reach = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
    middle = np.floor(shift + 0.5).astype(np.int64)
    x = (middle[:, 0, None] + reach)[:, None, :]
    y = (middle[:, 1, None] + reach)[:, :, None]
    columns = np.clip(start[:, 0, None, None] + x, 0, width - 1)
    rows = np.clip(start[:, 1, None, None] + y, 0, height - 1)
    grey = image[rows, columns].astype(np.float64)
    grey -= image[start[:, 1], start[:, 0]].astype(np.float64)[:, None, None]

    ux, uy = x - shift[:, 0, None, None], y - shift[:, 1, None, None]
    r2 = ux * ux + uy * uy
    inside = r2 < radius * radius
    r0 = min(4.0, radius / 2)
    w = np.where(inside, (1 - r2 / radius**2) * np.minimum(1, r2 / r0**2), 0)
    a, b = ((n[:, 0, None, None] * ux + n[:, 1, None, None] * uy) / BLUR for n in (n1, n2))
    qa, qb = 1 / np.sqrt(1 + a * a), 1 / np.sqrt(1 + b * b)
    f, g = a * qa, b * qb
    p, da, db = f * g, qa**3 * g / BLUR, f * qb**3 / BLUR

    def total(values: Floats) -> Floats:
        result: Floats = (w * values).sum(axis=(1, 2))
        return result

    s1, sp, si = total(np.ones_like(p)), total(p), total(grey)
    spp, spi, sii = total(p * p), total(p * grey), total(grey * grey)
    sa, sb = total(da), total(db)
    saa, sab, sbb = total(da * da), total(da * db), total(db * db)
    sap, sbp, sai, sbi = total(da * p), total(db * p), total(da * grey), total(db * grey)

    with np.errstate(all="ignore"):
        spread = s1 * spp - sp * sp
        c = (s1 * spi - sp * si) / spread
        m = (si - c * sp) / s1
        ba, bb = sai - m * sa - c * sap, sbi - m * sb - c * sbp
        d = saa * sbb - sab * sab
        ha, hb = -(sbb * ba - sab * bb) / (d * c), -(saa * bb - sab * ba) / (d * c)
        cross = _cross(n1, n2)
        step = np.stack(
            [
                (ha * n2[:, 1] - hb * n1[:, 1]) / cross,
                (hb * n1[:, 0] - ha * n2[:, 0]) / cross,
            ],
            axis=1,
        )
        rho2 = np.maximum(0, sii - m * si - c * spi) / s1 / (c * c)
        variance = rho2 * (saa + sbb + 2 * sab * _dot(n1, n2)) / (d * cross * cross)
        r = (grey - m[:, None, None] - c[:, None, None] * p) / c[:, None, None]
        pair = np.where(inside[:, :, :-1] & inside[:, :, 1:], w[:, :, :-1], 0)
        neighbours = np.where(pair > 0, r[:, :, :-1] * r[:, :, 1:], 0)
        correlation = (pair * neighbours).sum(axis=(1, 2)) / pair.sum(axis=(1, 2))
        ratios = np.stack(
            [
                np.abs(c) / LEAST_CONTRAST,
                d / (saa * sbb) / LEAST_DETERMINANT,
                spread / (s1 * spp) / LEAST_DETERMINANT,
            ]
        )
        sound = (ratios > 1).all(axis=0) & np.isfinite(step).all(axis=1)
        sound &= np.isfinite(variance) & np.isfinite(correlation)
        near = np.abs(np.where(np.isfinite(ratios), ratios, 0) - 1).min(axis=0)
    clean = sound[:, None]
    return (
        np.where(clean, step, 0),
        sound,
        np.where(sound, variance, 0),
        np.where(sound, correlation, 0),
        near,
    )


# --- vectors -----------------------------------------------------------------------------


def _norm(vector: Floats) -> Floats:
    result: Floats = np.sqrt((vector * vector).sum(axis=-1))
    return result


def _dot(a: Floats, b: Floats) -> Floats:
    result: Floats = (a * b).sum(axis=-1)
    return result


def _cross(a: Floats, b: Floats) -> Floats:
    result: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result
