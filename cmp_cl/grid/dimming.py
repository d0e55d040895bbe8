"""Tests whether a part of the pattern is darker and the reflection of the rest, as in a mirror.

A mirror shows the pattern darker than it is, by the same share everywhere. So white cells of one
grey level end at a straight line, the edge of the mirror, and beyond it they have another. The edge
of a shadow does the same. But beyond the edge of a mirror the nodes are the reflections of those
before it.
"""

import cmath
import math
from typing import NamedTuple

import numpy as np

from cmp_cl.grid.evidence import grey, in_view
from cmp_cl.grid.nodes import Float, Points, median
from cmp_cl.image import GreyImage

SPOTS = np.array([0, 0.12, 0.12j, -0.12, -0.12j])[:, None]  # cells, from a cell's middle
DARKER = 0.025  # least difference of grey levels of neighbouring white cells, over their sum
ABOVE_USUAL = 5.0  # times the median difference
RARE = 0.3  # largest share of the neighbours with so large a difference
WITHIN = np.linspace(-0.3, 0.3, 5)[:, None]  # cells, from a cell's middle, both ways
REFINED = 3  # times that the line is fitted to these points
LEAST_STEEP = 0.3  # least change of their colour, -1 to 1, in a cell
TRIMMED = 5  # times that a line is fitted, each time without the points far from the last one
NEAR = 1.2  # cells: points of the line lie so near to it
CLEAR = 0.6  # least share of the large differences that lie on the line
CROSSED = 0.5  # least share of the neighbours across the line that differ by so much
INSIDE = 0.3  # cells: neighbours are across the line although one is so far on the other's side
LEAST = 6  # number of these neighbours
DEEP = 6  # cells: nodes so near to the line are reflected
# Errors of the line, cells and rad, that are tried.
OFFSETS, ROTATIONS = np.linspace(-0.1, 0.1, 3), np.linspace(-0.02, 0.02, 5)
BESIDE = 0.4  # cells: nodes so near to the line may lie on either side of it
REPEATED = 0.1  # cells: a node so near to a reflection may be that reflection
FITTED = 4  # times that the map from nodes to their reflections is fitted
SHARE = 0.6  # least share of the reflections at which there is a node
SAME = 0.015  # cells: greatest RMS distance of these nodes from the reflections


class Edge(NamedTuple):
    """A straight line: a point, px, and its direction, of length 1. Right of it cells are
    darker."""

    point: complex
    along: complex


class Colours(NamedTuple):
    """Corners: their positions, (N,) px, and the squares of complex numbers that point at their
    black cells."""

    at: Points
    black: Points


def is_dimmed_reflection(at: Points, parity: int, image: GreyImage) -> bool:
    """Return whether a part of the nodes is darker and the reflection of the others.

    at: (R, C) measured nodes, px, NaN where there is none. parity: as in `Grid`.
    """
    if min(at.shape) < 4:
        return False
    middle = (at[:-1, :-1] + at[:-1, 1:] + at[1:, :-1] + at[1:, 1:]) / 4
    row, column = np.indices(middle.shape)
    white = ~np.isnan(middle.real) & ((row + column + parity) % 2 == 1)
    if np.count_nonzero(white) < LEAST:
        return False
    cell = median(np.abs((at[1:, 1:] - at[:-1, :-1])[white])) / math.sqrt(2)
    level = np.full(middle.shape, np.nan)
    level[white] = grey(image, middle[white] + cell * SPOTS).mean(axis=0)
    edge = _edge(middle, level, cell)
    if edge is None:
        return False
    along = (at[:-1, 1:] - at[:-1, :-1] + at[1:, 1:] - at[1:, :-1])[white] / 2
    down = (at[1:, :-1] - at[:-1, :-1] + at[1:, 1:] - at[:-1, 1:])[white] / 2
    inside = middle[white] + WITHIN * along + WITHIN[:, None] * down
    edge = _refined(edge, inside.ravel(), grey(image, inside).ravel(), cell)
    return _reflects(at, parity, edge, cell, image)


def _edge(middle: Points, level: Float, cell: float) -> Edge | None:
    """Return the straight line beyond which white cells are darker; None if there is none.

    middle: (R, C) of cells, px. level: (R, C) their grey levels, NaN where a cell is black or
    unknown.
    """
    first = np.concatenate([middle[:, :-2].ravel(), middle[:-2].ravel()])
    second = np.concatenate([middle[:, 2:].ravel(), middle[2:].ravel()])
    before = np.concatenate([level[:, :-2].ravel(), level[:-2].ravel()])
    after = np.concatenate([level[:, 2:].ravel(), level[2:].ravel()])
    darker = (before - after) / np.maximum(before + after, 1)
    known = ~np.isnan(darker)
    if not known.any():
        return None
    first, second, darker = first[known], second[known], darker[known]
    size = np.abs(darker)
    large = size >= max(DARKER, ABOVE_USUAL * median(size))
    if not LEAST <= np.count_nonzero(large) <= RARE * len(large):
        return None
    line = _line((first + second)[large] / 2, cell)
    step = (second - first) * np.sign(darker)  # to the darker cell
    if median((step[large] * line.along.conjugate()).imag) < 0:
        line = Edge(line.point, -line.along)
    ends = np.stack([_right(line, first), _right(line, second)]) / cell
    low, high = ends.min(axis=0), ends.max(axis=0)
    near = np.abs(low + high)[large] / 2 <= NEAR
    across = (high - low > 1) & (low < INSIDE) & (high > -INSIDE)
    crossed = across & large & ((step * line.along.conjugate()).imag > 0)
    clear = np.count_nonzero(near) >= CLEAR * np.count_nonzero(large)
    least = max(LEAST, CROSSED * np.count_nonzero(across))
    return line if clear and np.count_nonzero(crossed) >= least else None


