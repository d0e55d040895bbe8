"""Turns corners into a lattice: links between neighbours, closed cells, consistent numbers.

A corner sees four boundaries, e0..e3 clockwise, e0 from white to black. A half-edge is one
boundary of one corner, numbered 4 * corner + boundary. Directions on the lattice are units of
the complex plane: 1 along a row, 1j (down, clockwise) along a column, so a turn by one boundary
is a factor 1j. Positions in the image are complex too, x + 1j y.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complexfloating[Any, Any]]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Cells: largest distance of a neighbour; the cell is that of the sparser parts.
FARTHEST_NEIGHBOUR = 1.6
SPARSE = 0.1  # share of the points that may be farther apart than the cells
CROWD = 64  # most points within reach on one side of a point of a lattice
COSINE = 0.75  # least cosine between a boundary and the direction to the neighbour
SKEW = 0.18  # largest |a - b + c - d|^2 of a cell, over the squares of its diagonals
STRONG = 0.5  # share of the largest number of votes that a join on less certain links needs
UNITS = np.array([1, 1j, -1, -1j], np.complex64)


class Lattice(NamedTuple):
    """The position of every corner in the lattice of its component.

    component: (N,) int64, 0 for the largest, then by size; -1 for corners in no closed cell.
    size: (K,) int64, corners of each component.
    node: (N,) complex64, column + 1j row, whole numbers, from an arbitrary origin.
    turn: (N,) complex64, boundary e0 points along this unit of the lattice.
    support: (N,) int64, consistent links of the corner.
    bend: (N,) float32, deviation of opposite boundaries from one line, 0 to 2; NaN if unknown.
    axis: (K,) complex, mean step of the image along +1 of each component, px.
    """

    component: Index
    size: Index
    node: Complex
    turn: Complex
    support: Index
    bend: NDArray[np.float32]
    axis: Complex


def lattice(z: Complex, edges: NDArray[np.float32], sparse: float = SPARSE) -> Lattice:
    """Number the corners at z, (N,) complex px, by their boundary angles, (N, 4) rad.

    sparse: as of `near_pairs`.
    """
    order, first, second, step = near_pairs(z, sparse)
    lines, bend = _lines(edges)
    z, lines = z[order], lines.take(order, axis=1)
    half, other = _links(lines, first, second, step)
    cells = _cells(z, half, other)
    closed = np.flatnonzero(cells > 0)
    half, other = half[closed], other[closed]
    trees, agree = _counted(lines, half, other), np.ones(len(half), np.bool_)
    if trees is None:
        sure = cells[closed] == 2
        trees = _planted(len(z), half[sure], other[sure])
        trees = _join(trees, half[sure], other[sure], 0)
        trees = _join(trees, half, other, STRONG)
        agree = _agree(trees, half, other)
    return _arranged(z, bend, order, half, other, trees, agree)


def near_pairs(z: Complex, sparse: float = SPARSE) -> tuple[Index, Index, Index, Complex]:
    """Return the pairs of points that are at most FARTHEST_NEIGHBOUR cells apart.

    Returns an order of the points, the pairs as places in that order, each pair once, the lower
    place first, and the step from the first to the second. The cell follows from the density
    that all but a share of the points, `sparse`, exceed.
    """
    x, y = z.real.astype(np.float64), z.imag.astype(np.float64)
    x -= x.min()
    y -= y.min()
    wide, high = max(float(x.max()), 1.0), max(float(y.max()), 1.0)
    extent = max(wide, high)
    tile = max(np.sqrt(wide * high * 8 / len(z)), 1.0, extent / 1024)
    column = (x / tile).astype(np.int64)
    tiles = (y / tile).astype(np.int64) * (column.max() + 1) + column
    crowds = np.sort(np.bincount(tiles))
    crowd = crowds[np.searchsorted(np.cumsum(crowds), int(sparse * len(z)), side="right")]
    reach = max(FARTHEST_NEIGHBOUR * tile / np.sqrt(crowd), extent / 1024)

    # Strips of the image, each `reach` high, are laid end to end on one axis.
    strip = wide + 2 * reach
    height = y / reach
    number = np.floor(height)
    along = number * strip + x
    order = np.argsort(along, kind="stable")
    along, z = along[order], z[order]
    depth = (number + 1 - height)[order]  # from a point to the next strip
    width = reach * np.sqrt(1 - depth * depth)  # of the next strip, to either side, within reach
    ahead = np.searchsorted(along, along + reach)
    below = np.searchsorted(along, along + (strip - width))
    beyond = np.searchsorted(along, along + (strip + width))
    here = np.arange(len(z))
    begin, end = np.concatenate([here + 1, below]), np.concatenate([ahead, beyond])
    count = np.minimum(end - begin, CROWD)
    first = np.repeat(np.concatenate([here, here]), count)
    second = np.arange(len(first)) + np.repeat(begin - np.cumsum(count) + count, count)
    step = z.take(second) - z.take(first)
    near = np.flatnonzero(np.abs(step) < reach)
    return order, first.take(near), second.take(near), step.take(near)


def _lines(edges: NDArray[np.float32]) -> tuple[Complex, NDArray[np.float32]]:
    """Return the corners' two lines, (2, N) units along e0 - e2 and e1 - e3, and their bends."""
    edges = np.ascontiguousarray(edges.T)
    x, y = np.cos(edges), np.sin(edges)
    off = (x[:2] + x[2:]) ** 2 + (y[:2] + y[2:]) ** 2
    bend = np.sqrt(np.maximum(off[0], off[1]))
    x, y = x[:2] - x[2:], y[:2] - y[2:]
    length = np.maximum(np.sqrt(x * x + y * y), np.float32(1e-6))
    lines = np.empty(x.shape, np.complex64)
    lines.real, lines.imag = x / length, y / length
    return lines, bend


