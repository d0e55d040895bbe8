"""MIDLINE and CUSP: the centrelines of the black sectors, and their cusps, in float64."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import Fit
from cmp_cl.corners import Method, Refusal
from cmp_cl.reference.edges import (
    LEAST_SIN,
    EdgePoints,
    Lines,
    Meeting,
    along_of,
    boundary_points,
    cross,
    fit_lines,
    intersect,
    norm,
    normal_of,
    within,
)

Floats = NDArray[np.float64]


def midlines(
    points: EdgePoints, fit: Fit, max_shift: float
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Apply MIDLINE, the intersection of the centrelines of the two black sectors, or else CUSP.

    Returns shift (N, 2), method (N,), refusal (N,), of MIDLINE, and margin (N,).
    """
    middle = (points.point[:, :, 0::2] + points.point[:, :, 1::2]) / 2
    first, second = (fit_lines(middle[:, :, sector], points.valid) for sector in (0, 1))
    meeting = intersect(first, second)
    if fit is Fit.QUADRATIC:
        three = points.valid.all(axis=1) & meeting.accepted
        curved = _intersect_curves(first, second, middle, meeting.position)
        meeting = Meeting(
            position=np.where(three[:, None], curved.position, meeting.position),
            accepted=meeting.accepted & (curved.accepted | ~three),
            margin=np.minimum(meeting.margin, np.where(three, curved.margin, np.inf)),
        )
    straight = within(meeting, max_shift)
    cusp = within(cusps(points), max_shift)
    method = np.where(straight.accepted, Method.MIDLINE, Method.CUSP)
    method = np.where(straight.accepted | cusp.accepted, method, Method.KEPT).astype(np.uint8)
    refusal = np.select(
        [straight.accepted, meeting.accepted], [Refusal.NONE, Refusal.SHIFT], Refusal.ANGLE
    ).astype(np.uint8)
    position = np.where(straight.accepted[:, None], straight.position, cusp.position)
    margin = np.where(straight.accepted, straight.margin, np.minimum(straight.margin, cusp.margin))
    return position, method, refusal, margin


def cusps(points: EdgePoints) -> Meeting:
    """Apply CUSP: the edge lines of each black sector meet in a cusp; take the cusps' midpoint."""
    line = [fit_lines(*boundary_points(points, (boundary,))) for boundary in range(4)]
    one, other = intersect(line[0], line[1]), intersect(line[2], line[3])
    return Meeting(
        position=(one.position + other.position) / 2,
        accepted=one.accepted & other.accepted,
        margin=np.minimum(one.margin, other.margin),
    )


def _intersect_curves(first: Lines, second: Lines, middle: Floats, begin: Floats) -> Meeting:
    """Intersect the parabolas v = a + b u + c u^2 through three points each.

    u runs along a line, v across it, both from its centre. Four Newton steps in the two u start
    where the lines meet. Curves that are nearly parallel at one of them are not accepted: where
    they meet depends on every digit.
    """
    centre = np.stack([first.centre, second.centre])
    along = np.stack([along_of(first), along_of(second)])
    across = np.stack([normal_of(first), normal_of(second)])
    with np.errstate(all="ignore"):
        points = np.moveaxis(middle, 2, 0) - centre[:, :, None]
        a, b, c = _parabola(points, along, across)
        u = np.vecdot(begin - centre, along)
        least_sin = np.full(len(begin), np.inf)
        for _ in range(4):
            point = _on_curve(centre, along, across, (a, b, c), u)
            tangent = along + (b + 2 * c * u)[..., None] * across
            sine = cross(*tangent)
            u = u + cross(point[1] - point[0], tangent[::-1]) / sine
            least_sin = np.minimum(least_sin, np.abs(sine) / norm(tangent[0]) / norm(tangent[1]))
        position = _on_curve(centre, along, across, (a, b, c), u)[0]
        accepted = least_sin > LEAST_SIN
        margin = np.nan_to_num(np.abs(least_sin - LEAST_SIN) / LEAST_SIN)
    return Meeting(
        position=np.where(accepted[:, None], position, 0), accepted=accepted, margin=margin
    )


def _parabola(point: Floats, along: Floats, across: Floats) -> tuple[Floats, Floats, Floats]:
    """Return a, b, c (2, N) of parabolas through (2, N, 3, 2) points, by divided differences."""
    u0, u1, u2 = np.moveaxis(np.vecdot(point, along[:, :, None]), -1, 0)
    v0, v1, v2 = np.moveaxis(np.vecdot(point, across[:, :, None]), -1, 0)
    slope = (v1 - v0) / (u1 - u0)
    c = ((v2 - v1) / (u2 - u1) - slope) / (u2 - u0)
    b = slope - c * (u0 + u1)
    return v0 - b * u0 - c * u0 * u0, b, c


def _on_curve(
    centre: Floats, along: Floats, across: Floats, curve: tuple[Floats, Floats, Floats], u: Floats
) -> Floats:
    a, b, c = curve
    v = a + b * u + c * u * u
    return centre + u[..., None] * along + v[..., None] * across
