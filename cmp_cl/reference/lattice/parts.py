"""Corners to parts of the lattice: links, faces, parts.

A half-edge h = 4 i + s is boundary s of corner i. Every decision is made in integers, or in float32
with + - * and comparisons in a fixed order, so that the kernels give the same bits. A position or a
step (x, y) is x + i y: sums of those, and products with real numbers, are the same for both axes.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.reference.harmonic import smoothed

Whole = NDArray[np.int64]
Real = NDArray[np.float32]
Places = NDArray[np.complex64]
Mask = NDArray[np.bool_]

TURN = 65536  # units of an angle in a full turn
DIRECTIONS = 1024  # unit vectors in a full turn
COSINE = (np.rint(16384 * np.cos(np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS))) / 16384).astype(
    np.float32
)
STEPS = np.array([1, 1j, -1, -1j])  # columns + 1j rows, by direction
F = np.float32
NOWHERE = np.complex64(complex(np.nan, np.nan))
SIDE_POINTS, MIDDLE_POINTS = (0.25, 0.375, 0.5, 0.625, 0.75), (0.375, 0.5, 0.625)  # of a side


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Parts:
    """Closed faces and the parts that they form, all (4 N,) by half-edge.

    twin: the half-edge at the other end of its link, -1 without one. face: the least half-edge of
    its closed face, -1 without one. cut: how often the tolerance of its face was lowered. root: the
    least half-edge of its part, -1 without one. column, row: number of its corner from that of the
    root. direction: of the half-edge in the lattice, 0 to 3. contradicted: its part has no numbers.
    """

    twin: Whole
    face: Whole
    cut: Whole
    root: Whole
    column: Whole
    row: Whole
    direction: Whole
    contradicted: Mask


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Directed:
    """Corners with their boundaries: at (N,), px; angle (N, 4), 1/65536 turn; contrast (N,), twice
    the contrast of their cells, see `levels_of`; placed, known (N,), False without a position, and
    without angles."""

    at: Places
    angle: Whole
    contrast: Whole
    placed: Mask
    known: Mask


def parts(
    plane: NDArray[np.integer],
    xy: NDArray[np.float32],
    edges: NDArray[np.float32],
    torn: Mask,
    constants: LatticeConstants,
) -> Parts:
    """Return the parts of the lattice.

    plane: (H, W), see `levels_of`. xy: (N, 2), px. edges: (N, 4), rad, NaN
    where unknown. torn: (N,), corners whose refinement was rejected.
    """
    corners = directed(plane, xy, edges, constants)
    return parts_of(corners, torn, links(plane, corners, constants), constants)


# --- arithmetic ---------------------------------------------------------------------------


def inverse_root(x: Real) -> Real:
    """Return 1 / sqrt(x) by a start from the bits and three Newton steps; x > 0."""
    x = np.asarray(x, np.float32)
    y = (np.int32(0x5F3759DF) - (x.view(np.int32) >> 1)).view(np.float32)
    half = F(0.5) * x
    for _ in range(3):
        y = y * (F(1.5) - (half * y) * y)
    return y


def at_of(x: Real, y: Real) -> Places:
    """Return positions x + i y, in single precision."""
    at = np.empty(x.shape, np.complex64)
    at.real, at.imag = x, y
    return at


def dot(one: Places, other: Places) -> Real:
    result: Real = one.real * other.real + one.imag * other.imag
    return result


def length_of(step: Places, least: float = 0.0) -> Real:
    """Return the length of steps; least: the square of a smaller one."""
    square = np.maximum(dot(step, step), F(least))
    length: Real = square * inverse_root(square)
    return length


def levels_of(image: GreyImage, full_scale: int) -> Whole:
    """Return 64 times the square root of S1 of docs/algorithm.md, to within .2 %, (H, W).

    Light multiplies what a print reflects, so cells in a shadow differ by less than others; in
    roots by the root of that, and the noise of a camera is even.
    """
    level = smoothed(image, full_scale)[0].astype(np.float32)
    y = (np.int32(0x5F3759DF) - (level.view(np.int32) >> 1)).view(np.float32)
    root = level * y
    levels: Whole = (F(64) * root * (F(1.5) - F(0.5) * root * y)).astype(np.int64)
    return levels


def unit(angle: Whole) -> Places:
    """Return the unit vectors of angles of 1/65536 turn, from a table."""
    m = ((angle + 32) >> 6) % DIRECTIONS
    return at_of(COSINE[m], COSINE[(m - DIRECTIONS // 4) % DIRECTIONS])


def read(plane: NDArray[np.integer], at: Places) -> Whole:
    """Return the levels at the nearest pixels; beyond the image its border is repeated."""
    height, width = plane.shape
    column = np.clip(np.floor(at.real + F(0.5)).astype(np.int64), 0, width - 1)
    row = np.clip(np.floor(at.imag + F(0.5)).astype(np.int64), 0, height - 1)
    level: Whole = plane[row, column].astype(np.int64)
    return level


# --- corners and links --------------------------------------------------------------------


def directed(
    plane: NDArray[np.integer],
    xy: NDArray[np.float32],
    edges: NDArray[np.float32],
    constants: LatticeConstants,
) -> Directed:
    """Return the directions of the two boundary lines of each corner, and its contrast."""
    known: Mask = ~np.isnan(np.concatenate([xy, edges], axis=1)).any(axis=1)
    placed: Mask = np.isfinite(xy[:, 0] + xy[:, 1])
    at = at_of(*np.where(placed, xy.astype(np.float32).T, F(0)))
    turns = np.where(known[:, None], edges, 0).astype(np.float32) * F(10430.378)
    q = np.floor(turns + F(0.5)).astype(np.int64) % TURN
    opposite = (q[:, 2:] + TURN // 2) % TURN
    apart = (opposite - q[:, :2] + TURN // 2) % TURN - TURN // 2
    line = (q[:, :2] + (apart >> 1)) % TURN
    angle = np.concatenate([line, (line + TURN // 2) % TURN], axis=1)
    between = (angle + (((np.roll(angle, -1, axis=1) - angle) % TURN) >> 1)) % TURN
    level = read(plane, at[:, None] + F(constants.contrast_radius_px) * unit(between))
    contrast = level[:, 1] + level[:, 3] - level[:, 0] - level[:, 2]
    contrast = np.maximum(contrast, 1)
    return Directed(at=at, angle=angle, contrast=contrast, placed=placed, known=known)


def candidates(shape: tuple[int, int], corners: Directed, constants: LatticeConstants) -> Whole:
    """Return pairs (i, j) of corners near each other, (M, 2), in order of i, then of j.

    Corners are in square bins. The candidates of a corner are all in the bins around its own, as
    far as it takes until these hold `link_neighbours` corners, with and without boundaries.
    """
    height, width = shape
    some = np.flatnonzero(corners.placed)
    at, shift = corners.at[some], 2
    while ((width * height) >> (2 * shift)) > 4 * max(len(corners.at), 1):
        shift += 1
    column = np.clip(np.floor(at.real).astype(np.int64), 0, width - 1) >> shift
    row = np.clip(np.floor(at.imag).astype(np.int64), 0, height - 1) >> shift
    apart = np.maximum(*(np.abs(np.subtract.outer(each, each)) for each in (row, column)))
    ring = np.full(len(some), constants.link_rings)
    if len(some) >= constants.link_neighbours:
        last = constants.link_neighbours - 1
        ring = np.clip(np.partition(apart, last, axis=1)[:, last], 1, constants.link_rings)
    both = some[np.argwhere(apart <= ring[:, None])]
    found: Whole = both[(both[:, 0] != both[:, 1]) & corners.known[both].all(axis=1)]
    return found


def links(plane: NDArray[np.integer], corners: Directed, constants: LatticeConstants) -> Whole:
    """Return the twin of each half-edge, (4 N,), -1 without one.

    A half-edge chooses its cheapest candidate. A link is a choice of both its ends, and a side in
    the image. If it passes over a nearer candidate and a link as short crosses it, its ends choose
    once more, among nearer ones.
    """
    twin = np.full(4 * len(corners.at), -1)
    if np.count_nonzero(corners.known) < 2:
        return twin
    i, j = candidates(plane.shape, corners, constants).T
    chord = corners.at[j] - corners.at[i]
    length = length_of(chord, 1)
    s, along_i = boundary(corners.angle[i], chord)
    t, along_j = boundary(corners.angle[j], -chord)
    straight = F(constants.least_cosine) * length
    square = dot(chord, chord)
    good = (square >= 1) & (along_i > straight) & (along_j > straight) & ((s + t) % 2 == 1)
    cost = length + F(constants.turn_price) * ((length + length) - (along_i + along_j))
    key = np.floor(cost * F(64)).astype(np.int64)
    h, other, key, square = (4 * i + s)[good], (4 * j + t)[good], key[good], square[good]
    order = np.lexsort((other, key, h))
    h, other, square = h[order], other[order], square[order]

    choice, passes = twin.copy(), np.zeros(len(twin), np.bool_)
    limit = np.full(len(twin), np.inf, np.float32)
    for _ in range(2):
        some, again = square < limit[h], limit > 0
        choice[again] = -1
        choice[h[some][::-1]] = other[some][::-1]  # the first of each half-edge
        chosen, least = np.zeros_like(limit), np.full_like(limit, np.inf)
        own = other == choice[h]
        chosen[h[own]] = square[own]
        np.minimum.at(least, h, square)
        passes = np.where(again, least < chosen, passes)
        link = np.where(twin < 0, linked(plane, corners, choice, constants), twin)
        left = uncrossed(corners, link, link)
        twin = np.where((twin < 0) & (passes | passes[link]), left, link)
        limit = np.where((link >= 0) & (twin < 0), chosen, F(0))
    return twin


def linked(
    plane: NDArray[np.integer], corners: Directed, choice: Whole, constants: LatticeConstants
) -> Whole:
    """Return the links: choices of both their ends, where the image shows a side."""
    h = np.flatnonzero((choice >= 0) & (choice[choice] == np.arange(len(choice))))
    h = h[has_side(plane, corners, h, choice[h], constants)]
    link = np.full(len(choice), -1)
    link[h] = choice[h]
    return link


def uncrossed(corners: Directed, twin: Whole, others: Whole) -> Whole:
    """Return the twins without those that another link as short crosses: a lattice lies in a
    plane."""
    h, g = (np.flatnonzero(each > np.arange(len(each))) for each in (twin, others))
    (a, b), (c, d) = (h >> 2, twin[h] >> 2), (g >> 2, others[g] >> 2)
    own, its = corners.at[b] - corners.at[a], corners.at[d] - corners.at[c]
    square, its_square = dot(own, own), dot(its, its)

    def side(one: Whole, other: Whole, corner: Whole) -> Mask:
        """Return on which side of the lines from one to the other a corner is."""
        way, off = corners.at[other] - corners.at[one], corners.at[corner] - corners.at[one]
        is_left: Mask = way.real * off.imag < way.imag * off.real
        return is_left

    left = twin.copy()
    for n in range(len(h)):  # by brute force: the kernel looks in bins
        ends = a[n], b[n]
        some = (its_square <= square[n]) & ~np.isin(c, ends) & ~np.isin(d, ends)
        e, f = c[some], d[some]
        if ((side(*ends, e) != side(*ends, f)) & (side(e, f, a[n]) != side(e, f, b[n]))).any():
            left[h[n]] = left[twin[h[n]]] = -1
    return left


def boundary(angle: Whole, chord: Places) -> tuple[Whole, Real]:
    """Return the boundary nearest to a chord, and the chord's length along it."""
    along_0, along_1 = (dot(unit(angle[:, line]), chord) for line in (0, 1))
    line = np.where(np.abs(along_0) >= np.abs(along_1), 0, 1)
    along = np.where(line == 0, along_0, along_1)
    return np.where(along >= 0, line, line + 2), np.abs(along)


