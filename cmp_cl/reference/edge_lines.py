"""EDGE_LINES: the intersection of the two edge lines, in float64."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Method, Refusal
from cmp_cl.reference.edges import (
    EdgePoints,
    both_lines,
    bounded,
    intersect,
    line_points,
    within,
)

Floats = NDArray[np.float64]

LARGEST_RESIDUAL = 0.5  # px, root of the mean squared distances from both lines together
# px: error of a position on perfect prints by bent edges, shading and sampling, beside the noise
LINES_ERROR = 0.02


def edge_lines(
    points: EdgePoints, max_shift: float
) -> tuple[Floats, NDArray[np.uint8], NDArray[np.uint8], Floats]:
    """Apply EDGE_LINES: line e0 e2 meets line e1 e3.

    Returns shift (N, 2), method, refusal and margin (N,).

    The edge points of a torn corner, and of rings that extend past a squeezed cell, do not lie on
    two lines. The centroid is more accurate there. It is kept if the mean squared distances from
    both lines add up to more than LARGEST_RESIDUAL squared.
    """
    first, second = both_lines(points)
    crossing = intersect(first, second)
    near = within(crossing, max_shift)
    meeting = bounded(near, first.residual + second.residual, LARGEST_RESIDUAL**2)
    method = np.where(meeting.accepted, Method.EDGE_LINES, Method.KEPT).astype(np.uint8)
    refusal = np.select(
        [meeting.accepted, near.accepted, crossing.accepted],
        [Refusal.NONE, Refusal.RESIDUAL, Refusal.SHIFT],
        Refusal.ANGLE,
    ).astype(np.uint8)
    return meeting.position, method, refusal, meeting.margin


def lines_sigma(points: EdgePoints) -> Floats:
    """Return the standard deviation per axis of the intersection of EDGE_LINES, px: (N,).

    The residuals of both lines together give the variance of a point: each line of n points has
    n - 2 degrees of freedom, and a mean square of n times its residual. The variance of a line is
    1 / n of it. The intersection divides it by the squared sine of the angle between the lines.
    """
    lines = both_lines(points)
    counts = sum(line_points(points, first)[1].sum(axis=1) for first in (0, 1))
    apart = sum(line.residual for line in lines)
    sin = np.sin(lines[1].angle - lines[0].angle)
    with np.errstate(all="ignore"):
        variance = apart / (counts - 4) / sin**2
        result: Floats = np.sqrt(LINES_ERROR**2 + variance)
    return result
