"""Tests the links of a lattice against the image: a side of a cell is an edge between colours.

Across a torn ring a cell can close by chance between nodes that are no neighbours. Everything
inside the ring then hangs on it with wrong numbers, and fits together. But between two nodes that
are no neighbours there is no edge with the colours of their numbers.
"""

import cv2
import numpy as np

from cmp_cl.grid.evidence import grey
from cmp_cl.grid.nodes import Float, Mask, Nodes, Points
from cmp_cl.image import GreyImage

ALONG = np.array([0.25, 0.375, 0.5, 0.625, 0.75])  # of a side: where the levels are compared
ACROSS = 0.2  # of a side: how far from it
SHOWN = 0.45  # share of the usual difference of the levels
LEAST = 16  # blocks of 2 x 2 cells, which 6 x 6 nodes have: the place of fewer is not known well


def shown_parts(nodes: Nodes, image: GreyImage) -> list[Mask]:
    """Return masks of the nodes, (R, C), of the larger parts that the image shows, the largest
    first.

    It shows a cell if each of the four sides has the colours of its number. Blocks of 2 x 2 such
    cells with two cells in common are one part. Nodes in no block belong to none.
    """
    odd = (nodes.parity + np.add.outer(*map(np.arange, nodes.at.shape))) % 2
    sign = 1 - 2 * odd
    along = _differences(nodes.at, image) * sign[:, :-1]
    down = _differences(nodes.at.T, image).T * -sign[:-1]
    least = SHOWN * np.nanmedian(np.concatenate([along.ravel(), down.ravel()]))
    along, down = along > least, down > least
    cell = along[:-1] & along[1:] & down[:, :-1] & down[:, 1:]
    block = cell[:-1, :-1] & cell[:-1, 1:] & cell[1:, :-1] & cell[1:, 1:]
    if not block.size:
        return []
    _, part, stats, _ = cv2.connectedComponentsWithStats(block.view(np.uint8), connectivity=4)
    size = stats[:, cv2.CC_STAT_AREA]
    size[0] = 0  # of what is in no part
    order = np.argsort(-size, kind="stable")
    return [nodes_of(part == k, 2) for k in order[: np.count_nonzero(size >= LEAST)]]


def nodes_of(block: Mask, cells: int) -> Mask:
    """Return a mask of the nodes, (R, C), of blocks of so many cells each way, (R - cells, C -
    cells)."""
    rows, columns = block.shape
    nodes = np.zeros((rows + cells, columns + cells), np.bool_)
    for r in range(cells + 1):
        for c in range(cells + 1):
            nodes[r : r + rows, c : c + columns] |= block
    return nodes


def _differences(at: Points, image: GreyImage) -> Float:
    """Return the mean level before less that after the sides along the rows, (R, C - 1)."""
    step = at[:, 1:] - at[:, :-1]
    known: Mask = ~np.isnan(step.real)
    start, step = at[:, :-1][known], step[known]
    points = start + ALONG[:, None] * step
    off = 1j * ACROSS * step
    difference = np.full(known.shape, np.nan)
    difference[known] = (grey(image, points - off) - grey(image, points + off)).mean(axis=0)
    return difference