def depth_within(depth: float, per_px: Real, constants: LatticeConstants) -> Real:
    """Return how deep cells of a length are read, in shares of it; per_px: 1 over the length."""
    result: Real = F(depth) * np.minimum(F(1), F(constants.wide_px) * per_px)
    return result


def side_depth(per_px: Real, constants: LatticeConstants) -> Real:
    """Return how far beside a way its sides are read, in shares of its length."""
    within = depth_within(constants.side_depth_cells, per_px, constants)
    result: Real = np.maximum(within, F(constants.side_depth_px) * per_px)
    return result


def side_sum(
    plane: NDArray[np.integer],
    start: Places,
    step: Places,
    constants: LatticeConstants,
    points: tuple[float, ...] = SIDE_POINTS,
    depth: Real | None = None,
) -> Whole:
    """Return the sum over points of the level left of a way less that right of it, at a depth in
    shares of it; without one, near to it."""
    square = np.maximum(dot(step, step), F(1))
    depth = side_depth(inverse_root(square), constants) if depth is None else depth
    across = depth * (1j * step)
    total = np.zeros(start.shape, np.int64)
    for t in points:
        at = start + F(t) * step
        total += read(plane, at - across) - read(plane, at + across)
    return total


def has_side(
    plane: NDArray[np.integer],
    corners: Directed,
    h: Whole,
    other: Whole,
    constants: LatticeConstants,
) -> Mask:
    """Return whether the image shows a side of a cell in the middle between two half-edges, as both
    claim, near it or deeper in the cells."""
    low, high = np.minimum(h, other), np.maximum(h, other)
    p, q = low >> 2, high >> 2
    start, step, sign = corners.at[p], corners.at[q] - corners.at[p], 1 - 2 * (low & 1)
    near = sign * side_sum(plane, start, step, constants, MIDDLE_POINTS)
    within = np.full(len(h), constants.deep_cells, np.float32)
    deep = sign * side_sum(plane, start, step, constants, MIDDLE_POINTS, within)
    middle = np.maximum(near, deep)
    product = corners.contrast[p].astype(np.float32) * corners.contrast[q].astype(np.float32)
    share = F(2) * middle.astype(np.float32) * inverse_root(product)
    seen: Mask = share > F(3 * constants.side_middle)
    return seen


