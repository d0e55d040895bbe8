"""Islands get their numbers here: groups of nodes that no neighbour links to the others."""

import numpy as np

from cmp_cl.grid.grid import Grid
from cmp_cl.grid.grow import Seen, attach, drop_misfits, grow
from cmp_cl.grid.lattice import Lattice
from cmp_cl.grid.nearest import Bounds, Reference, climb, quarter_turns
from cmp_cl.grid.nodes import Nodes, Points, boxed

LEAST = 9  # fewest corners of an island
OFF = 0.25  # cells: largest distance of an island's middle from its prediction
TURNED = 0.25  # of the steps: how much its own may differ from those expected
MOST = 16  # islands that are tried


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
    model = np.stack([np.ones(place.shape), place, place.conj()], axis=-1)
    motion, _, rank, _ = np.linalg.lstsq(model[known], nodes.at[known], rcond=None)
    expected: Points = model @ motion
    return expected if rank == 3 else None


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
