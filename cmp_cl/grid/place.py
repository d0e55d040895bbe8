"""Which numbers a grid has: those of a known shape, of the rest grid, or of the frame before."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.border import Ends, full_lines
from cmp_cl.grid.grid import Grid, Rival, Sides
from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Nodes, Points, check_room

WHOLE = 1024  # weight of a corner with straight boundaries
STRAIGHT = 0.5  # largest bend of a corner that is no junction with the surround
VOTERS = 384  # nodes that are compared with the reference
STILL = 0.125  # cells: a pattern without a border that moved less as a whole has its numbers
STILL_EACH, STILL_SHARE = 0.06, 0.33  # or this share of the nodes has moved less than so many
HALF = 0.5  # cells: displacements above it count less and less
UNMATCHED = 0.5  # cost of a node without a counterpart in the reference
LEAST_COMMON = 0.25  # share of the nodes that must have a counterpart in the reference
FOLLOWED = 0.5  # cells: the same from one frame to the next
TURNED = np.deg2rad(30)  # from here on the next quarter turn is compared too
UNSURE = np.deg2rad(40)  # a pattern that turned so far may have turned the other way
NEIGHBOURS = np.array(
    [(0, 0), *((r, c) for r in range(-2, 3) for c in range(-2, 3) if abs(r) + abs(c) == 2)]
)
FAR = 1 << 30  # rows or columns: no bound


class Placed(NamedTuple):
    """A grid with its numbers, and what speaks against them, as in `Grid`.

    quarters: by how many it was turned.
    """

    nodes: Nodes
    origin: tuple[int, int] = (0, 0)
    ambiguous: bool = False
    rival: Rival | None = None
    margin: float = float("nan")
    quarters: int = 0
    continues: Sides = Sides()
    seen_shape: tuple[int, int] | None = None


# a known shape


def in_shape(nodes: Nodes, bend: NDArray[np.float32], shape: tuple[int, int], ends: Ends) -> Placed:
    """The nodes in a grid of that shape.

    A shape that fits better across is taken so, by the quarter turn that leaves the columns
    nearest to the image's x axis. Where less is seen, the borders in view say which part it
    is. Where more is seen, it is the fullest window, nearest to the top left.

    bend: of every corner.
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
    likely = [place for place, off in enumerate(misfit) if off == min(misfit)]
    windows = [_fullest(turned[place], bend, shape) for place in likely]
    fullest = int(np.argmax([weight for weight, _, _ in windows]))
    best = likely[fullest]
    _, top, left = windows[fullest]
    found, (border, cut) = turned[best], sides[best]
    starts, unsure = [top, left], len(likely) > 1
    for axis in (0, 1):
        lack = shape[axis] - found.at.shape[axis]
        if lack > 0:
            begin, end = border[2 * axis], border[2 * axis + 1]
            no_begin, no_end = cut[2 * axis], cut[2 * axis + 1]
            starts[axis] = -lack if end and not begin else 0
            unsure |= not ((begin and end) or (begin and no_end) or (no_begin and end))
    seen, continues = _seen_shape(found, bend, shape, (top, left), border)
    placed = found.window(starts[0], starts[1], shape)
    return Placed(
        placed, ambiguous=unsure, quarters=turns[best], continues=continues, seen_shape=seen
    )


def _misfit(seen: tuple[int, ...], shape: tuple[int, int], border: Sides) -> int:
    """How many lines are seen too many, or are missing between two borders."""
    both = border.top and border.bottom, border.left and border.right
    off = 0
    for axis in (0, 1):
        lack = shape[axis] - seen[axis]
        off += lack if lack > 0 and both[axis] else max(-lack, 0)
    return off


def _straight(nodes: Nodes, bend: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(R, C), corners whose boundaries are straight, as at no junction with the surround."""
    return (nodes.owner >= 0) & ~(bend[nodes.owner] > STRAIGHT)


def _fullest(
    nodes: Nodes, bend: NDArray[np.float32], shape: tuple[int, int]
) -> tuple[int, int, int]:
    """Weight, first row and first column of the fullest window of that shape, or all there is.

    A node weighs less the less the corner's boundaries are straight, as they are not where the
    outermost cells meet the surroundings. Of several it is the nearest to the top left.
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
) -> tuple[tuple[int, int] | None, Sides]:
    """The shape that the pattern seems to have, None where that is the given one; where it goes on.

    start: first row and column of the window of that shape. Lines beyond it count that hold
    half as many straight corners as lines usually do.
    """
    straight = _straight(nodes, bend)
    seen, goes_on = list(shape), []
    both = border.top and border.bottom, border.left and border.right
    for axis in (0, 1):
        size, lines = shape[axis], nodes.at.shape[axis]
        if lines <= size:
            goes_on += [False, False]
            if both[axis]:
                seen[axis] = lines
            continue
        count = straight.sum(axis=1 - axis)
        full = 2 * count >= max(np.median(count), 1)
        before, after = full[: start[axis]], full[start[axis] + size :]
        goes_on += [bool(before.any()), bool(after.any())]
        seen[axis] += int(np.count_nonzero(before) + np.count_nonzero(after))
    told = None if tuple(seen) == tuple(shape) else (seen[0], seen[1])
    return told, Sides(*goes_on)