# --- faces and parts ----------------------------------------------------------------------


def following(twin: Whole) -> Whole:
    """Return the next half-edge of a face, (4 N,): step, turn right; -1 without a link."""
    return np.where(twin >= 0, (twin & ~3) | ((twin - 1) & 3), -1)


def around(twin: Whole) -> Whole:
    """Return the four half-edges of the face that begins at each, (4, 4 N), -1 if it is open."""
    after = following(twin)
    path = [np.arange(len(twin))]
    for _ in range(4):
        path.append(np.where(path[-1] >= 0, after[path[-1]], -1))
    closed = path[4] == path[0]
    return np.where(closed, np.stack(path[:4]), -1)


def parts_of(corners: Directed, torn: Mask, twin: Whole, constants: LatticeConstants) -> Parts:
    """Return the parts: closed faces that agree, cut until no part contradicts itself. The faces of
    torn corners must agree more closely from the beginning."""
    path = around(twin)
    closed = path[0] >= 0
    face = np.where(closed, path.min(axis=0), -1)
    gap, size = _difference(corners, twin, path)
    torn_corners = np.where(closed, torn[path >> 2].sum(axis=0), 0)
    cut = np.maximum(torn_corners - constants.torn_corners, 0)
    tolerance = constants.face_tolerances()
    for repeat in range(constants.cuts + 1):
        agree = (gap >= 0) & (gap < tolerance[np.maximum(cut, cut[twin])] * size)
        root, column, row, direction = numbered(twin, following(twin), closed, agree)
        bad = contradicted(root, column, row, direction)
        if not bad.any() or repeat == constants.cuts:
            break
        cut[bad] = np.minimum(cut[bad] + 1, constants.cuts)
    return Parts(
        twin=twin,
        face=face,
        cut=cut,
        root=root,
        column=column,
        row=row,
        direction=direction,
        contradicted=bad,
    )


