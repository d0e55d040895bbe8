"""What corners and their distances add to what the image shows at the sides of a board."""

import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.lattice.arrays import Board, Border, Mask, Numbers, Whole
from cmp_cl.lattice.constants import LatticeConstants

K = LatticeConstants()


def with_further_lines(board: Board, corners: Corners, inside: Whole) -> tuple[Border, int]:
    """Return the border of a board, and the number of corners on the lines that follow.

    inside: (M,), the corners that may belong to the board.

    The steps of a tilted board grow from line to line, so its squares reach as far as the next step
    would. A line of corners past a side follows, though no sides of cells link it. A line that
    is farther away, behind a bar, is counted alone: it may be another board's.
    """
    border, owner, at = board.border, board.owner, board.at
    free = np.zeros(len(corners), np.bool_)
    free[inside] = True
    free[owner[owner >= 0]] = False
    places = np.array(owner.shape)[[1, 1, 0, 0]]
    growth, (found, behind) = np.ones(4), np.zeros((2, 4), np.int64)
    from_side = [(each, each[::-1], each.T, each.T[::-1]) for each in (owner, at)]
    for side, (owners, positions) in enumerate(zip(*from_side, strict=True)):
        if border.ends[side]:
            growth[side] = _growth(positions)
        if len(owners) > 1 and free.any():
            nearest, *others = (_further(owners, corners, free, n) for n in range(1, K.span))
            found[side] = 0 if border.ends[side] else nearest
            behind[side] = max(others)
    follows, far = (counts >= K.least_line * places for counts in (found, behind))
    changed = Border(
        border.reach / growth, border.past, border.follows | follows, border.room & ~follows
    )
    return changed, int(np.maximum(found * follows, behind * far).sum())


def _growth(places: Numbers) -> float:
    """Return by which factor the step between the first two lines exceeds the one after it."""
    steps = np.abs(places[:-1][:2] - places[1:][:2])
    known = ~np.isnan(steps).any(axis=0)
    if len(steps) < 2 or not known.any():
        return 1.0
    first, second = steps[:, known].sum(axis=1)
    return float(first / second)


def _further(lines: Whole, corners: Corners, free: Mask, steps: int) -> int:
    """Return how many places of a line that lies so many steps before the first have a free corner.

    It lies within a quarter of a step of where the first two lines lead, and such a way could join
    it: boundaries point from both ends to each other, of unlike colours if the steps
    are odd.
    """
    first, second = lines[:2, (lines[:2] >= 0).all(axis=0)]
    at: Numbers = corners.xy @ np.array([1, 1j])
    chord, step = at[free] - at[first, None], at[first] - at[second]
    place, new = np.nonzero(np.abs(chord - steps * step[:, None]) < np.abs(step[:, None]) / 4)
    way = chord[place, new, None] / np.abs(chord[place, new, None])
    here = (np.exp(1j * corners.edges[first[place]]) / way).real
    there = (-np.exp(1j * corners.edges[free][new]) / way).real
    linked = np.minimum(here.max(axis=1), there.max(axis=1)) > K.least_cosine
    linked &= (here.argmax(axis=1) + there.argmax(axis=1) + steps) % 2 == 0
    return len(np.unique(place[linked]))
