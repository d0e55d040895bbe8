"""Finds a lattice that leaves out every other corner: these lie in the middle of its cells.

Where cells are blurred and seen at a grazing angle, a corner's next but one neighbours may fit
better than its neighbours. The lattice of every other corner is consistent, and its colours are
too. But in a checkerboard no corner lies in the middle of a cell, except on marks in it.
"""

import numpy as np

from cmp_cl.grid.grow import nearest_pairs
from cmp_cl.grid.nodes import Nodes, Points

MIDDLE = 0.15  # cells: how far from the middle of a cell
MOST = 0.75  # share of the cells that may have a corner there; marks lie in half of the cells
LEAST = 6  # cells


def skips_corners(nodes: Nodes, z: Points) -> bool:
    """Return whether most cells have a corner in the middle that is no node.

    z: (N,), all corners, px.
    """
    owned = nodes.owner >= 0
    others = len(z) - np.count_nonzero(owned)
    if others <= MOST * LEAST:
        return False
    at = nodes.at
    left, right = at[:-1, :-1] + at[1:, :-1], at[:-1, 1:] + at[1:, 1:]
    whole = ~np.isnan(left.real + right.real)
    left, right, cells = left[whole], right[whole], np.count_nonzero(whole)
    if cells < LEAST or others <= MOST * cells:
        return False
    middle, along = (left + right) / 4, (right - left) / 2
    down = (at[1:, :-1] + at[1:, 1:] - at[:-1, :-1] - at[:-1, 1:])[whole] / 2
    other = np.delete(z, nodes.owner[owned])
    cell, corner = nearest_pairs(middle, other, MIDDLE * (np.abs(along) + np.abs(down)))
    off, along, down = other[corner] - middle[cell], along[cell], down[cell]
    area = (along.conj() * down).imag
    column, row = (off.conj() * down).imag / area, (along.conj() * off).imag / area
    return bool(np.count_nonzero(np.hypot(column, row) < MIDDLE) > MOST * cells)