# the rest grid


class Reference(NamedTuple):
    """A grid that others are compared with.

    at: (R, C), px, NaN where missing; known: (R, C), where it is not; parity, origin: as in
    `Grid`; along: mean step to the next column, px; cell: mean side, px.
    """

    at: Points
    known: Mask
    parity: int
    origin: tuple[int, int]
    shape: tuple[int, int]
    along: complex
    cell: float

    @classmethod
    def of(cls, grid: Grid) -> "Reference":
        at = grid.xy[..., 0] + 1j * grid.xy[..., 1].astype(np.float64)
        return cls.at_places(at, grid.parity, grid.origin)

    @classmethod
    def at_places(cls, at: Points, parity: int, origin: tuple[int, int]) -> "Reference":
        """Of positions by row and column."""
        along, down = _mean_step(at), _mean_step(at.T)
        known = [abs(step) for step in (along, down) if step]
        return cls(
            at=at,
            known=~np.isnan(at.real),
            parity=parity,
            origin=origin,
            shape=(at.shape[0], at.shape[1]),
            along=along or -1j * down,
            cell=float(np.mean(known)) if known else 1.0,
        )


def _mean_step(at: Points) -> complex:
    """The mean step from a column to the next; 0 where there is none."""
    step = at[:, 1:] - at[:, :-1]
    known = step[~np.isnan(step.real)]
    return complex(known.mean()) if len(known) else 0j


class Bounds(NamedTuple):
    """The numbers that the first row and the first column can have, both ends included."""

    top: int = -FAR
    last_top: int = FAR
    left: int = -FAR
    last_left: int = FAR

    @property
    def empty(self) -> bool:
        return self.top > self.last_top or self.left > self.last_left

    def hold(self, top: Index, left: Index) -> Mask:
        return (
            (top >= self.top)
            & (top <= self.last_top)
            & (left >= self.left)
            & (left <= self.last_left)
        )


class Choice(NamedTuple):
    """A numbering: quarter turns, then the number of the first row and column.

    cost: grows with the displacement from the reference, see `_costs`, infinite where too few
    nodes can be compared. rms: the RMS displacement, cells.
    """

    cost: float
    rms: float
    quarters: int
    top: int
    left: int


class Decision(NamedTuple):
    """The best numbering, the second best, whether the best is sure, and that by borders."""

    best: Choice
    second: Choice | None
    sure: bool
    bordered: bool = False


def like_rest(nodes: Nodes, border: Sides, like: Grid, previous: Grid | None) -> Placed:
    """The nodes with the numbers of the rest grid.

    border: the sides on which the pattern ends in the view. previous: the frame before, with
    the numbers of the rest grid, or None.

    The borders of the pattern say which numbers are possible, the checker colours leave every
    other one, and of these it is the one with the least displacement. It is sure where no other
    is possible, or where the pattern as a whole is where it was at rest. The frame before
    decides where the rest grid does not, as long as the pattern as a whole moves by less than
    half a cell from frame to frame; if the two disagree, the numbers are not sure.
    """
    same = (nodes.at.shape, nodes.parity) == (like.shape, like.parity)
    whole = same and all(border) and all(like.border)
    if whole and quarter_turns(nodes.at, Reference.of(like))[0][0] == 0:
        return Placed(nodes, origin=like.origin)
    decided = _decision(nodes, border, like, like, STILL)
    if previous is not None:
        followed = _decision(nodes, border, like, previous, FOLLOWED)
        agree = followed.best[2:] == decided.best[2:]
        if not decided.sure:
            decided = followed
        elif followed.sure and not agree:
            first, other = (decided, followed) if decided.bordered else (followed, decided)
            decided = first._replace(second=other.best, sure=False)
    return _placed(nodes, like, decided)


