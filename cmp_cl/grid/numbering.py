"""A grid gets the numbers of the grid at rest here.

A checkerboard repeats itself, so a frame has many numberings: four quarter turns, and all shifts by
whole cells that keep the colours. Four things decide between them, in this order.

The border. If the pattern ends on the same side at rest and now, its last rows have the same
number, and nothing beyond a border at rest belongs to the pattern. That leaves few numberings,
often one. But the edge of an object that hides the pattern looks like a border too. A side is taken
for such an edge, and decides nothing, if it differs between the frames: in the reach of the last
squares, or in whether its line continues past the pattern. It is also taken for one if its line
continues and the opposite side is no border; if its line continues, or its squares reach less far,
or farther, than at rest, and the line has stood still; or if its last squares are not whole and its
line is not seen to have moved with the pattern. If a side differs, the other sides are sure only of
motions by less than half a cell.

The printing errors, which move with the pattern, see `fingerprint`.

The previous frame, if it is given and its own numbers are sure. They are continued as long as the
pattern as a whole moves by less than half a cell from frame to frame.

The least motion from rest. It shows which numbering is the most likely, but never that it is right:
a pattern without a border that moved by a whole period looks as if it had not moved.

The best numbering is kept with the second best and the difference of their motions. It is sure if
one of the first three decides. Otherwise it is ambiguous, as it is if the previous frame
contradicts a sure numbering by the grid at rest.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmp_cl.grid.border import Border, full_lines
from cmp_cl.grid.fingerprint import Fingerprint, shift_to, turn_to
from cmp_cl.grid.grid import NO_SIDES, Grid, Rival, Sides
from cmp_cl.grid.nearest import (
    FAR,
    Bounds,
    Choice,
    Reference,
    chosen,
    climb,
    colour,
    quarter_turns,
)
from cmp_cl.grid.nodes import Nodes, Points, check_room, median

STILL = 0.125  # cells: a pattern that moved less as a whole has not moved
# Cells: the reach of squares that changed by so much while the edge did not move, and its motion as
# a share of that.
CHANGED, FIXED = 0.06, 0.5
BROKEN = 0.15  # cells: squares at a border that reach so much less, or more, are not whole
FOLLOWED = 0.5  # cells: largest motion of the pattern as a whole from one frame to the next
NO_BORDER = Border()
UNSURE = np.deg2rad(40)  # a pattern that rotated so far may have rotated the other way
UNDECIDED = np.deg2rad(10)  # rotations that differ by less than that are equally likely


class Numbered(NamedTuple):
    """A grid with its numbers, and the reasons to doubt them, as in `Grid`.

    quarters: the number of quarter turns that were applied to it.
    """

    nodes: Nodes
    origin: tuple[int, int] = (0, 0)
    ambiguous: bool = False
    rival: Rival | None = None
    quarters: int = 0
    seen_shape: tuple[int, int] | None = None


class Decision(NamedTuple):
    """The best numbering, the second best, and whether the best is sure.

    usual: whether it is sure only because a pattern usually rotates by less than 45 degrees.
    """

    best: Choice
    second: Choice | None
    sure: bool
    usual: bool = False

    def agrees(self, other: "Decision") -> bool:
        return self.best.number == other.best.number


def like_rest(nodes: Nodes, border: Border, like: Grid, previous: Grid | None) -> Numbered:
    """Return the nodes with the numbers of the grid at rest.

    border: the sides on which the pattern ends in the view. like: the grid at rest. previous: the
        previous frame with the numbers of the grid at rest, or None.
    """
    rest = Reference.of(like)
    turns = quarter_turns(nodes.at, rest, every=True)
    quarters = turns[0][0]
    whole = all(border.sides) and all(like.border or NO_SIDES)
    whole &= not any(_hidden(nodes.turned(quarters), border.turned(quarters), like))
    if whole and nodes.at.shape in (like.shape, like.shape[::-1]):
        decided = _by_turn(nodes, border, like, rest, turns)
    else:
        decided = _by_border(nodes, border, like, rest)
        if not decided.sure or any(border.sides):
            decided = _with_print(nodes, like, rest, decided)
    if previous is not None:
        decided = _with_frame_before(nodes, border, like, previous, decided)
    return _numbered(nodes, border, like, decided)


def _by_turn(
    nodes: Nodes, border: Border, like: Grid, rest: Reference, ordered: Sequence[tuple[int, float]]
) -> Decision:
    """Choose the rotation of a pattern that is seen whole, now and at rest.

    Colours, shape and the reach of the last squares leave one, two or four rotations. Of several
    the printing errors choose one, if they are large enough. Otherwise the smallest is chosen, if
    the next is clearly larger: up to 40 degrees if the pattern looks the same after a quarter turn.

    ordered: all quarter turns.
    """
    top, left = like.origin
    at_rest = Border.of(like)
    fitting = []
    for quarters, angle in ordered:
        alike = nodes.at.shape == (like.shape[::-1] if quarters % 2 else like.shape)
        alike &= (top + left) % 2 == colour(nodes.turned_parity(quarters), rest)
        if alike and not any(border.turned(quarters).contradicts(at_rest)):
            fitting.append((quarters, angle))
    if not fitting:
        return _by_border(nodes, NO_BORDER, like, rest)
    turns = [quarters for quarters, _ in fitting]
    choices = {quarters: Choice(0.0, 0.0, quarters, top, left) for quarters in turns}
    if len(turns) == 1:
        return Decision(choices[turns[0]], None, sure=True)
    printed = turn_to(Fingerprint.at_rest(like), Fingerprint.of(nodes.at), turns)
    if printed is not None:
        return Decision(choices[printed], None, sure=True)
    usual = fitting[1][1] - fitting[0][1] > UNDECIDED
    second = None if usual else choices[turns[1]]
    return Decision(choices[turns[0]], second, sure=usual, usual=usual)


def _by_border(nodes: Nodes, border: Border, like: Grid, rest: Reference) -> Decision:
    """Choose the nearest of the numberings that borders allow; it is sure if they allow only one.

    Rows that are not detected look like a border. So the numbering is not sure if other numbers
    leave the pattern at its position at rest. If a side contradicts the frame at rest, an object
    hides the pattern, perhaps on other sides too. Then the numbering is sure only if it also moves
    the pattern by less than half a cell.
    """
    turns = quarter_turns(nodes.at, rest)
    if len(turns) == 1 and not any(border.sides):
        turned = nodes.turned(turns[0][0])
        number = _bounds(turned, border, like).only
        if number is not None and sum(number) % 2 == colour(turned.parity, rest):
            return Decision(Choice(0.0, float("nan"), turns[0][0], *number), None, sure=True)
    left = _nearest(nodes, border, like, rest)
    if len(left) == 1 and any(border.sides):
        freely = _nearest(nodes, NO_BORDER, like, rest)
        other = freely[0] if freely else left[0]
        if other.number != left[0].number and other.motion <= STILL:
            return Decision(left[0], other, sure=False)
    if left:
        hidden = any(border.turned(left[0].quarters).contradicts(Border.of(like)))
        sure = len(left) == 1 and not (hidden and left[0].motion > FOLLOWED)
        return Decision(left[0], left[1] if len(left) > 1 else None, sure=sure)
    # rows are missing, or there are false ones
    freely = _nearest(nodes, NO_BORDER, like, rest)
    freely = freely or climb(nodes.turned(turns[0][0]), rest, Bounds(), turns[0][0])
    return Decision(freely[0], freely[1] if len(freely) > 1 else None, sure=False)


def _with_print(nodes: Nodes, like: Grid, rest: Reference, decided: Decision) -> Decision:
    """Choose the numbering under which the printing errors agree, if there is one.

    It is sure unless the border is sure of another: the edge of an object that hides the pattern
    along a row may look like its border.
    """
    at_rest = Fingerprint.at_rest(like)
    turns = [quarters for quarters, _ in quarter_turns(nodes.at, rest, every=True)]
    for quarters in [decided.best.quarters] if decided.sure else turns:
        turned = nodes.turned(quarters)
        shift = shift_to(at_rest, Fingerprint.of(turned.at))
        if shift is None:
            continue
        top, left = shift[0] + like.origin[0], shift[1] + like.origin[1]
        if (top + left) % 2 != colour(turned.parity, rest):
            return decided
        best = chosen(turned, rest, quarters, top, left)
        others = (decided.best, decided.second)
        second = [each for each in others if each is not None and each.number != best.number]
        sure = not decided.sure or best.number == decided.best.number
        return Decision(best, second[0] if second else None, sure=sure)
    return decided


def _with_frame_before(
    nodes: Nodes, border: Border, like: Grid, previous: Grid, decided: Decision
) -> Decision:
    """Compare a numbering with that which continues the previous frame, or replace it if unsure.

    A border on one side of an axis alone may be the edge of an object. So it must not change the
    numbers that continue the previous frame without it.
    """
    followed = freely = _by_frame_before(nodes, border, like, previous)
    both = border.sides.opposed, like.border and like.border.opposed
    if both != (border.sides, like.border):
        at_rest = dataclasses.replace(like, border=both[1])
        freely = _by_frame_before(nodes, border.opposed, at_rest, previous)
    if not decided.sure or (decided.usual and followed.sure):
        decided = followed
    for other in (followed, freely):
        if other.sure and not decided.agrees(other):
            decided = Decision(decided.best, other.best, sure=False)
    return decided


def _by_frame_before(nodes: Nodes, border: Border, like: Grid, previous: Grid) -> Decision:
    """Choose the numbering nearest to the previous frame; it is sure if it moved under half a
    cell."""
    before = Reference.of(previous)
    turns = quarter_turns(nodes.at, before)
    found = _nearest(nodes, border, like, before) or _nearest(nodes, NO_BORDER, like, before)
    found = found or climb(nodes.turned(turns[0][0]), before, Bounds(), turns[0][0])
    best, *others = found
    known = previous is like or not previous.ambiguous
    near = turns[0][1] < UNSURE and best.motion <= FOLLOWED
    return Decision(best, others[0] if others else None, sure=known and near)


def _nearest(nodes: Nodes, border: Border, like: Grid, near: Reference) -> list[Choice]:
    """Return the numberings that borders allow around the nearest to a reference, nearest first."""
    found: list[Choice] = []
    for quarters, _ in quarter_turns(nodes.at, near):
        turned = nodes.turned(quarters)
        bounds = _bounds(turned, border.turned(quarters), like)
        found += climb(turned, near, bounds, quarters)
    return sorted(found)


def _bounds(nodes: Nodes, border: Border, like: Grid) -> Bounds:
    """Return the numbers that borders allow for the first row and column.

    No node lies beyond a border of the grid at rest, and nodes that end at a border of the pattern
    end at that border of the grid at rest. A side that is the edge of an object in front of the
    pattern, now or at rest, is no border.
    """
    here, rest = full_lines(nodes.there), _lines(like)
    at_rest = _known_ends(like, nodes.at) if like.border is None else like.border
    hidden = _hidden(nodes, border, like)
    ends = [end and not other for end, other in zip(at_rest, hidden, strict=True)]
    now = [end and not other for end, other in zip(border.sides, hidden, strict=True)]
    rows = _axis_bounds(here[:2], rest[:2], ends[:2], now[:2])
    columns = _axis_bounds(here[2:], rest[2:], ends[2:], now[2:])
    return Bounds(*rows, *columns)


def _hidden(nodes: Nodes, border: Border, like: Grid) -> Sides:
    """Return the sides that are the edge of an object in front of the pattern, now or at rest."""
    rest = Border.of(like)
    doubts = border.contradicts(rest), border.lone, rest.lone, _unmoved(nodes, border, like)
    return Sides(*(any(side) for side in zip(*doubts, strict=True)))


def _unmoved(nodes: Nodes, border: Border, like: Grid) -> Sides:
    """Return the sides that may be the edge of an object that stands still.

    Their line has not moved, although their last squares reach farther than at rest, or less far,
    or it continues past the pattern. Or these squares are not whole, and their line is not seen at
    one position at rest and at another now.
    """
    at_rest = Border.of(like)
    unmoved = []
    for side in range(4):
        reaches = border.reach[side], like.reach[side]
        broken = any(abs(reach - 1) > BROKEN for reach in reaches)
        passing = border.passing[side] or at_rest.passing[side]
        changed = abs(reaches[0] - reaches[1])
        if not (broken or passing or changed >= CHANGED):
            unmoved.append(False)
            continue
        rest = Reference.of(like)
        now, before = _edge(nodes.at, reaches[0], side), _edge(rest.at, reaches[1], side)
        moved = _beside(now, before) / rest.cell if len(now) and len(before) else math.nan
        fixed = changed >= CHANGED and moved <= FIXED * changed
        still = passing and moved <= STILL
        unmoved.append(fixed or still or (broken and not moved > STILL))
    return Sides(*unmoved)


def _edge(at: Points, reach: float, side: int) -> Points:
    """Return the points at which the last squares of a side end, px."""
    lines = (at, at[::-1], at.T, at.T[::-1])[side]
    edge = lines[0] + reach * (lines[0] - lines[1]) if len(lines) > 1 else lines[:0].ravel()
    return edge[~np.isnan(edge.real)]


def _beside(points: Points, others: Points) -> float:
    """Return the median distance of points from the straight line through others, px."""
    middle = others.mean()
    along = np.sqrt(np.sum((others - middle) ** 2))
    return median(np.abs(((points - middle) * along.conj()).imag)) / max(float(abs(along)), 1e-6)


def _lines(grid: Grid) -> tuple[int, int, int, int]:
    """Return the first and last row, first and last column with a fair share of the nodes."""
    top, bottom, left, right = full_lines(grid.valid)
    row, column = grid.origin
    return top + row, bottom + row, left + column, right + column


def _axis_bounds(
    here: tuple[int, ...],
    rest: tuple[int, ...],
    rest_ends: Sequence[bool],
    ends: Sequence[bool],
) -> tuple[int, int]:
    """Return the numbers that row 0, or column 0, of the nodes can have.

    here, rest: the first and the last line, of the nodes and at rest.
    """
    to_first, to_last = rest[0] - here[0], rest[1] - here[1]
    low = [to_first] * rest_ends[0] + [to_last] * ends[1]
    high = [to_last] * rest_ends[1] + [to_first] * ends[0]
    return max(low, default=-FAR), min(high, default=FAR)


def _known_ends(like: Grid, at: Points) -> Sides:
    """Return the sides on which the grid at rest ends inside the part of the image with nodes.

    It is for grids at rest that were built without their image, so that their borders are unknown.
    """
    rest = like.xy[..., 0] + 1j * like.xy[..., 1].astype(np.float64)
    every = np.concatenate([rest.ravel(), at.ravel()])
    every = every[~np.isnan(every.real)]
    low = complex(every.real.min(), every.imag.min())
    high = complex(every.real.max(), every.imag.max())

    def ends(at: Points) -> bool:
        first = 2 * at[0] - at[1] if len(at) > 1 else at[0]
        first = first[~np.isnan(first.real)]
        inside = (first.real > low.real) & (first.real < high.real)
        inside &= (first.imag > low.imag) & (first.imag < high.imag)
        return len(first) > 0 and 2 * int(np.count_nonzero(inside)) > len(first)

    return Sides(ends(rest), ends(rest[::-1]), ends(rest.T), ends(rest.T[::-1]))


def _numbered(nodes: Nodes, border: Border, like: Grid, decided: Decision) -> Numbered:
    """Return the nodes on the rows and columns at rest, and on those beyond an open side."""
    best, second, sure, _ = decided
    turned = nodes.turned(best.quarters)
    first, shape = [], []
    known: Sequence[bool] = like.border or NO_SIDES
    if (best.top, best.left, *turned.at.shape) != (*like.origin, *like.shape):
        hidden = _hidden(turned, border.turned(best.quarters), like)
        known = [end and not other for end, other in zip(known, hidden, strict=True)]
    ends = (known[:2], known[2:])
    for axis, start in enumerate((best.top, best.left)):
        low, high = like.origin[axis], like.origin[axis] + like.shape[axis]
        before, after = start, start + turned.at.shape[axis]
        first.append(low if ends[axis][0] else min(low, before))
        shape.append((high if ends[axis][1] else max(high, after)) - first[-1])
    check_room((shape[0], shape[1]), len(nodes.free) + like.status.size)
    top, left = first[0] - best.top, first[1] - best.left
    rival = None
    if second is not None:
        turn = (second.quarters - best.quarters) % 4
        rows, columns = turned.at.shape
        skipped = (  # steps from the first entry of the turned grid to that of the turned nodes
            (-top, -left),
            (shape[1] + left - columns, -top),
            (shape[0] + top - rows, shape[1] + left - columns),
            (-left, shape[0] + top - rows),
        )[turn]
        origin = second.top - skipped[0], second.left - skipped[1]
        rival = Rival(origin[0] - first[0], origin[1] - first[1], turn)
    return Numbered(
        turned.window(top, left, (shape[0], shape[1])),
        origin=(first[0], first[1]),
        ambiguous=not sure,
        rival=rival,
        quarters=best.quarters,
    )