def _difference(corners: Directed, twin: Whole, path: Whole) -> tuple[Real, Real]:
    """Return by half-edge how far its face and that of its twin differ, and their size, px^2; a
    difference of -1 where one of them is open."""
    closed = path[0] >= 0
    at = corners.at[np.maximum(path, 0) >> 2]
    u, v = (at[1] - at[0]) + (at[2] - at[3]), (at[3] - at[0]) + (at[2] - at[1])
    s, t = u + u[twin], v + v[twin]
    gap, size = dot(s, s) + dot(t, t), dot(u, u) + dot(v, v)
    both = closed & (twin >= 0) & closed[twin]
    return np.where(both, gap, F(-1)), np.minimum(size, size[twin])


def numbered(
    twin: Whole, after: Whole, closed: Mask, agree: Mask
) -> tuple[Whole, Whole, Whole, Whole]:
    """Return root, column, row and direction of each closed half-edge, root -1 of the others.

    A step along a half-edge goes to the next of its face, and across it to its twin where both
    faces agree. The least half-edge of a part is its root, with number (0, 0) and direction 0.
    """
    count = len(twin)
    ways = [(after.tolist(), 1), (np.where(agree, twin, -1).tolist(), 2)]
    root, number, direction = [-1] * count, [0j] * count, [0] * count
    for first in np.flatnonzero(closed).tolist():
        if root[first] >= 0:
            continue
        root[first], reached = first, [first]
        for h in reached:  # it grows
            for way, turn in ways:
                other = way[h]
                if other >= 0 and root[other] < 0:
                    root[other] = first
                    number[other] = number[h] + STEPS[direction[h]]
                    direction[other] = (direction[h] + turn) % 4
                    reached.append(other)
    columns, rows = np.real(number).astype(np.int64), np.imag(number).astype(np.int64)
    return np.array(root, np.int64), columns, rows, np.array(direction, np.int64)


def contradicted(root: Whole, column: Whole, row: Whole, direction: Whole) -> Mask:
    """Return by half-edge whether one corner of its part has two numbers or two rotations there."""
    h = np.flatnonzero(root >= 0)
    rotation = (direction[h] - h) % 4
    state = np.stack([column[h], row[h], rotation], axis=1)
    order = np.lexsort((root[h], h >> 2))
    same = (h[order][1:] >> 2 == h[order][:-1] >> 2) & (root[h][order][1:] == root[h][order][:-1])
    differ = same & (state[order][1:] != state[order][:-1]).any(axis=1)
    bad = np.zeros(len(root), np.bool_)
    bad[root[h][order][1:][differ]] = True
    return np.where(root >= 0, bad[root], False)
