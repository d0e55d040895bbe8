"""The nodes are numbered in a grid of known shape here."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.border import Border, Ends
from cmp_cl.grid.grid import NO_SIDES, Sides
from cmp_cl.grid.grow import Seen, nearest_pairs
from cmp_cl.grid.lattice import bends
from cmp_cl.grid.nodes import NOWHERE, Index, Mask, Nodes, Points
from cmp_cl.grid.numbering import Numbered

WHOLE = 1024  # weight of a corner with straight boundaries
STRAIGHT = 0.5  # largest bend of a corner that is no junction with the surround
LEAST_LINE = 3  # corners: half of fewer may be a single false one
# Corners that are no nodes and form a further line: how many, of how many of its places, how far
# from them, cells, and the least cosine between their edges and the lattice's steps.
LEAST_FURTHER, MOST_OF, OFF, IN_LINE = 2, 0.6, 0.2, 0.9


def in_shape(
    nodes: Nodes, bend: NDArray[np.float32], shape: tuple[int, int], ends: Ends
) -> Numbered:
    """Return the nodes in a grid of that shape.

    If the shape fits better with rows and columns exchanged, the grid is turned so that its columns
    stay nearest to the image's x axis. If fewer nodes are seen, the borders in view decide which
    part it is. That is not sure if a border's line continues past the pattern: such an edge may
    also leave as many rows as the shape has columns. If more nodes are seen, the fullest window is
    taken, the one nearest to the top left.

    bend: (N,), as `bends` returns it. ends: the sides on which the pattern ends.
    """
    turns = [0]
    if shape[0] != shape[1]:
        falling = float(np.nansum((nodes.at[:, 1:] - nodes.at[:, :-1]).imag)) > 0
        turns.append(3 if falling else 1)
    turned = [nodes.turned(turn) for turn in turns]
    sides = [ends.turned(turn) for turn in turns]
    misfit = [
        _misfit(each.at.shape, shape, side.border) for each, side in zip(turned, sides, strict=True)
    ]
    likely = [n for n, off in enumerate(misfit) if off == min(misfit)]
    windows = [_fullest(turned[n], bend, shape) for n in likely]
    fullest = int(np.argmax([weight for weight, _, _ in windows]))
    best = likely[fullest]
    _, top, left = windows[fullest]
    found, (border, cut, passing) = turned[best], sides[best]
    starts, unsure = [top, left], len(likely) > 1
    either_way = bool(np.less_equal(found.at.shape, shape[::-1]).all())
    for axis in (0, 1):
        lack = shape[axis] - found.at.shape[axis]
        if lack > 0:
            first, last = 2 * axis, 2 * axis + 1
            begin, end = border[first], border[last]
            starts[axis] = -lack if end and not begin else 0
            unsure |= not ((begin and end) or (begin and cut[last]) or (end and cut[first]))
            unsure |= any(passing if either_way else passing[first : last + 1])
    seen = _seen_shape(found, bend, shape, (top, left), border)
    numbered = found.window(starts[0], starts[1], shape)
    return Numbered(numbered, ambiguous=unsure, quarters=turns[best], seen_shape=seen)


def followed(numbered: Numbered, border: Border, seen: Seen) -> Numbered:
    """Return the nodes, and the shape that is seen if more of the pattern shows beside them.

    There, further cells follow, whose corners are hidden or too few for a line. Or corners follow
    that are no nodes, because things in their cells or beside them disturb the evidence. One line
    on each side is counted. Nothing is told where the nodes may be another part of the shape.
    """
    if numbered.seen_shape is not None or numbered.ambiguous:
        return numbered
    lines = _further_lines(numbered.nodes, border.sides, seen)
    sides = Sides(*(any(side) for side in zip(border.followed, lines, strict=True)))
    if not any(sides):
        return numbered
    rows, columns = numbered.nodes.at.shape
    size = rows + sides.top + sides.bottom, columns + sides.left + sides.right
    return numbered._replace(seen_shape=size)


def _further_lines(nodes: Nodes, ends: Sides, seen: Seen) -> Sides:
    """Return the sides beyond which corners that are no nodes form most of a line.

    ends: the sides on which the pattern ends, which are left out.
    """
    other = np.ones(len(seen.z), np.bool_)
    other[nodes.owner[nodes.owner >= 0]] = False
    corner = np.flatnonzero(other)
    if all(ends) or len(corner) < LEAST_FURTHER or min(nodes.at.shape) < 2:
        return NO_SIDES
    return Sides(
        *(
            not end and _is_line_further(*way, corner, seen)
            for way, end in zip(nodes.from_sides(), ends, strict=True)
        )
    )


def _is_line_further(at: Points, parity: int, corner: Index, seen: Seen) -> bool:
    """Return whether corners continue most columns of nodes, (R, C) px, before the first row.

    parity: the edges e0 and e2 of a corner lie along the row if parity + row + column is even.
    corner: the corners that may.
    """
    line, out = at[0], at[0] - at[1]
    after = np.append(line[1:] - line[:-1], NOWHERE)
    before = np.append(NOWHERE, after[:-1])
    along = np.where(np.isnan(after), before, after)
    known = np.flatnonzero(~np.isnan(out) & ~np.isnan(along))
    near, found = nearest_pairs((line + out)[known], seen.z[corner], OFF * np.abs(out[known]))
    column, found = known[near], corner[found]
    steps = np.stack([along[column], out[column]])
    steps = np.where((parity - 1 + column) % 2 == 0, steps, steps[::-1])
    cosine = np.abs((seen.lines[:, found] * steps.conj()).real) / np.abs(steps)
    fits = (cosine >= IN_LINE).all(axis=0) & ~(bends(seen.edges[found]) > STRAIGHT)
    count = int(np.count_nonzero(fits))
    return count >= LEAST_FURTHER and count > MOST_OF * len(known)


def _misfit(seen: tuple[int, ...], shape: tuple[int, int], border: Sides) -> int:
    """Count the rows and columns that exceed the shape, or are missing between two borders."""
    both = border.top and border.bottom, border.left and border.right
    off = 0
    for axis in (0, 1):
        lack = shape[axis] - seen[axis]
        off += lack if lack > 0 and both[axis] else max(-lack, 0)
    return off


def _straight(nodes: Nodes, bend: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (R, C) bool, True at corners with straight boundaries, which junctions do not have."""
    return (nodes.owner >= 0) & ~(bend[nodes.owner] > STRAIGHT)


