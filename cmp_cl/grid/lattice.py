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
BINS = 4  # along a row, for the largest distance of neighbours
MOST_BINS = 8  # for each point
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
    axis: (K,) complex, of each component: along the mean direction of +1 in the image.
    """

    component: Index
    size: Index
    node: Complex
    turn: Complex
    support: Index
    axis: Complex


def lattice(z: Complex, lines: Complex, sparse: float = SPARSE) -> Lattice:
    """Number the corners at z, (N,) complex px, by their lines, see `lines_of`.

    sparse: as in `near_pairs`.
    """
    order, first, second, step = near_pairs(z, sparse)
    z, lines = z.take(order), lines.take(order, axis=1)
    half, other = _links(lines, first, second, step)
    cells = _cells(z, half, other)
    closed = cells.nonzero()[0]
    half, other = half.take(closed), other.take(closed)
    trees, agree = _counted(lines, half, other), None
    if trees is None:
        sure = cells.take(closed) == 2
        trees = _planted(len(z), half[sure], other[sure])
        trees = _join(trees, half[sure], other[sure], 0)
        trees = _join(trees, half, other, STRONG)
        agree = _agree(trees, half, other)
    return _arranged(lines, order, half, other, trees, agree)


def near_pairs(z: Complex, sparse: float = SPARSE) -> tuple[Index, Index, Index, Complex]:
    """Return the pairs of points that are at most FARTHEST_NEIGHBOUR cells apart.

    Returns an order of the points, the pairs as places in that order, each pair once, the lower
    place first, and the step from the first to the second. The cell follows from the density
    that is exceeded around all points but a share, `sparse`.
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
    crowd = crowds[crowds.cumsum().searchsorted(int(sparse * len(z)), side="right")]
    reach = max(FARTHEST_NEIGHBOUR * tile / np.sqrt(crowd), extent / 1024)

    # The image is divided into bins, in rows `reach` high. They are numbered row by row, with empty
    # ones between the rows. Their number is at most proportional to that of the points.
    bin_width = max(reach / BINS, wide * high / (reach * MOST_BINS * len(z)))
    margin = int(reach / bin_width) + 1
    columns = int(wide / bin_width) + 1 + margin
    x /= bin_width
    y /= reach
    row = y.astype(np.int64)
    number = row * columns + x.astype(np.int64)
    rows = int(row.max()) + 2
    order = number.astype(np.min_scalar_type(rows * columns)).argsort(kind="stable")
    number, z = number.take(order), z.take(order)
    until = np.bincount(number + 1, minlength=rows * columns + margin + 1).cumsum()
    depth = row + 1 - y  # from a point to the next row
    width = np.sqrt(1 - depth * depth) * (reach / bin_width)  # bins: half of what is in reach there
    next_row = (row + 1) * columns
    below = np.maximum(x - width, 0).astype(np.int64) + next_row
    beyond = (x + width).astype(np.int64) + (next_row + 1)
    here = np.arange(len(z))
    begin = np.concatenate([here + 1, until.take(below.take(order))])
    end = np.concatenate([until.take(number + (margin + 1)), until.take(beyond.take(order))])
    count = np.minimum(end - begin, CROWD)
    first = np.concatenate([here, here]).repeat(count)
    second = np.arange(len(first))
    second += (begin + count - count.cumsum()).repeat(count)
    step = z.take(second)
    step -= z.take(first)
    near = (np.abs(step) < reach).nonzero()[0]
    return order, first.take(near), second.take(near), step.take(near)