def _decision(nodes: Nodes, border: Sides, like: Grid, reference: Grid, limit: float) -> Decision:
    """Which numbers are nearest to the reference.

    limit: cells by which the pattern as a whole may have moved and still be sure.
    """
    near = Reference.of(reference)
    turns = quarter_turns(nodes.at, near)
    found: list[Choice] = []
    for quarters, _ in turns:
        found += _search(nodes, border, like, near, quarters)
    forced = bool(found)
    if not found:  # lines are lost as if there were a border, or there are false ones
        for quarters, _ in turns:
            found += _search(nodes, Sides(), like, near, quarters)
    if not found:
        quarters = turns[0][0]
        found = climb(nodes.turned(quarters), near, Bounds(), quarters)
    best, *others = sorted(found)
    second = others[0] if others else None
    if turns[0][1] < UNSURE and is_still(nodes, near, best, limit):
        return Decision(best, second, True)
    if second is not None or not forced:
        return Decision(best, second, False)
    if any(border):  # not if they all lie in their places as soon as some lines may be lost
        free = [each for turn, _ in turns for each in _search(nodes, Sides(), like, near, turn)]
        other = min(free)
        if other[2:] != best[2:] and is_still(nodes, near, other, limit):
            return Decision(best, other, False)
    return Decision(best, None, True, bordered=True)


def quarter_turns(at: Points, reference: Reference) -> list[tuple[int, float]]:
    """The quarter turns that leave rows most parallel to the reference's, and the angles, rad.

    The second is there if it is nearly as good as the first.
    """
    along, down = _mean_step(at), _mean_step(at.T)
    along = along or -1j * down
    down = down or 1j * along
    ways = (along, down, -along, -down)
    angles = [abs(float(np.angle(way / reference.along))) for way in ways]
    order = np.argsort(angles, kind="stable")
    kept = order[: 2 if angles[order[0]] > TURNED else 1]
    return [(int(turn), angles[turn]) for turn in kept]


def _lines(grid: Grid) -> tuple[int, int, int, int]:
    """The numbers of the first and last row, first and last column with a fair part of nodes."""
    top, bottom, left, right = full_lines(grid.valid)
    row, column = grid.origin
    return top + row, bottom + row, left + column, right + column


def _search(
    nodes: Nodes, border: Sides, like: Grid, near: Reference, quarters: int
) -> list[Choice]:
    """The numbers with the least displacement and those around, of those that borders leave.

    What lies beyond a border of the rest grid is none of its nodes, and nodes that end at a
    border of the pattern end where the rest grid does.
    """
    turned, border = nodes.turned(quarters), border.turned(quarters)
    here, rest = full_lines(turned.there), _lines(like)
    ends = like.border if any(like.border) else _known_ends(like, nodes.at)
    rows = _axis_bounds(here[:2], rest[:2], ends[:2], border[:2])
    columns = _axis_bounds(here[2:], rest[2:], ends[2:], border[2:])
    return climb(turned, near, Bounds(*rows, *columns), quarters)


def _axis_bounds(
    here: tuple[int, ...],
    rest: tuple[int, ...],
    rest_ends: tuple[bool, ...],
    ends: tuple[bool, ...],
) -> tuple[int, int]:
    """The numbers that line 0 of the nodes can have on one axis.

    here, rest: the first and the last line, of the nodes and at rest.
    """
    to_first, to_last = rest[0] - here[0], rest[1] - here[1]
    low = [to_first] * rest_ends[0] + [to_last] * ends[1]
    high = [to_last] * rest_ends[1] + [to_first] * ends[0]
    return max(low, default=-FAR), min(high, default=FAR)


def _known_ends(like: Grid, at: Points) -> Sides:
    """Where the rest grid ends within what the nodes show of the picture.

    For rest grids that were built without their image, which do not know their borders.
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


def _voters(nodes: Nodes) -> tuple[Index, Index, Points]:
    """Rows, columns and positions of some nodes all over the grid."""
    places = np.flatnonzero(nodes.there)
    some = np.linspace(0, len(places) - 1, min(VOTERS, len(places))).astype(np.int64)
    row, column = np.divmod(places[some], nodes.at.shape[1])
    return row, column, nodes.at[row, column]


def climb(nodes: Nodes, near: Reference, bounds: Bounds, quarters: int) -> list[Choice]:
    """The numbers of the right colour with the least displacement and those around them.

    Empty where no number is within the bounds.
    """
    row, column, at = _voters(nodes)
    middle = int(np.argmin(np.abs(at - at.mean())))
    away = np.abs(near.at - at[middle])
    place = int(np.nanargmin(away))
    first_row, first_column = np.divmod(place, near.shape[1])
    start: Index = np.array([first_row - row[middle], first_column - column[middle]])
    start = start + np.array(near.origin)
    start = np.clip(start, (bounds.top, bounds.left), (bounds.last_top, bounds.last_left))
    start = start + np.array([(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)])
    sums = start.sum(axis=1) - sum(near.origin) + near.parity - nodes.parity
    start = start[(sums % 2 == 0) & bounds.hold(start[:, 0], start[:, 1])]
    if not len(start):
        return []
    here = start[0]
    while True:
        around = here + NEIGHBOURS
        around = around[bounds.hold(around[:, 0], around[:, 1])]
        cost, rms = _costs(near, around, row, column, at)
        best = int(np.argmin(cost))
        if (around[best] == here).all() or not np.isfinite(cost[best]):
            break
        here = around[best]
    return [
        Choice(float(each), float(off), quarters, int(top), int(left))
        for each, off, (top, left) in zip(cost, rms, around, strict=True)
        if np.isfinite(each) or len(around) == 1
    ]


def _displacement(
    near: Reference, first: NDArray[np.int64], row: Index, column: Index, at: Points
) -> Points:
    """From the reference's nodes, (S, M) px, for each number (S, 2) of row 0 and column 0."""
    rows = row + (first[:, :1] - near.origin[0])
    columns = column + (first[:, 1:] - near.origin[1])
    inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
    there = near.at[np.where(inside, rows, 0), np.where(inside, columns, 0)]
    return np.where(inside, at - there, NOWHERE)


