"""Drops parts of a lattice that nothing links to the rest any more and whose numbers are wrong."""

import numpy as np

from cmp_cl.grid.grid import components
from cmp_cl.grid.nodes import Nodes

_AROUND = 4  # rows and columns around a part whose nodes say where it should lie
_LEAST = 6  # nodes there
_OFF = 0.5  # cells: a part farther from there has wrong numbers


def drop_detached(nodes: Nodes) -> None:
    """Drop small parts of the nodes that lie elsewhere than the nodes around them say.

    A cell that closes by chance, across something that hides the pattern, can link a part with
    wrong numbers. When the nodes of that cell are dropped as misfits, no link to the part is left.
    """
    there = nodes.there
    if there.all() or not there.any():
        return
    part = components(there)
    for number in range(1, int(part.max()) + 1):
        row, column = np.nonzero(part == number)
        near = part == 0
        near[: max(row.min() - _AROUND, 0)] = near[row.max() + _AROUND + 1 :] = False
        near[:, : max(column.min() - _AROUND, 0)] = near[:, column.max() + _AROUND + 1 :] = False
        if np.count_nonzero(near) < _LEAST:
            continue
        model = np.column_stack([np.ones(np.count_nonzero(near)), *np.nonzero(near)])
        origin, down, along = np.linalg.lstsq(model, nodes.at[near], rcond=None)[0]
        off = nodes.at[row, column] - (origin + down * row + along * column)
        if abs(off.mean()) > _OFF * max(abs(down), abs(along)):
            nodes.drop(row, column)
    nodes.crop()