def _links(lines: Complex, first: Index, second: Index, step: Complex) -> tuple[Index, Index]:
    """Return the links: pairs of half-edges that choose each other.

    A corner looks along that half of its two lines which is nearest to the direction of the other
    corner. On a checkerboard one of two neighbours crosses from white to black there and the other
    from black to white, so the sum of the boundaries' numbers is odd. The choice is by length * (1
    + 4 (1 - cos)) of both ends.
    """
    length = np.abs(step)
    step = step * (1 / np.maximum(length, np.float32(1e-6)))
    k, cos_ahead = _boundary(lines.take(first, axis=1), step)
    m, cos_back = _boundary(lines.take(second, axis=1), -step)
    fits = (cos_ahead > COSINE) & (cos_back > COSINE) & ((k ^ m) & 1 == 1)
    kept = np.flatnonzero(fits)
    half = 4 * first.take(kept) + k.take(kept)
    other = 4 * second.take(kept) + m.take(kept)
    cost = length.take(kept) * (5 - 4 * cos_ahead.take(kept)) * (5 - 4 * cos_back.take(kept))
    best = np.full(4 * lines.shape[1], np.inf, cost.dtype)
    np.minimum.at(best, half, cost)
    np.minimum.at(best, other, cost)
    chosen = np.flatnonzero((best[half] == cost) & (best[other] == cost))
    return half[chosen], other[chosen]


