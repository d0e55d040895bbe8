"""Cuts a lattice at a joint, where it runs on from one pattern into another.

A cell that closes by chance can link a board to squares behind it, or two parts of a torn
pattern by wrong numbers. The steps tell: on one pattern they change little from one cell to the
next, and where it is bent they go on changing as they did. So neighbouring cells whose steps agree
belong together. What is linked to them only through cells that do not agree is another lattice.

The steps of a cell across a torn ring may agree all the same. There the image decides, together
with the place of what lies inside the ring.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.detached import distance_from_place
from cmp_cl.grid.lattice import Index, Lattice, Mask
from cmp_cl.grid.links import nodes_of, shown_parts
from cmp_cl.grid.nodes import NOWHERE, Nodes, upright
from cmp_cl.image import GreyImage

Steps = NDArray[np.complex64]

ALIKE = 0.25  # of the steps: largest difference between two cells of one pattern
BENT = 0.3  # of the steps: largest difference of their change from the ones before and after
PAIRS = 3  # of cells, which show that there is a bend between two parts
LEAST = 4  # cells that may be another pattern
OTHER_PLACE = 0.7  # cells: half of the shortest step that changes no colours
NEIGHBOURS = (0, 1), (1, -1), (1, 0), (1, 1)  # the other four are their opposites


def cut(found: Lattice, nodes: Nodes, component: int = 0) -> Lattice | None:
    """Return the lattice with that component cut into its parts, None where it is one.

    nodes: the component in its box, untouched. Corners in no large part belong to no component.
    """
    along, down = _steps(nodes)
    beside, below = _agreements(along, down)
    cell = ~np.isnan(along.real + down.real)
    if (beside.all() and below.all()) or _hang_together(beside, below, cell):
        return None
    cells = _whole_cells(along, down)
    part = _parts(cells)
    large = _large(part)
    if len(large) < 2:
        return None
    part_of = np.full(cell.shape, -1)
    part_of[cells.row, cells.column] = part
    return _relabelled(found, nodes, component, [nodes_of(part_of == k, 1) for k in large])


def cut_by_image(
    found: Lattice, nodes: Nodes, image: GreyImage | None, component: int = 0
) -> Lattice | None:
    """Return the lattice with parts of that component cut off, None where it is one.

    These parts lie elsewhere than the nodes around them say, and no cell that the image shows links
    them to the largest part.

    nodes: the component, grown. image: (H, W); without it nothing is cut off.
    """
    if image is None or nodes.there.all() or _is_smooth(nodes):
        return None
    parts = shown_parts(nodes, image)
    if len(parts) < 2:
        return None
    off = [0.0, *(distance_from_place(nodes.at, p & ~parts[0], parts[0]) for p in parts[1:])]
    right = [part for part, cells in zip(parts, off, strict=True) if cells <= OTHER_PLACE]
    wrong = [part for part, cells in zip(parts, off, strict=True) if cells > OTHER_PLACE]
    return _relabelled(found, nodes, component, [np.any(right, axis=0), *wrong]) if wrong else None


def _is_smooth(nodes: Nodes) -> bool:
    """Return whether all neighbouring cells agree."""
    along, down = _steps(nodes)
    beside, below = _agreements(along, down)
    size = along.real + down.real
    beside |= np.isnan(size[:, 1:] + size[:, :-1])
    below |= np.isnan(size[1:] + size[:-1])
    return bool(beside.all() and below.all())


def _steps(nodes: Nodes) -> tuple[Steps, Steps]:
    """Return twice the steps of each cell, (R - 1, C - 1), along its rows and its columns."""
    lines = nodes.at.astype(np.complex64)
    along, down = lines[:, 1:] - lines[:, :-1], lines[1:] - lines[:-1]
    return along[1:] + along[:-1], down[:, 1:] + down[:, :-1]


def _large(part: Index) -> Index:
    """Return the parts of at least LEAST cells, the largest first."""
    size = np.bincount(part)
    large = np.flatnonzero(size >= LEAST)
    return large[np.argsort(-size[large], kind="stable")]


def _agreements(along: Steps, down: Steps) -> tuple[Mask, Mask]:
    """Return which cells agree with the next one of their row, and of their column."""
    size = _square(along) + _square(down)
    least = ALIKE**2 * size
    apart = _square(along[:, 1:] - along[:, :-1]) + _square(down[:, 1:] - down[:, :-1])
    beside = apart < np.minimum(least[:, 1:], least[:, :-1])
    apart = _square(along[1:] - along[:-1]) + _square(down[1:] - down[:-1])
    below = apart < np.minimum(least[1:], least[:-1])
    return beside, below


def _hang_together(beside: Mask, below: Mask, cell: Mask) -> bool:
    """Return whether all but a few cells form one part, joined by neighbours that agree."""
    rows, columns = cell.shape
    shown = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)  # cells, and what joins them
    shown[::2, ::2] = cell
    shown[::2, 1::2], shown[1::2, ::2] = beside, below
    count, label = cv2.connectedComponents(shown, connectivity=4)
    if count < 3:
        return True
    sizes = np.bincount(label[::2, ::2].ravel())[1:]
    return bool(np.count_nonzero(sizes >= LEAST) < 2)


def _square(step: Steps) -> NDArray[np.float32]:
    return np.abs(step) ** 2


class _Cells(NamedTuple):
    """Whole cells, (K,): row, column and steps, and the number of each place."""

    row: Index
    column: Index
    along: Steps
    down: Steps
    number: Index

    def beside(self, cell: Index | slice, r: int, c: int) -> Index:
        """Return the numbers of the cells r rows and c columns away, -1 where there is none."""
        beside: Index = self.number[self.row[cell] + r + 1, self.column[cell] + c + 1]
        return beside

    def size(self) -> NDArray[np.float32]:
        return _square(self.along) + _square(self.down)


def _whole_cells(along: Steps, down: Steps) -> _Cells:
    """Return the cells; along, down: twice the steps of each place."""
    row, column = np.nonzero(~np.isnan(along.real + down.real))
    number = np.full(np.add(along.shape, 2), -1)
    number[row + 1, column + 1] = np.arange(len(row))
    return _Cells(row, column, along[row, column] / 2, down[row, column] / 2, number)


def _parts(cells: _Cells) -> Index:
    """Return the part of each cell, numbered by one of its cells.

    Neighbours that agree belong to one part, and so do cells before and after a bend.
    """
    size = cells.size()
    pairs = []
    for r, c in NEIGHBOURS:
        other = cells.beside(slice(None), r, c)
        one = np.flatnonzero(other >= 0)
        other = other[one]
        along, down = cells.along[[one, other]], cells.down[[one, other]]
        least = np.minimum(size[one], size[other])
        apart = _square(along[1] - along[0]) + _square(down[1] - down[0])
        agree = apart < ALIKE**2 * least
        pairs.append(np.stack([one[agree], other[agree]]))
    part = _components(len(size), np.concatenate(pairs, axis=1))
    bent = np.concatenate([_bends(cells, part, r, c) for r, c in ((0, 1), (1, 0))], axis=1)
    return part if not bent.size else _components(len(size), bent, part)


def _bends(cells: _Cells, part: Index, r: int, c: int) -> Index:
    """Return the pairs of parts, (2, P), that are one pattern with a bend between them.

    The steps change from one cell to the next by more than ALIKE, but as much before and after.
    """
    other = cells.beside(slice(None), r, c)
    one = np.flatnonzero((other >= 0) & (part != part[other]))
    other = other[one]
    before, after = cells.beside(one, -r, -c), cells.beside(other, r, c)
    known = np.stack([before >= 0, after >= 0])
    off = np.zeros(len(one), np.float32)
    for step in (cells.along, cells.down):
        change = np.stack([step[one] - step[before], step[after] - step[other]])
        usual = np.where(known, change, 0).sum(0) / np.maximum(known.sum(0), 1)
        off += _square(step[other] - step[one] - usual)
    size = cells.size()
    bent = off < BENT**2 * np.minimum(size[one], size[other])
    low, high = np.minimum(part[one], part[other]), np.maximum(part[one], part[other])
    touching, pair = np.unique(low * len(part) + high, return_inverse=True)
    joined = touching[np.bincount(pair, bent) >= PAIRS]
    return np.stack(np.divmod(joined, len(part)))


def _components(count: int, pairs: Index, lowest: Index | None = None) -> Index:
    """Return the lowest number of all that pairs, (2, P), join to each of `count` items."""
    lowest = np.arange(count) if lowest is None else lowest
    while True:
        one, other = lowest[pairs]
        if (one == other).all():
            return lowest
        np.minimum.at(lowest, np.maximum(one, other), np.minimum(one, other))
        while (lowest[lowest] != lowest).any():
            lowest = lowest[lowest]


def _relabelled(found: Lattice, nodes: Nodes, component: int, parts: list[Mask]) -> Lattice | None:
    """Return the lattice with the corners of each part, (R, C) nodes, as a component of its own.

    A corner of two parts goes to the first. None if the first part holds all corners.
    """
    label = found.component.copy()
    free: Mask = (nodes.owner >= 0) & (label[nodes.owner] == component)
    label[label == component] = -1
    unit = upright(complex(found.axis[component]))
    sizes, axes = [], []
    for number, part in enumerate(parts):
        mine = part & free
        free &= ~mine
        if not number and not free.any():
            return None
        label[nodes.owner[mine]] = len(found.size) + number
        sizes.append(np.count_nonzero(mine))
        step = np.diff(np.where(part, nodes.at, NOWHERE), axis=0 if unit.imag else 1)
        axes.append(step[~np.isnan(step)].mean() * (unit.real + unit.imag))
    size = np.concatenate([found.size, sizes])
    size[component] = 0
    order = np.argsort(-size, kind="stable")[: np.count_nonzero(size)]
    rank = np.full(len(size) + 1, -1)  # the last is that of corners in no component
    rank[order] = np.arange(len(order))
    return found._replace(
        component=rank[label],
        size=size[order],
        axis=np.concatenate([found.axis, axes])[order],
    )