def _costs(
    near: Reference, first: NDArray[np.int64], row: Index, column: Index, at: Points
) -> tuple[Float, Float]:
    """The mean of log(1 + (d / HALF)^2) over displacements d, and their RMS, cells, (S,).

    Most of a pressed gel stays near its place, whatever the rest does: so the logarithm. Nodes
    without a counterpart add a little to the cost, and it is infinite where few have one.
    """
    away = np.abs(_displacement(near, first, row, column, at))
    known = ~np.isnan(away)
    count = known.sum(axis=1)
    away[~known] = 0
    squares = (away / near.cell) ** 2
    cost = np.log1p(squares / HALF**2).sum(axis=1) / np.maximum(count, 1)
    cost += UNMATCHED * (1 - count / len(at))
    cost[count < max(LEAST_COMMON * len(at), 1)] = np.inf
    return cost, np.sqrt(squares.sum(axis=1) / np.maximum(count, 1))


def is_still(nodes: Nodes, near: Reference, choice: Choice, limit: float) -> bool:
    """Whether the pattern as a whole is where the reference has it, by those numbers.

    So it is if the middle of the view has not moved, by the affine motion that most nodes
    follow, or if many nodes have not moved at all.
    """
    row, column, at = _voters(nodes.turned(choice.quarters))
    moved = _displacement(near, np.array([[choice.top, choice.left]]), row, column, at)[0]
    known = ~np.isnan(moved.real)
    moved, at = moved[known] / near.cell, at[known]
    if len(moved) < 4:
        return False
    if np.count_nonzero(np.abs(moved) < STILL_EACH) >= STILL_SHARE * len(moved):
        return True
    box = at.real.min() + at.real.max(), at.imag.min() + at.imag.max()
    middle = complex(box[0], box[1]) / 2
    from_middle = at - middle
    model = np.stack([np.ones(len(at)), from_middle / near.cell, from_middle.conj() / near.cell])
    weight = np.ones(len(at))
    for _ in range(3):
        weighted = model.conj() * weight
        motion = np.linalg.lstsq(weighted @ model.T, weighted @ moved, rcond=None)[0]
        off = np.abs(moved - motion @ model)
        weight = np.where(off <= max(2.5 * float(np.median(off)), 1e-3), 1.0, 0.0)
    return bool(abs(motion[0]) <= limit)


def _placed(nodes: Nodes, like: Grid, decided: Decision) -> Placed:
    """The nodes on the rest grid's rows and columns, and on those beyond where it is open."""
    best, second, sure, _ = decided
    turned = nodes.turned(best.quarters)
    first, shape = [], []
    ends = (like.border[:2], like.border[2:])
    for axis, start in enumerate((best.top, best.left)):
        low, high = like.origin[axis], like.origin[axis] + like.shape[axis]
        before, after = start, start + turned.at.shape[axis]
        first.append(low if ends[axis][0] else min(low, before))
        shape.append((high if ends[axis][1] else max(high, after)) - first[-1])
    check_room((shape[0], shape[1]), len(nodes.free) + like.status.size)
    top, left = first[0] - best.top, first[1] - best.left
    rival = None
    margin = float("nan")
    if second is not None:
        margin = second.rms - best.rms
        turn = (second.quarters - best.quarters) % 4
        rows, columns = turned.at.shape
        skipped = (  # from the first node of the turned grid to that of the turned nodes
            (-top, -left),
            (shape[1] + left - columns, -top),
            (shape[0] + top - rows, shape[1] + left - columns),
            (-left, shape[0] + top - rows),
        )[turn]
        origin = second.top - skipped[0], second.left - skipped[1]
        rival = Rival(origin[0] - first[0], origin[1] - first[1], turn)
    return Placed(
        turned.window(top, left, (shape[0], shape[1])),
        origin=(first[0], first[1]),
        ambiguous=not sure,
        rival=rival,
        margin=margin,
        quarters=best.quarters,
    )
