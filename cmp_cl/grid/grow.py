"""Grows a grid: attaches corners that fit, searches for missing ones again, drops misfits."""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cmp_cl.grid import evidence
from cmp_cl.grid.grid import NodeStatus, Sides
from cmp_cl.grid.lattice import Complex
from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Nodes, Points, median
from cmp_cl.grid.predict import (
    FULL,
    REACHED,
    bordered,
    mean_steps,
    predict_all,
    predict_some,
)
from cmp_cl.grid.second_look import second_look
from cmp_cl.grid.whole_edges import along_edges
from cmp_cl.image import GreyImage

NEAR = 0.3  # cells: largest distance of a node from its prediction
ASTRAY = 0.07  # cells: a torn node that is farther from its prediction is looked for again,
OUTLYING = 3.5  # if it is farther by this factor than nodes of its frame usually are
OUTLYING_PX = 1.0  # a torn node that is farther, and farther than this share of a cell, and
OUTLYING_CELLS = 0.15  # farther by that factor than the nodes around, is dropped
OUTLYING_WIDE, OUTLYING_WIDE_CELLS = 8.0, 0.2  # the same for a corner in wide cells
BESIDE = 2  # nodes to each side, whose distances from their predictions are compared
PASSES = 2  # nodes that the first pass finds show where others are
USUAL = 25  # so many nodes show what is usual
WIDEST = 18.0  # px: in wider cells a torn corner's own image is worth more than its neighbours
ALONG = 0.25  # cells: how far from its prediction its edges may put it
APART = 0.4  # cells: if a node is nearer to another, the second look found a corner twice
WEAK, BRACKETED, STRONG = 1.4, 4.0, 8.0  # weights of predictions
FEW = 400  # up to so many nodes are predicted one by one, which is faster


class Seen(NamedTuple):
    """The data that a grid is built from.

    z: (N,) positions of the corners, x + 1j y, px. edges: (N, 4) rad, as in `Corners`. lines: (2,
    N), of the corners, see `lines_of`. image: (H, W), or None; without it there is no second look
    and no check of the rim. torn: (N + 1,) bool, corners whose own image does not show their
    position, and True at the end, for nodes without a corner.
    """

    z: Points
    edges: NDArray[np.float32]
    lines: Complex
    image: GreyImage | None
    torn: Mask


def grow(nodes: Nodes, seen: Seen) -> None:
    """Attach free corners, beyond the box too, and drop false nodes, until nothing changes."""
    drop_misfits(nodes)
    _reject(nodes, seen)
    while nodes.free.any() and nodes.there.any():
        nodes.pad()
        attached = _attach(nodes, seen)
        nodes.crop()
        if not attached:
            break
        drop_misfits(nodes)
        _reject(nodes, seen)
    nodes.crop()
    if seen.image is not None:
        evidence.reject_stragglers(nodes, seen.image, seen.lines)


def extend(nodes: Nodes, seen: Seen, closed: Sides) -> None:
    """Search for further rows and columns around the grid until no more are found.

    closed: the sides on which the pattern ends; beyond them nothing is searched for.
    """
    while seen.image is not None:
        nodes.pad()
        looked = np.zeros(nodes.at.shape)
        rim = looked[0], looked[-1], looked[:, 0], looked[:, -1]
        for line, ends in zip(rim, closed, strict=True):
            if ends:
                line[:] = np.inf
        found = _look_again(nodes, looked, seen.image, WEAK)
        drop_misfits(nodes)
        found &= not evidence.reject(nodes, seen.image, seen.lines)
        nodes.crop()
        if not found:
            evidence.reject_stragglers(nodes, seen.image, seen.lines)
            return


def attach(nodes: Nodes, seen: Seen) -> None:
    """Attach free corners within the box until none fits."""
    while _attach(nodes, seen):
        drop_misfits(nodes)
        _reject(nodes, seen)


