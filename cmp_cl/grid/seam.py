"""Tests whether a pattern is two boards whose last squares touch.

If colours alternate across the line on which two boards touch, that line looks like a line of
nodes, and both boards are numbered as one. But boards seldom touch exactly: there is a gap between
them, or their rows do not meet. So the nodes before and after that line are not as far apart as the
steps on both sides say, and differ more from them there than at any other line.

`mirror.has_seam` looks for a line between nodes instead. Beside a line of nodes it finds four steps
that differ, and none that differs more than the others.
"""

import numpy as np

from cmp_cl.grid.mirror import (
    ABOVE_OTHERS_ACROSS,
    CROSSING,
    LINES,
    OTHERS,
    SEAM,
    SEAM_PIXELS,
    SHARE,
)
from cmp_cl.grid.nodes import Float, Points

FEWEST = 6  # nodes of a row that show a step across a node and others
APART = 2  # lines of nodes: nearer ones show a part of the step


def touch(at: Points) -> bool:
    """Return whether the nodes may be those of two boards whose squares touch.

    at: (R, C) measured nodes, px, NaN where there is none.
    """
    ways = [way[:: max(-(-len(way) // LINES), 1)] for way in (at, at.T)]
    steps = [way[:, 1:] - way[:, :-1] for way in ways]
    across = [_across(*each) for each in zip(ways, steps, strict=True)]
    return any(_touch(steps[n], across[n], across[1 - n]) for n in (0, 1))


def _touch(step: Points, across: Float, beside: Float) -> bool:
    """Return whether two boards touch at a column of nodes.

    step: (R, C - 1). across: as of `_across`. beside: the same for rows, whose nodes show how much
    the surface bends.
    """
    if not across.any():
        return False
    best = int(across.argmax())
    between = _typical(step[:, 1:-1] - (step[:, :-2] + step[:, 2:]) / 2)
    before, after = between[: max(best - 1, 0)], between[best + 3 :]
    if not (before.any() and after.any()):
        return False
    far = np.abs(np.arange(len(across)) - best) > APART
    others = np.concatenate([before, after, across[far]])
    if np.count_nonzero(others) < OTHERS:
        return False
    cell = float(np.abs(step[~np.isnan(step.real)]).mean())
    usual = max(others.max(), beside.max(initial=0))
    return bool(across[best] >= max(SEAM * cell, SEAM_PIXELS, ABOVE_OTHERS_ACROSS * usual))


def _across(at: Points, step: Points) -> Float:
    """Return the deviation of the two steps across each column of nodes from the steps beside them,
    px, (C - 4,)."""
    if at.shape[1] < FEWEST:
        return np.zeros(0)
    return _typical(at[:, 3:-1] - at[:, 1:-3] - step[:, :-3] - step[:, 3:])


def _typical(off: Points) -> Float:
    """Return a quantile over the rows of the lengths that are known, by column; 0 if few are."""
    size = np.sort(np.abs(off), axis=0)  # unknown ones are last
    count = np.count_nonzero(size == size, axis=0)
    typical: Float = size[(SHARE * count).astype(np.int64), np.arange(len(count))]
    typical[count < max(CROSSING, len(off) / 4)] = 0
    return typical