def bends(edges: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the deviation of opposite boundaries from one line, (N,), 0 to 2; NaN if unknown."""
    edges = edges.T
    x, y = np.cos(edges), np.sin(edges)
    off = (x[:2] + x[2:]) ** 2 + (y[:2] + y[2:]) ** 2
    bend: NDArray[np.float32] = np.sqrt(np.maximum(off[0], off[1]))
    return bend


def lines_of(edges: NDArray[np.float32]) -> Complex:
    """Return the corners' two lines, (2, N) units along e0 - e2 and e1 - e3."""
    edges = np.ascontiguousarray(edges.T)
    x, y = np.cos(edges), np.sin(edges)
    x, y = x[:2] - x[2:], y[:2] - y[2:]
    length = np.maximum(np.sqrt(x * x + y * y), np.float32(1e-6))
    lines = np.empty(x.shape, np.complex64)
    lines.real, lines.imag = x / length, y / length
    return lines


def _links(lines: Complex, first: Index, second: Index, step: Complex) -> tuple[Index, Index]:
    """Return the links: pairs of half-edges that choose each other.

    A corner looks along that half of its two lines which is nearest to the direction of the other
    corner. On a checkerboard one of two neighbours crosses from white to black there and the other
    from black to white, so the sum of the boundaries' numbers is odd. A half-edge chooses the least
    product of the length and the factors 1 + 4 (1 - cos) of both ends.
    """
    length = np.abs(step)
    k, ahead = _boundary(lines.take(first, axis=1), step)
    kept = (ahead > COSINE * length).nonzero()[0]
    first, second, k = first.take(kept), second.take(kept), k.take(kept)
    step, length, ahead = step.take(kept), length.take(kept), ahead.take(kept)
    m, back = _boundary(lines.take(second, axis=1), -step)
    half, other = 4 * first + k, 4 * second + m
    fits = (back > COSINE * length) & ((k ^ m) & 1 == 1)
    cost = (5 * length - 4 * ahead) * (5 * length - 4 * back) / length
    cost = np.where(fits, cost, np.inf)
    best = np.full(4 * lines.shape[1], np.inf, cost.dtype)
    np.minimum.at(best, half, cost)
    np.minimum.at(best, other, cost)
    chosen = (fits & (best.take(half) == cost) & (best.take(other) == cost)).nonzero()[0]
    return half.take(chosen), other.take(chosen)


def _boundary(lines: Complex, way: Complex) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
    """Return the number of the boundary nearest to the direction `way`, and the component of `way`
    along it, of corners with those lines, (2, N)."""
    even, odd = (lines * way.conj()).real
    size_even, size_odd = np.abs(even), np.abs(odd)
    is_odd, behind = size_odd > size_even, even + odd < 0  # the sum has the sign of the larger
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
    twice = onward.take(onward)
    itself = np.arange(nowhere + 4)
    start = ((itself < onward) & (itself < twice)).nonzero()[0]  # seldom two of a cell
    start = start.compress(twice.take(twice.take(start)) == start)
    opposite = twice.take(start)
    steps = start, onward.take(start), opposite, onward.take(opposite)
    a, b, c, d = (z.take(step >> 2) for step in steps)
    one, two = a - c, b - d
    near = _square(a - b + c - d) < SKEW * (_square(one) + _square(two))
    cell = np.zeros(nowhere, np.int8)
    for step in steps:
        cell[step] = near.view(np.int8)
    # a later link of the same cost may have replaced an earlier one
    held = (across.take(half) == other) & (across.take(other) == half)
    count: NDArray[np.int8] = held * (cell.take(half) + cell.take(other))
    return count


def _square(step: Complex) -> NDArray[np.floating[Any]]:
    """Return the squared lengths."""
    return np.abs(step) ** 2


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
    axis = complex(np.dot(squared, squared)) ** 0.25
    ahead, _ = _boundary(lines, np.array([axis], np.complex64))
    quarter = -ahead & 3
    a, b = half >> 2, other >> 2
    way, back = quarter.take(a) + half, quarter.take(b) + other
    if ((way - back & 3) != 2).any():
        return None
    step = UNITS.take(way & 3)
    root, node = np.arange(corners), np.zeros(corners, np.complex64)
    child, parent, shift = b, a, step  # a is the lower of the two
    while len(child):
        root[child], node[child] = parent, shift  # of several parents the last holds
        while np.count_nonzero((higher := root.take(root)) != root):  # pointer jumping
            node += node.take(root)
            root = higher
        off = node.take(a) + step - node.take(b)
        one, two = root.take(a), root.take(b)
        apart = (one != two).nonzero()[0]
        one, two, shift = one.take(apart), two.take(apart), off.take(apart)
        child, parent = np.maximum(one, two), np.minimum(one, two)
        shift = np.where(one < two, shift, -shift)
    return None if len(b) and off.any() else _Trees(root, node, UNITS.take(quarter))


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
    lines: Complex,
    order: Index,
    half: Index,
    other: Index,
    trees: _Trees,
    agree: Mask | None,
) -> Lattice:
    """Return the components by size, with the corners in their own order.

    order: of the corners in the other arguments. agree: a mask of the links that agree with the
    trees, None if all do.
    """
    root, node, turn = trees
    a, b = half >> 2, other >> 2
    corners = len(order)
    support = links = np.bincount(a, minlength=corners) + np.bincount(b, minlength=corners)
    if agree is not None:
        a, b = a[agree], b[agree]
        support = np.bincount(a, minlength=corners) + np.bincount(b, minlength=corners)
    linked = links > 0
    count = np.bincount(root.compress(linked), minlength=corners)
    largest = (-count).argsort(kind="stable")[: np.count_nonzero(count)]
    label = np.full(corners, -1)
    label[largest] = np.arange(len(largest))
    label = np.where(linked, label.take(root), -1)
    along = lines[0] * turn.conj()
    axis = np.bincount(label + 1, along.real)[1:] + 0j
    axis.imag = np.bincount(label + 1, along.imag)[1:]
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return Lattice(
        component=label.take(back),
        size=count.take(largest),
        node=node.take(back),
        turn=turn.take(back),
        support=support.take(back),
        axis=axis,
    )