def fill(nodes: Nodes, seen: Seen, least: float) -> None:
    """Fill the grid: look again where predictions have at least that weight, attach corners, follow
    the edges of torn nodes, and interpolate."""
    if seen.image is not None:
        looked = np.zeros(nodes.at.shape)
        while not nodes.there.all() and _look_again(nodes, looked, seen.image, least):
            drop_misfits(nodes)
            _reject(nodes, seen)
            attach(nodes, seen)
        for _ in range(PASSES):
            if not _follow_edges(nodes, seen.torn, seen.image):
                break
            drop_misfits(nodes)
            _reject(nodes, seen)
        _drop_outlying(nodes, seen.torn)
    _interpolate(nodes)


def _reject(nodes: Nodes, seen: Seen) -> None:
    """Reject nodes at the rim that do not look like corners of the pattern."""
    if seen.image is not None:
        evidence.reject(nodes, seen.image, seen.lines)


def drop_misfits(nodes: Nodes) -> None:
    """Drop nodes far from a well supported prediction, the worst of each neighbourhood first.

    It examines only nodes near a change since the last call. Corners that are far enough from their
    prediction to be astray are marked.
    """
    while nodes.changed.any():
        place = _near_changes(nodes)
        off = _misfits(nodes, place)
        nodes.astray[nodes.owner.take(place[off > ASTRAY])] = True
        bad = off > NEAR
        nodes.changed[:] = False
        if not bad.any():
            return
        row, column = np.divmod(place, nodes.at.shape[1])
        nodes.changed[row[bad], column[bad]] = True
        padded = np.zeros((nodes.at.shape[0] + 2, nodes.at.shape[1] + 2))
        padded[row + 1, column + 1] = off
        around = [padded[row + r, column + c] for r in range(3) for c in range(3)]
        worst = bad & (off >= np.max(around, axis=0))
        nodes.drop(row[worst], column[worst])


def _drop_outlying(nodes: Nodes, torn: Mask) -> None:
    """Drop torn nodes that are much farther from their predictions than the nodes around, the
    worst of each neighbourhood first.

    The edge of a spot or of a bubble near a corner looks like an edge of the corner.
    """
    while (nodes.there & (torn & nodes.astray)[nodes.owner]).any():
        predicted, weight = predict_all(nodes)
        off = np.where(weight < BRACKETED, np.nan, np.abs(nodes.at - predicted))
        row, column = np.nonzero((off > OUTLYING_PX) & torn[nodes.owner])
        cell = mean_steps(nodes.at, row, column)[2]
        wide = (cell > WIDEST) & (nodes.owner[row, column] >= 0)
        far = off[row, column] > np.where(wide, OUTLYING_WIDE_CELLS, OUTLYING_CELLS) * cell
        if not far.any():
            return
        row, column, wide = row[far], column[far], wide[far]
        usual, most = _around(off, row, column)
        bad = off[row, column] > np.where(wide, OUTLYING_WIDE, OUTLYING) * usual
        bad &= off[row, column] >= most
        if not bad.any():
            return
        nodes.drop(row[bad], column[bad])


def _around(off: Float, row: Index, column: Index) -> tuple[Float, Float]:
    """Return the median of the known values within BESIDE nodes of others, (N,), and the greatest
    one of the 3 x 3."""
    padded = np.pad(off, BESIDE, constant_values=np.nan)
    near = sliding_window_view(padded, (2 * BESIDE + 1, 2 * BESIDE + 1))[row, column]
    ordered = np.sort(near.reshape(len(row), -1))  # NaN last
    middle = np.count_nonzero(~np.isnan(ordered), axis=1) // 2
    return ordered[np.arange(len(row)), middle], np.fmax.reduce(near[:, 1:-1, 1:-1], axis=(1, 2))


def _near_changes(nodes: Nodes) -> Index:
    """Return the flat indices of the nodes whose misfit may have changed."""
    seen = nodes.there
    rows, columns = seen.shape
    if not nodes.changed.all():
        near = np.zeros((rows + 6, columns + 6), np.bool_)
        row, column = np.divmod(np.flatnonzero(nodes.changed), columns)
        reached = REACHED @ [columns + 6, 1]
        near.ravel()[((row + 3) * (columns + 6) + column + 3)[:, None] + reached] = True
        seen &= near[3:-3, 3:-3]
    return np.flatnonzero(seen)


