"""Locates torn nodes by the whole of their edges, which run to the nodes around them.

A ring sees the middle of a corner, and there a worn print is torn: cells of one colour merge, or
the visible corner is not the printed one. Towards the next nodes the edges are whole.
"""

import numpy as np

from cmp_cl.grid.nodes import NOWHERE, Float, Index, Nodes, Points
from cmp_cl.grid.predict import bordered
from cmp_cl.image import GreyImage

SHARES = np.linspace(0.2, 0.7, 6)  # of the way to the neighbours: where an edge is looked for
WIDE = 0.33  # cells, how far on either side
SAMPLES = 9  # of a profile across an edge
OUTER = 3  # samples at each end of a profile, which show the two cells
LEAST_STEP = 0.1  # between these cells, of the contrast around the node: at each edge
LEAST_MEAN_STEP = 0.3  # and in the mean of the four
MOVED = 0.7  # share of the distances from the curves: neighbours have errors too, as large as edges
LEAST_SINE = 0.17  # below it the intersection of two lines is too uncertain

_WAYS = np.array([(0, 1), (1, 0), (0, -1), (-1, 0)])  # to the neighbours, (row, column), clockwise
_FALLS = np.array([-1, 1, -1, 1])  # where the sum of parity, row and column is even
_ON = SHARES[:, None, None]
_ACROSS = np.linspace(-WIDE, WIDE, SAMPLES)[:, None, None, None]


def along_edges(
    nodes: Nodes,
    image: GreyImage,
    row: Index,
    column: Index,
    expected: Points,
    steps: tuple[Points, Points, Float],
) -> Points:
    """Return the positions of these nodes from the edges to their neighbours, (M,) px; NaN if an
    edge is not visible.

    expected: (M,) px, the positions that the neighbours predict. steps: as `mean_steps` returns
        them.

    An edge is searched on profiles across the curve through the expected position and both
    neighbours. The node moves with the mean distances of its two lines from their curves, by the
    share of them that leaves the least error.
    """
    along, down, cell = steps
    ends = bordered(nodes.at)[row + 3 + _WAYS[:, :1], column + 3 + _WAYS[:, 1:]]
    ends = np.where(np.isnan(ends), expected + np.array([along, down, -along, -down]), ends)
    known = np.isfinite(ends).all(axis=0) & np.isfinite(expected)
    ends, expected, cell = (np.where(known, values, 0) for values in (ends, expected, cell))

    levels = _profiles(image, expected, ends, cell)
    odd = (nodes.parity + row + column) % 2
    rising = levels * (_FALLS[:, None] * (1 - 2 * odd))
    offset = _crossing(rising) * cell
    step = (rising[-OUTER:] - rising[:OUTER]).mean(axis=(0, 1))
    contrast = np.ptp(levels.reshape(-1, len(row)), axis=0)
    shown = known & (step > LEAST_STEP * contrast).all(axis=0)
    shown &= step.mean(axis=0) > LEAST_MEAN_STEP * contrast
    return np.where(shown, expected + MOVED * _move(ends, offset), NOWHERE)


def _profiles(image: GreyImage, start: Points, ends: Points, cell: Float) -> Float:
    """Return the grey levels across the curves from the start to the four ends, from left to right
    of the way, (SAMPLES, shares, 4, M)."""
    back = ends[[2, 3, 0, 1]]
    half, bend = (ends - back) / 2, (ends + back) / 2 - start
    tangent = half + 2 * _ON * bend
    across = 1j * cell * tangent / np.maximum(np.abs(tangent), 1e-6)
    at = start + _ON * half + _ON**2 * bend + _ACROSS * across
    return _between_pixels(image, at.real, at.imag)


def _between_pixels(image: GreyImage, x: Float, y: Float) -> Float:
    """Return the grey levels at x, y, bilinear; beyond the image its border is repeated."""
    rows, columns = image.shape
    x = np.minimum(np.maximum(x, 0), columns - 1)
    y = np.minimum(np.maximum(y, 0), rows - 1)
    left, top = x.astype(np.int64), y.astype(np.int64)
    x -= left
    y -= top
    above = top * columns + left
    below = above + columns * (top < rows - 1)
    right = left < columns - 1
    upper = (1 - x) * image.take(above) + x * image.take(above + right)
    lower = (1 - x) * image.take(below) + x * image.take(below + right)
    levels: Float = (1 - y) * upper + y * lower
    return levels


def _crossing(rising: Float) -> Float:
    """Return the mean position of an edge on its profiles, (4, M) cells from the middle; NaN where
    fewer than half of them cross it.

    On each it is where the level rises through the middle between its least and its largest,
    nearest to the middle of the profile.
    """
    level = rising - (rising.max(axis=0) + rising.min(axis=0)) / 2
    before, after = level[:-1], level[1:]
    crossed = (before < 0) & (after >= 0)
    part = before / np.where(crossed, before - after, 1)
    place = np.where(crossed, _ACROSS[:-1] + part * (2 * WIDE / (SAMPLES - 1)), np.inf)
    each = place.reshape(len(place), -1)
    least = np.abs(each).argmin(axis=0)
    nearest = each[least, np.arange(len(least))].reshape(place.shape[1:])
    found = np.isfinite(nearest)
    count = found.sum(axis=0)
    mean = np.where(found, nearest, 0).sum(axis=0) / np.maximum(count, 1)
    return np.where(2 * count >= len(SHARES), mean, np.nan)


def _move(ends: Points, offset: Float) -> Points:
    """Return the step from a node to the intersection of its two lines, (M,) px."""
    chord = ends[:2] - ends[2:]
    first, second = 1j * chord / np.maximum(np.abs(chord), 1e-6)
    one, other = (offset[:2] - offset[2:]) / 2  # right of the way out is left of the way back
    sine = (first.conj() * second).imag
    sine = np.where(np.abs(sine) > LEAST_SINE, sine, np.nan)
    move: Points = 1j * (other * first - one * second) * (1 / sine)
    return move
