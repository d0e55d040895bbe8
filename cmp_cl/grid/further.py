"""What corners and their distances add to what the image shows at the sides of a board."""

import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.lattice.arrays import Board, Border, Mask, Whole
from cmp_cl.lattice.constants import LatticeConstants

K = LatticeConstants()


def with_further_lines(board: Board, corners: Corners, inside: Whole) -> tuple[Border, int]:
    """Return the border of a board, and the number of corners on the lines that follow.

    inside: (M,), the corners that may belong to the board.

    The steps of a tilted board grow from line to line, so its squares reach as far as the next step
    would; what reaches farther is not the last of them, and then where further lines would be is
    not known. A line of corners past a side follows, though no sides of cells link it. A line that
    is farther away, behind a bar, is counted alone: it may be another board's.
    """
    border, owner = board.border, board.owner.astype(np.int64)
    is_free = np.zeros(len(corners), np.bool_)
    is_free[inside] = True
    is_free[owner[owner >= 0]] = False
    free = np.flatnonzero(is_free)
    places = np.array(owner.shape)[[1, 1, 0, 0]]
    growth, (found, behind) = np.ones(4), np.zeros((2, 4), np.int64)
    ends = border.ends
    for side, owners in enumerate((owner, owner[::-1], owner.T, owner.T[::-1])):
        if ends[side]:
            growth[side] = _growth(owners, corners)
        if len(owners) > 1 and len(free) >= K.least_line * places[side]:
            near = free[_are_past(owners, corners, free)]
            if len(near) < K.least_line * places[side]:
                continue
            nearest, *others = (_further(owners, corners, near, n) for n in range(1, K.span))
            found[side] = 0 if ends[side] else nearest
            behind[side] = max(others)
    follows, far = (counts >= K.least_line * places for counts in (found, behind))
    reach = border.reach / growth
    longer = reach > 1 + K.border_step_cells
    room = border.room & ~(follows | longer.any())
    changed = Border(np.where(longer, np.nan, reach), border.past, border.follows | follows, room)
    return changed, int(np.maximum(found * follows, behind * far).sum())


def _growth(lines: Whole, corners: Corners) -> float:
    """Return by which factor the step between the first two lines exceeds the one after it."""
    known = (lines[:3] >= 0).all(axis=0)
    if len(lines) < 3 or not known.any():
        return 1.0
    at = corners.xy[lines[:3, known]].astype(np.float64)
    first, second = np.hypot(*(at[:2] - at[1:]).transpose(2, 0, 1)).sum(axis=1)
    return float(first / second)


def _are_past(lines: Whole, corners: Corners, free: Whole) -> Mask:
    """Return which free corners lie in the upright rectangle around the places past a side."""
    first, second = corners.xy[lines[:2, (lines[:2] >= 0).all(axis=0)]]
    xy, step = corners.xy[free], first - second
    places = np.concatenate([first, first + K.span * step])
    if not len(places):
        return np.zeros(len(free), np.bool_)
    beside = np.abs(step).max() / 2
    near = (xy > places.min(axis=0) - beside) & (xy < places.max(axis=0) + beside)
    return np.asarray(near.all(axis=1))


def _further(lines: Whole, corners: Corners, free: Whole, steps: int) -> int:
    """Return how many places of a line that lies so many steps before the first have a free corner.

    It lies within a quarter of a step of where the first two lines lead, and such a way could join
    it: boundaries point from both ends to each other, of unlike colours if the steps are odd.
    """
    first, second = lines[:2, (lines[:2] >= 0).all(axis=0)]
    at, other, new = (corners.xy[each] @ np.array([1, 1j]) for each in (first, second, free))
    chord, step = new - at[:, None], at - other
    place, there = np.nonzero(np.abs(chord - steps * step[:, None]) < np.abs(step[:, None]) / 4)
    way = chord[place, there, None] / np.abs(chord[place, there, None])
    one = (np.exp(1j * corners.edges[first[place]]) / way).real
    two = (-np.exp(1j * corners.edges[free[there]]) / way).real
    linked = np.minimum(one.max(axis=1), two.max(axis=1)) > K.least_cosine
    linked &= (one.argmax(axis=1) + two.argmax(axis=1) + steps) % 2 == 0
    return len(np.unique(place[linked]))