def _misfits(nodes: Nodes, place: Index) -> Float:
    """Return the distances of nodes from well supported predictions, cells; 0 up to a pixel."""
    at, columns = nodes.at, nodes.at.shape[1]
    if len(place) > FEW:
        prediction, weight = (each.take(place) for each in predict_all(nodes))
    else:
        prediction, weight = predict_some(nodes, *np.divmod(place, columns))
    prediction[weight < STRONG] = NOWHERE
    gap = np.abs(at.take(place) - prediction)
    far = np.flatnonzero(gap > 1)
    off = np.zeros(len(place))
    if len(far):
        off[far] = gap[far] / mean_steps(at, *np.divmod(place[far], columns))[2]
    return off


def _expected(nodes: Nodes, least: float) -> tuple[Index, Index, Points, Float, Float, Points]:
    """Return the missing nodes whose prediction has at least that weight.

    Returns rows, columns, predictions, their weights, cells, and the direction in which the
    boundaries e0 and e2 should lie.
    """
    missing = np.flatnonzero(~nodes.there)
    row, column = np.divmod(missing, nodes.at.shape[1])
    if not len(row):
        return row, column, nodes.at[:0, 0], np.zeros(0), np.zeros(0), nodes.at[:0, 0]
    at, weight = predict_some(nodes, row, column)
    kept = weight >= least
    row, column, at, weight = row[kept], column[kept], at[kept], weight[kept]
    along, down, cell = mean_steps(nodes.at, row, column)
    level = (nodes.parity + row + column) % 2 == 0
    line = np.where(level, along, down)
    line[np.isnan(line)] = 0
    line /= np.maximum(np.abs(line), 1e-6)
    return row, column, at, weight, cell, line


def _attach(nodes: Nodes, seen: Seen) -> bool:
    """Attach free corners near the predictions of missing nodes; return whether there were any.

    A corner whose boundaries lie the other way round is another one.
    """
    free = np.flatnonzero(nodes.free)
    if not len(free):
        return False
    row, column, at, _, cell, line = _expected(nodes, WEAK)
    near, corner = nearest_pairs(at, seen.z[free], NEAR * cell)
    corner = free[corner]
    first, third = np.exp(1j * seen.edges[corner, 0]), np.exp(1j * seen.edges[corner, 2])
    along = np.abs(((first - third) * line[near].conj()).real)
    near, corner = near[~(along < 1)], corner[~(along < 1)]
    nodes.put(row[near], column[near], seen.z[corner], NodeStatus.ATTACHED)
    nodes.owner[row[near], column[near]] = corner
    nodes.free[corner] = False
    return len(near) > 0


def nearest_pairs(at: Points, z: Points, reach: Float) -> tuple[Index, Index]:
    """Return the indices in `at` and in `z` of mutually nearest points within reach."""
    order = np.argsort(z.real, kind="stable")
    x = z.real[order]
    begin = np.searchsorted(x, at.real - reach)
    count = np.searchsorted(x, at.real + reach, side="right") - begin
    here = np.repeat(np.arange(len(at)), count)
    skipped = np.cumsum(count) - count
    there = order[np.arange(len(here)) + np.repeat(begin - skipped, count)]
    away = np.abs(at[here] - z[there])
    close = away < reach[here]
    here, there, away = here[close], there[close], away[close]
    best = np.full(len(at), np.inf)
    best_there = np.full(len(z), np.inf)
    np.minimum.at(best, here, away)
    np.minimum.at(best_there, there, away)
    mutual = (away == best[here]) & (away == best_there[there])
    here, there = here[mutual], there[mutual]
    here, once = np.unique(here, return_index=True)
    there, twice = np.unique(there[once], return_index=True)
    return here[twice], there


