"""Drops parts of a lattice that nothing links to the rest any more and whose numbers are wrong."""

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.nodes import Mask, Nodes, Points

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
        if distance_from_place(nodes.at, part == number, part == 0) > _OFF:
            nodes.drop(*np.nonzero(part == number))
    nodes.crop()


def distance_from_place(at: Points, part: Mask, others: Mask) -> float:
    """Return the distance, cells, of a part of the nodes from where the others around say it lies.

    at: (R, C), px. part, others: (R, C) bool. 0 if there are too few others around.
    """
    row, column = np.nonzero(part)
    near = others.copy()
    near[: max(row.min() - _AROUND, 0)] = near[row.max() + _AROUND + 1 :] = False
    near[:, : max(column.min() - _AROUND, 0)] = near[:, column.max() + _AROUND + 1 :] = False
    if np.count_nonzero(near) < _LEAST:
        return 0.0
    model = np.column_stack([np.ones(np.count_nonzero(near)), *np.nonzero(near)])
    origin, down, along = np.linalg.lstsq(model, at[near], rcond=None)[0]
    off = at[row, column] - (origin + down * row + along * column)
    return float(abs(off.mean()) / max(abs(down), abs(along)))


def components(there: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Label the nodes connected by steps along rows and columns, the largest part first: (R, C).

    there: (R, C) bool, True at a node. The label of an entry without a node is -1.
    """
    if not there.size or there.all():
        return np.zeros(there.shape, np.int32)
    count, label = cv2.connectedComponents(there.astype(np.uint8), connectivity=4)
    size = np.bincount(label.ravel(), minlength=count)
    size[0] = -1  # no node
    rank = np.empty(count, np.int32)
    rank[np.argsort(-size, kind="stable")] = np.arange(count)
    rank[0] = -1
    ranks: NDArray[np.int32] = rank[label]
    return ranks