def _line(points: Points, cell: float) -> Edge:
    """Return the straight line on which most points lie."""
    kept = points
    for _ in range(TRIMMED):
        middle = complex(kept.mean())
        spread = complex(np.sum((kept - middle) ** 2))
        line = Edge(middle, cmath.sqrt(spread / max(abs(spread), 1e-9)))
        off = np.abs(_right(line, points))
        kept = points[off <= max(NEAR * cell, 1.5 * median(off))]
    return line


def _refined(line: Edge, points: Points, level: Float, cell: float) -> Edge:
    """Return the line that parts bright points from dark ones.

    line: near it. points: (M,) px, in white cells. level: (M,) their grey levels.

    The colour, -1 or 1, is fitted by a linear function of the position, which is 0 on the line.
    """
    for _ in range(REFINED):
        off = _right(line, points) / cell
        near = np.abs(off) < 1
        sides = level[near & (off > 0)], level[near & (off < 0)]
        if not all(map(len, sides)):
            return line
        dark, bright = map(median, sides)
        colour = np.where(level < (dark + bright) / 2, 1.0, -1.0)[near]
        ahead = ((points - line.point) * line.along.conjugate()).real[near] / cell
        model = np.stack([np.ones(len(ahead)), ahead, off[near]], axis=1)
        start, slope, steep = np.linalg.lstsq(model, colour, rcond=None)[0]
        if steep < LEAST_STEEP:
            return line
        across = 1j * line.along * cell
        line = Edge(
            line.point - start / steep * across, line.along * cmath.exp(-1j * slope / steep)
        )
    return line


def _right(line: Edge, points: Points) -> Float:
    """Return the distances of points to the right of a line, px."""
    off: Float = ((points - line.point) * line.along.conjugate()).imag
    return off


def _reflects(at: Points, parity: int, edge: Edge, cell: float, image: GreyImage) -> bool:
    """Return whether the nodes right of a line are the reflections of those left of it.

    at, parity: as in `is_dimmed_reflection`. The line is moved and rotated a little until the most
    reflections are nodes. Then the distances between the two that an affine map does not explain
    must be smaller than printing errors are: a view that is not perpendicular to the pattern skews
    the reflection.
    """
    row, column = np.nonzero(~np.isnan(at[:, :-1].real + at[:, 1:].real))
    nodes, step = at[row, column], at[row, column + 1] - at[row, column]
    black = 1j * (1 - 2 * ((row + column + parity) % 2)) * step**2
    off = _right(edge, nodes) / cell
    first, second = (off < -BESIDE) & (off > -DEEP), (off > -BESIDE) & (off < DEEP + 1)
    if min(np.count_nonzero(first), np.count_nonzero(second)) < LEAST:
        return False
    before, behind = Colours(nodes[first], black[first]), Colours(nodes[second], black[second])
    across = 1j * edge.along * cell
    lines = [
        Edge(edge.point + offset * across, edge.along * np.exp(1j * rotation))
        for rotation in ROTATIONS
        for offset in OFFSETS
    ]
    pairs = [_pairs(before, behind, line, cell, image) for line in lines]
    at_nodes = max(pairs, key=lambda pair: len(pair[0]))
    return _is_affine(*at_nodes, before.at, behind.at, cell, image)


def _pairs(
    before: Colours, behind: Colours, line: Edge, cell: float, image: GreyImage
) -> tuple[Points, Points]:
    """Return the corners before a line whose reflections are corners behind it, and these
    corners."""
    reflected = line.point + line.along**2 * (before.at - line.point).conj()
    away = np.abs(reflected[:, None] - behind.at)
    nearest = away.argmin(axis=1)
    black = line.along**4 * before.black.conj()
    same = (black * behind.black[nearest].conj()).real > 0
    same &= (away.min(axis=1) <= REPEATED * cell) & in_view(reflected, image)
    return before.at[same], behind.at[nearest[same]]


def _is_affine(
    first: Points, second: Points, before: Points, behind: Points, cell: float, image: GreyImage
) -> bool:
    """Return whether most points before a line are taken to points behind it by an affine map.

    first, second: (M,) px, pairs of such points. before, behind: all of them.
    """
    for _ in range(FITTED):
        if len(first) < LEAST:
            return False
        model = np.stack([np.ones(len(first)), first, first.conj()], axis=1)
        affine = np.linalg.lstsq(model, second, rcond=None)[0]
        taken = affine[0] + affine[1] * before + affine[2] * before.conj()
        shown = in_view(taken, image)
        away = np.abs(taken[:, None] - behind)
        near = shown & (away.min(axis=1) <= REPEATED * cell)
        first, second = before[near], behind[away.argmin(axis=1)[near]]
    error = away.min(axis=1)[near]
    enough = len(first) >= max(LEAST, SHARE * np.count_nonzero(shown))
    return enough and float(np.sqrt(np.mean(error**2))) <= SAME * cell