def _look_again(nodes: Nodes, looked: Float, image: GreyImage, least: float) -> bool:
    """Refine at the predictions of missing nodes; return whether any was found.

    looked: (R, C), the weight of the prediction at the last look; another look is taken only if the
        weight has increased.
    """
    row, column, at, weight, cell, line = _expected(nodes, least)
    new = weight > looked[row, column]
    new &= (at.real >= 0) & (at.real < image.shape[1]) & (at.imag >= 0) & (at.imag < image.shape[0])
    if not new.any():
        return False
    row, column, at, cell, line = row[new], column[new], at[new], cell[new], line[new]
    looked[row, column] = weight[new]
    seen = second_look(image, at, cell, line)
    found = ~np.isnan(seen.real)
    row, column, seen, cell = row[found], column[found], seen[found], cell[found]
    nodes.put(row, column, seen, NodeStatus.SECOND_LOOK)
    false = _beside_another(nodes.at, row, column, APART * cell)
    false |= evidence.are_blank(nodes, image, row, column)
    nodes.drop(row[false], column[false])
    return not false.all()


def _follow_edges(nodes: Nodes, torn: Mask, image: GreyImage) -> bool:
    """Put nodes where their whole edges meet: those that are missing, and torn ones that are far
    from a well supported prediction. Return whether any was missing.

    A node that is moved shares the errors of its neighbours, which no filter can remove. On a worn
    print all nodes lie off their predictions, and only the outliers among them are moved.
    """
    asked = (torn & nodes.astray)[nodes.owner]  # missing nodes and those of a second look too
    row, column = np.divmod(np.flatnonzero(asked), nodes.at.shape[1])
    if not len(row):
        return False
    expected, weight = predict_some(nodes, row, column)
    along, down, cell = mean_steps(nodes.at, row, column)
    off = np.abs(nodes.at[row, column] - expected)
    settled = off <= np.maximum(ASTRAY * cell, OUTLYING * _usual(nodes))
    settled |= (cell > WIDEST) & ~np.isnan(off)
    left = np.flatnonzero((weight >= STRONG) & ~settled)
    if not len(left):
        return False
    row, column, expected = row[left], column[left], expected[left]
    along, down, cell = along[left], down[left], cell[left]
    found = along_edges(nodes, image, row, column, expected, (along, down, cell))
    kept = np.abs(found - expected) < ALONG * cell
    row, column, found, cell = row[kept], column[kept], found[kept], cell[kept]
    missing = np.isnan(nodes.at[row, column].real)
    nodes.put(row, column, found, NodeStatus.SECOND_LOOK)
    nodes.owner[row, column] = -1
    return bool(missing.any())


def _usual(nodes: Nodes) -> float:
    """Return the median distance of nodes from their predictions, px; 0 if few nodes show it."""
    predicted, weight = predict_all(nodes)
    off = np.abs(nodes.at - predicted)[weight == FULL]
    off = off[~np.isnan(off)]
    return median(off) if len(off) >= USUAL else 0.0


def _beside_another(at: Points, row: Index, column: Index, apart: Float) -> Mask:
    """Return a mask of the nodes that are nearer than `apart` to one of their eight neighbours."""
    padded = bordered(at)
    around = [padded[row + r, column + c] for r in (2, 3, 4) for c in (2, 3, 4) if (r, c) != (3, 3)]
    away = np.abs(np.stack(around) - at[row, column])
    beside: Mask = np.asarray(np.less(away, apart).any(axis=0))
    return beside


def _interpolate(nodes: Nodes) -> None:
    """Fill missing nodes between measured neighbours, inside the pattern only."""
    seen = nodes.there
    if seen.all():
        return
    inside = np.ones_like(seen)
    for axis in (0, 1):
        inside &= np.logical_or.accumulate(seen, axis)
        inside &= np.flip(np.logical_or.accumulate(np.flip(seen, axis), axis), axis)
    row, column, at, *_ = _expected(nodes, BRACKETED)
    kept = inside[row, column]
    nodes.put(row[kept], column[kept], at[kept], NodeStatus.INTERPOLATED)
