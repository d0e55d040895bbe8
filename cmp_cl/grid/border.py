"""Where a pattern ends in the view."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.evidence import grey
from cmp_cl.grid.grid import Sides
from cmp_cl.grid.nodes import Nodes, Points
from cmp_cl.image import GreyImage

BEYOND = 1.5  # cells from the last nodes: the middle of the cells that a longer pattern has there
FLAT = 0.3  # of the contrast of the cells before: below it those beyond are no cells
SHARE = 0.5  # of the lines that must end at the side, and be seen beyond it


def border(nodes: Nodes, image: GreyImage) -> Sides:
    """The sides on which nodes end in the picture, and what lies beyond is no cell."""
    at, left = nodes.at, nodes.at.T
    return Sides(
        top=_ends(at, image),
        bottom=_ends(at[::-1], image),
        left=_ends(left, image),
        right=_ends(left[::-1], image),
    )


def _ends(at: Points, image: GreyImage) -> bool:
    """Whether the pattern ends before the first row of nodes, (R, C) px."""
    if at.shape[0] < 2 or at.shape[1] < 2:
        return False
    seen = ~np.isnan(at.real)
    whole = seen[0, 1:] & seen[0, :-1] & seen[1, 1:] & seen[1, :-1]
    column = np.flatnonzero(whole)
    if len(column) < max(SHARE * (np.count_nonzero(seen.any(axis=0)) - 1), 1):
        return False
    first, second = (at[row, column] + at[row, column + 1] for row in (0, 1))
    out = (first - second) / 2
    middle = first / 2
    along = at[0, column + 1] - at[0, column]
    beyond, inside = middle + BEYOND * out, middle - out / 2
    # the corners of the squares that are looked at must be in the picture
    far = middle + (BEYOND + 0.25) * out
    columns, rows = image.shape[1] - 1, image.shape[0] - 1
    shown = (far.real >= 0) & (far.real <= columns) & (far.imag >= 0) & (far.imag <= rows)
    if np.count_nonzero(shown) < max(SHARE * len(column), 1):
        return False
    sign = 1 - 2 * (column[shown] % 2)

    def contrast(where: Points) -> float:
        """How much brighter the even cells are than the odd ones."""
        spots = where[shown][:, None] + np.array([-0.15, 0, 0.15]) * along[shown][:, None]
        level = grey(image, spots).mean(axis=1)
        even, odd = level[sign > 0], level[sign < 0]
        if not (len(even) and len(odd)):
            return float("nan")
        return float(np.mean(even) - np.mean(odd))

    return abs(contrast(beyond)) < FLAT * abs(contrast(inside))


def full_lines(there: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First and last row, first and last column that hold a fair part of the nodes of a line.

    there: (R, C), where nodes are; at least one.
    """
    ends: list[int] = []
    for axis in (1, 0):
        count = there.sum(axis=axis)
        full = np.flatnonzero(count >= max(np.median(count) / 4, 1))
        ends += [int(full[0]), int(full[-1])]
    return ends[0], ends[1], ends[2], ends[3]
