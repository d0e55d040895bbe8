"""Islands get their numbers here: groups of nodes that no neighbour links to the others."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid.grid import NO_SIDES, Grid, Sides
from cmp_cl.grid.grow import Seen, attach, drop_misfits, grow
from cmp_cl.grid.lattice import Complex, Lattice
from cmp_cl.grid.nearest import Bounds, Reference, climb, quarter_turns
from cmp_cl.grid.nodes import Nodes, Points, boxed

LEAST = 9  # fewest corners of an island
OFF = 0.25  # cells: largest distance of an island's middle from its prediction
TURNED = 0.25  # of the steps: how much its own may differ from those expected
MOST = 16  # islands that are tried
LINES = 6  # the last ones of a side predict what lies beyond it
BEYOND = 12  # lines: corners farther from the last nodes are not predicted
IN_LINE = 0.85  # least cosine between a corner's edges and the lattice's steps


def join_islands(nodes: Nodes, found: Lattice, seen: Seen, rest: Grid | None) -> None:
    """Put the islands whose numbers are certain into the grid.

    rest: the grid at rest on the rows and columns of the nodes, or None. With it, an island is
    expected where the grid at rest has it after the affine motion of the other nodes. Without
    it, an island is expected where the rows and columns of the other nodes meet, and these must
    lie on all sides of it. An island is left out if its middle is more than a quarter of a cell
    from there, or if its steps differ by more than a quarter from those expected.
    """
    count = int(np.count_nonzero(found.size >= LEAST))
    joined = False
    for component in range(1, min(count, MOST)):
        free = (found.component == component) & nodes.free
        if 2 * np.count_nonzero(free) < found.size[component]:
            continue
        island = boxed(seen.z, found, component)
        island.free &= nodes.free & (found.component < 0)
        grow(island, seen)
        if island.there.any() and np.greater_equal(nodes.at.shape, island.at.shape).all():
            joined |= _join(nodes, island, rest)
    if joined:
        drop_misfits(nodes)
        attach(nodes, seen)


def continued(nodes: Nodes, found: Lattice, seen: Seen) -> Sides:
    """Return the sides beyond which islands continue the rows, columns and colours of the nodes.

    There the pattern does not end: an object hides a part of it.
    """
    island = nodes.free & (found.component >= 0)
    island &= found.component < np.count_nonzero(found.size >= LEAST)
    if np.count_nonzero(island) < LEAST:
        return NO_SIDES
    z, lines = seen.z[island], seen.lines[:, island]
    return Sides(*(_continued(*way, z, lines) for way in nodes.from_sides()))


def _continued(at: Points, parity: int, z: Points, lines: Complex) -> bool:
    """Return whether corners beyond the first row of nodes, (R, C) px, continue them.

    parity: the edges e0 and e2 of a corner lie along the row if parity + row + column is even. z,
    lines: of the corners, as in `Seen`.
    """
    last = at[:LINES]
    row, column = np.nonzero(~np.isnan(last.real))
    motion = _affine(column + 1j * row, last[row, column])
    if motion is None:
        return False
    start, same, mirrored = motion
    off = z - start
    place = (np.conj(same) * off - mirrored * off.conj()) / (abs(same) ** 2 - abs(mirrored) ** 2)
    beyond = (place.imag < -1) & (place.imag > -BEYOND)
    beyond &= (place.real > -0.5) & (place.real < at.shape[1] - 0.5)
    number = np.rint(place[beyond].real) + 1j * np.rint(place[beyond].imag)
    steps = np.array([[same + mirrored], [1j * (same - mirrored)]])
    along_row = (parity + number.real + number.imag) % 2 == 0
    steps = np.where(along_row, steps, steps[::-1])
    cosine = np.abs((lines[:, beyond] * steps.conj()).real) / np.abs(steps)
    fits = (np.abs(place[beyond] - number) <= OFF) & (cosine >= IN_LINE).all(axis=0)
    count = int(np.count_nonzero(fits))
    return count >= LEAST and 2 * count >= len(fits)


def _join(nodes: Nodes, island: Nodes, rest: Grid | None) -> bool:
    """Put an island into the grid; return whether its numbers are certain."""
    places = _expected(nodes, rest)
    if places is None:
        return False
    expected = Reference.at_places(places, nodes.parity, (0, 0))
    quarters, _ = quarter_turns(island.at, expected)[0]
    turned = island.turned(quarters)
    (rows, columns), (high, wide) = nodes.at.shape, turned.at.shape
    inside = 1 if rest is None else 0
    bounds = Bounds(inside, rows - high - inside, inside, columns - wide - inside)
    choices = climb(turned, expected, bounds, quarters)
    if not choices or choices[0].motion > OFF:
        return False
    *_, top, left = choices[0]
    row, column = np.nonzero(turned.there)
    here = row + top, column + left
    if nodes.there[here].any() or (rest is None and not _surrounded(nodes, *here)):
        return False
    if not _same_steps(turned.at, places[top : top + high, left : left + wide]):
        return False
    nodes.put(*here, turned.at[row, column], turned.status[row, column])
    owner = turned.owner[row, column]
    nodes.owner[here] = owner
    nodes.free[owner[owner >= 0]] = False
    nodes.astray |= island.astray
    return True


def _expected(nodes: Nodes, rest: Grid | None) -> Points | None:
    """Predict nodes by an affine map of their index, or of their position at rest, (R, C).

    None if the nodes do not determine the map: fewer than three, or all on a line.
    """
    place: Points
    if rest is None:
        row, column = np.indices(nodes.at.shape)
        place = np.asarray(column + 1j * row)
    else:
        place = rest.xy[..., 0] + 1j * rest.xy[..., 1].astype(np.float64)
    known = nodes.there & ~np.isnan(place.real)
    motion = _affine(place[known], nodes.at[known])
    return None if motion is None else _basis(place) @ motion


def _affine(place: Points, at: Points) -> NDArray[Any] | None:
    """Return a, b, c of at = a + b place + c conj(place); None if places do not determine them."""
    motion, _, rank, _ = np.linalg.lstsq(_basis(place), at, rcond=None)
    return motion if rank == 3 else None


def _basis(place: Points) -> Points:
    return np.stack([np.ones(place.shape), place, place.conj()], axis=-1)


def _same_steps(at: Points, places: Points) -> bool:
    """Return whether the mean steps of nodes are nearly those of their expected positions."""
    off, size = 0.0, 0.0
    for axis in (0, 1):
        step, expected = np.diff(at, axis=axis), np.diff(places, axis=axis)
        known = ~np.isnan(step.real + expected.real)
        if not known.any():
            return False
        step, expected = step[known].mean(), expected[known].mean()
        off, size = off + abs(step - expected) ** 2, size + abs(expected) ** 2
    return bool(off <= TURNED**2 * size)


def _surrounded(nodes: Nodes, row: np.ndarray, column: np.ndarray) -> bool:
    """Return whether most of the indices lie between nodes, on their row and column."""
    sides = []
    for axis in (0, 1):
        before = np.logical_or.accumulate(nodes.there, axis)[row, column]
        after = np.flip(np.logical_or.accumulate(np.flip(nodes.there, axis), axis), axis)
        sides += [before, after[row, column]]
    return all(float(side.mean()) > 0.5 for side in sides)