def _fullest(
    nodes: Nodes, bend: NDArray[np.float32], shape: tuple[int, int]
) -> tuple[int, int, int]:
    """Return weight, first row and first column of the fullest window of that shape.

    The weight of a node decreases with the bend of its corner's boundaries, because those of
    junctions are bent. Of equal windows the one nearest to the top left is taken.
    """
    weight = WHOLE - (WHOLE / 4 * np.where(np.isnan(bend), 1, bend)).astype(np.int64)
    total = np.zeros(np.add(nodes.at.shape, 1), np.int64)
    total[1:, 1:] = np.where(nodes.owner >= 0, weight[nodes.owner], 0).cumsum(0).cumsum(1)
    for axis, (size, seen) in enumerate(zip(shape, nodes.at.shape, strict=True)):
        size = min(size, seen)
        begin = np.arange(seen - size + 1)
        total = total.take(begin + size, axis) - total.take(begin, axis)
    full = np.argwhere(total == total.max())
    top, left = full[np.argmin(full.sum(axis=1))].tolist()
    return int(total.max()), top, left


def _seen_shape(
    nodes: Nodes,
    bend: NDArray[np.float32],
    shape: tuple[int, int],
    start: tuple[int, int],
    border: Sides,
) -> tuple[int, int] | None:
    """Return the shape that the pattern seems to have, None for the given one.

    start: first row and column of the window of that shape.
    """
    straight = _straight(nodes, bend)
    seen = list(shape)
    both = border.top and border.bottom, border.left and border.right
    for axis in (0, 1):
        size, lines = shape[axis], nodes.at.shape[axis]
        if lines <= size:
            if both[axis]:
                seen[axis] = lines
            continue
        count = straight.sum(axis=1 - axis)
        begin, end = start[axis], start[axis] + size
        before = _full(count[: begin + 1][::-1], float(np.median(count)))
        after = _full(count[end - 1 :], float(np.median(count)))
        seen[axis] += int(np.count_nonzero(before) + np.count_nonzero(after))
    return None if tuple(seen) == tuple(shape) else (seen[0], seen[1])


def _full(count: Index, usual: float) -> Mask:
    """Return a mask of the lines beyond the window that belong to the pattern, from it outward.

    count: the straight corners of the window's last line and of each line beyond. usual: the median
        of all lines. A line belongs to the pattern if it holds half of the usual number, or half as
        many as the line before it: where a pattern is partly hidden, or out of view, its lines get
        shorter one by one.
    """
    before = np.maximum(count[:-1], LEAST_LINE)
    full: Mask = 2 * count[1:] >= np.maximum(np.minimum(usual, before), 1)
    return full
