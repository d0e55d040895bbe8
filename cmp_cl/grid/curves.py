"""Smooth curves through the nodes of rows and columns (section 4.3 of the paper)."""

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def points_between(at: Float, count: int) -> Float:
    """Return the nodes and `count` points on the curve between each two neighbours.

    at: (R, C, 2), px, NaN where there is no node. Returns ((R - 1)(count + 1) + 1,
    (C - 1)(count + 1) + 1, 2), NaN inside the cells. The curves are cubic Hermite splines along
    rows and columns, whose slopes are central differences, one-sided at ends and holes.
    """
    times = count + 1
    rows, columns = ((n - 1) * times + 1 if n else 0 for n in at.shape[:2])
    points = np.full((rows, columns, 2), np.nan)
    points[::times, ::times] = at
    if at.size:
        for k in range(1, times):
            points[::times, k::times] = _hermite(at, k / times)
            points[k::times, ::times] = _hermite(at.swapaxes(0, 1), k / times).swapaxes(0, 1)
    return points


def _hermite(at: Float, t: float) -> Float:
    """Return points at t from each node to the next along axis 1: (R, C, 2) -> (R, C - 1, 2)."""
    slope = _slopes(at)
    a, b, from_a, to_b = at[:, :-1], at[:, 1:], slope[:, :-1], slope[:, 1:]
    u = 1 - t
    return (1 + 2 * t) * u * u * a + t * u * u * from_a + t * t * (3 - 2 * t) * b - t * t * u * to_b


def _slopes(at: Float) -> Float:
    """Return derivatives along axis 1: central, or one-sided by a parabola or a line."""
    padded = np.pad(at, ((0, 0), (2, 2), (0, 0)), constant_values=np.nan)
    ll, left, right, rr = padded[:, :-4], padded[:, 1:-3], padded[:, 3:-1], padded[:, 4:]
    slope = (right - left) / 2
    for other in (
        (4 * right - 3 * at - rr) / 2,
        (3 * at - 4 * left + ll) / 2,
        right - at,
        at - left,
    ):
        slope = np.where(np.isnan(slope), other, slope)
    return slope