def _boundary(lines: Complex, way: Complex) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Return the number of the boundary nearest to the direction `way`, and the cosine between
    them, of corners with those lines, (2, N)."""
    even, odd = (lines * way.conj()).real
    size_even, size_odd = np.abs(even), np.abs(odd)
    is_odd = size_odd > size_even
    behind = (odd < 0) & is_odd | (even < 0) & ~is_odd
    return is_odd.view(np.int8) + 2 * behind.view(np.int8), np.maximum(size_even, size_odd)


def _cells(z: Complex, half: Index, other: Index) -> NDArray[np.int8]:
    """Count the closed cells that each link bounds, 0 to 2.

    A cell is closed if four steps, each turning left, lead back to the start, and if it is
    near enough to a parallelogram.
    """
    nowhere = 4 * len(z)
    across = np.full(nowhere + 4, nowhere)  # the boundaries of one additional corner lead nowhere
    across[half] = other
    across[other] = half
    onward = (across & ~3) | ((across + 3) & 3)
    twice = onward[onward]
    itself = np.arange(nowhere + 4)
    lowest = (itself < onward) & (itself < twice)  # seldom more than one of a cell
    start = np.flatnonzero(lowest & (twice[twice] == itself))
    steps = np.stack([start, onward[start], twice[start], onward[twice[start]]])
    a, b, c, d = z[steps >> 2]
    skew, first, second = (v.real**2 + v.imag**2 for v in (a + c - b - d, a - c, b - d))
    cell = np.zeros(nowhere, np.bool_)
    near = skew < SKEW * (first + second)
    for step in steps:
        cell[step] = near
    # a later link of the same cost may have replaced an earlier one
    held = (across[half] == other) & (across[other] == half)
    count: NDArray[np.int8] = held * (cell[half].view(np.int8) + cell[other].view(np.int8))
    return count


class _Trees(NamedTuple):
    """A forest over the corners: the number of each corner's root, and its position in that
    frame."""

    root: Index
    node: Complex
    turn: Complex


def _counted(lines: Complex, half: Index, other: Index) -> _Trees | None:
    """Number the corners along some of the links; None if other links give other numbers.

    Each corner has the frame nearest to the mean one. If all links agree with these frames and
    numbers, no other frames and numbers can.
    """
    corners = lines.shape[1]
    squared = lines[0] * lines[0]
    axis = np.full(1, complex((squared * squared).mean()) ** 0.25, np.complex64)
    ahead, _ = _boundary(lines, axis)
    quarter = -ahead & 3
    a, b = half >> 2, other >> 2
    way = (quarter[a] + half) & 3
    if (way ^ (quarter[b] + other) & 3 != 2).any():
        return None
    step = UNITS[way]
    root, node = np.arange(corners), np.zeros(corners, np.complex64)
    child, parent, shift = b, a, step  # a is the lower of the two
    while len(child):
        root[child], node[child] = parent, shift  # of several parents the last holds
        while np.count_nonzero((higher := root[root]) != root):  # pointer jumping
            node += node[root]
            root = higher
        off = node[a] + step - node[b]
        one, two = root[a], root[b]
        apart = np.flatnonzero(one != two)
        one, two, shift = one[apart], two[apart], off[apart]
        child, parent = np.maximum(one, two), np.minimum(one, two)
        shift = np.where(one < two, shift, -shift)
    return None if len(b) and off.any() else _Trees(root, node, UNITS[quarter])


def _planted(corners: int, half: Index, other: Index) -> _Trees:
    """Return a first forest, in which each corner hooks to the lowest earlier one with a link to
    it."""
    nothing = 16 * corners
    lowest = np.full(corners, nothing)
    np.minimum.at(lowest, other >> 2, half << 2 | other & 3)
    child = np.flatnonzero(lowest < nothing)
    half, other = lowest[child] >> 2, lowest[child] & 3
    alone = _Trees(
        root=np.arange(corners),
        node=np.zeros(corners, np.complex64),
        turn=np.ones(corners, np.complex64),
    )
    planted = _hooked(alone, child, half >> 2, -UNITS[(half - other) & 3], UNITS[half & 3])
    number = np.cumsum(lowest == nothing) - 1  # of the trees, which are fewer
    return planted._replace(root=number[planted.root])


def _agree(trees: _Trees, half: Index, other: Index) -> Mask:
    """Return which links lead to the position and the frame that the other corner has."""
    a, b = half >> 2, other >> 2
    way = trees.turn[a] * UNITS[half & 3]
    onward = trees.node[a] + way == trees.node[b]
    agree: Mask = onward & (trees.turn[b] * UNITS[other & 3] == -way)
    return agree


def _join(trees: _Trees, half: Index, other: Index, share: float) -> _Trees:
    """Join trees along links until no link lies between two trees.

    In every pass each tree hooks to a tree of a lower root: the one for which most links agree on
    the relation of the two frames. Hooks with less than `share` of the largest number of votes
    wait. The number of passes grows with the logarithm of the size of the lattice.
    """
    while True:
        apart = np.flatnonzero(trees.root[half >> 2] != trees.root[other >> 2])
        if not len(apart):
            return trees
        half, other = half[apart], other[apart]
        *hooks, votes = _hooks(trees, half, other)
        strong = votes >= share * votes.max()
        child, parent, spin, shift = (values[strong] for values in hooks)
        trees = _hooked(trees, child, parent, spin, shift)


def _hooked(trees: _Trees, child: Index, parent: Index, spin: Complex, shift: Complex) -> _Trees:
    """Return the trees after those roots have hooked to others, flattened by pointer jumping."""
    above = np.arange(trees.root.max() + 1)
    above[child] = parent
    offset = np.zeros(len(above), np.complex64)
    offset[child] = shift
    spun = np.ones(len(above), np.complex64)
    spun[child] = spin
    while True:
        higher = above[above]
        if (higher == above).all():
            break
        turned = spun[above]
        offset, spun = offset[above] + turned * offset, turned * spun
        above = higher
    root = trees.root
    turned = spun[root]
    return _Trees(above[root], offset[root] + turned * trees.node, turned * trees.turn)


def _hooks(
    trees: _Trees, half: Index, other: Index
) -> tuple[Index, Index, Complex, Complex, Index]:
    """Return each tree with a neighbour of lower root, that root, its frame there, and votes."""
    down = trees.root[half >> 2] < trees.root[other >> 2]
    half, other = np.where(down, half, other), np.where(down, other, half)
    a, b = half >> 2, other >> 2
    parent, child = trees.root[a], trees.root[b]
    spin = trees.turn[a] * -UNITS[(half - other) & 3] * trees.turn[b].conj()
    shift = trees.node[a] + trees.turn[a] * UNITS[half & 3] - spin * trees.node[b]
    quarter = (spin.imag != 0) + 2 * (spin.real + spin.imag < 0)
    reach = int(max(np.abs(shift.real).max(), np.abs(shift.imag).max())) + 1
    key = (child * len(trees.root) + parent) * 4 + quarter
    key = key * (2 * reach) + (shift.real.astype(np.int64) + reach)
    key = key * (2 * reach) + (shift.imag.astype(np.int64) + reach)
    order = np.argsort(key)  # equal keys are equal hooks
    start = starts(key[order])
    votes = np.append(start[1:], len(key)) - start
    first = starts(child[order[start]])
    rank = votes * len(start) + np.arange(len(start))[::-1]
    winner = len(start) - 1 - np.maximum.reduceat(rank, first) % len(start)
    best = order[start[winner]]
    return child[best], parent[best], spin[best], shift[best], votes[winner]


def starts(values: Index) -> Index:
    """Return the indices at which runs of equal values start."""
    new = np.ones(len(values), np.bool_)
    np.not_equal(values[1:], values[:-1], out=new[1:])
    return np.flatnonzero(new)


def _arranged(
    z: Complex,
    bend: NDArray[np.float32],
    order: Index,
    half: Index,
    other: Index,
    trees: _Trees,
    agree: Mask,
) -> Lattice:
    """Return the components by size, in the corners' own order; z is in the sorted order."""
    root, node, turn = trees
    a, b = half >> 2, other >> 2
    support = np.bincount(a, agree, len(z)) + np.bincount(b, agree, len(z))
    linked = np.zeros(len(z), np.bool_)
    linked[a] = linked[b] = True
    count = np.bincount(root[linked], minlength=len(z))
    largest = np.argsort(-count, kind="stable")[: np.count_nonzero(count)]
    label = np.full(len(z), -1)
    label[largest] = np.arange(len(largest))
    label = np.where(linked, label[root], -1)
    along = (z[b] - z[a]) * (turn[a] * UNITS[half & 3]).conj()
    part = label[a]
    steps = np.maximum(np.bincount(part, minlength=len(largest)), 1)
    axis = np.bincount(part, along.real, len(largest)) / steps + 0j
    axis.imag = np.bincount(part, along.imag, len(largest)) / steps
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return Lattice(
        component=label[back],
        size=count[largest],
        node=node[back],
        turn=turn[back],
        support=support.astype(np.int64)[back],
        bend=bend,
        axis=axis,
    )
