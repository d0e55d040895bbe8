"""How much the surface bends across tears; on the host."""

import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Units, Votes, Whole
from cmp_cl.lattice.constants import LatticeConstants

TURNS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for.
SHIFTS = np.array([0, 1 + 1j, 1 - 1j, 2, -2, 2j, -2j, -1 + 1j, -1 - 1j])
TREND = 6  # terms of a quadratic
ROUNDING = 1e-9  # cells^2, of the energy of a flat surface, which is 0
HELD = 1e-7  # of squared terms, in the energy, so that those which nodes leave open are 0
RIM = 128  # nodes, of a rim, to which distances are taken


def bending(units: Units, asked: Votes, k: LatticeConstants) -> Float:
    """Return the bending energy of the map from numbers to positions, cells^2, near the tear at
    each placement, for each shift of it, (T, 9); infinite where it is not defined.

    units: the nodes, part after part.
    """
    energy = np.full((len(asked.first), len(SHIFTS)), np.inf)
    bounds = np.searchsorted(units.part, np.arange(len(units.faces) + 1))
    at, number = units.at, units.number
    for n, (first, second, quarter, offset, _) in enumerate(zip(*asked, strict=True)):
        one, two = (np.arange(*bounds[part : part + 2]) for part in (first, second))
        cell = _cell(number[two], at[two])
        one, two = _beside(units, one, two, (k.span + 1) / 2 * cell, k.tear_most)
        if len(one) >= TREND and len(two) >= TREND // 2:
            moved = number[two] * TURNS[quarter] + offset
            energy[n] = _energies(number[one], at[one] / cell, moved, at[two] / cell)
    return energy


def _beside(units: Units, one: Whole, two: Whole, reach: float, most: int) -> tuple[Whole, Whole]:
    """Return nodes of two parts near the tear: less than three lines, which a quadratic needs,
    farther from the other's rim than the nearest one. A corner of both is of the smaller part,
    `two`."""
    at, rim = units.at, units.rim
    for line in (at.real, at.imag):  # nodes with votes are less than two reaches apart
        low, high = line[two].min() - 3 * reach, line[two].max() + 3 * reach
        one = one[(line[one] > low) & (line[one] < high)]
    one = one[_are_near(at[one], at[_some(two[rim[two]], at, RIM)], reach)]
    two = two[_are_near(at[two], at[_some(one[rim[one]], at, RIM)], reach)]
    return _some(one, at, most), _some(two, at, most)


def _some(nodes: Whole, at: Numbers, most: int) -> Whole:
    """Return nodes; if there are more, so many of them, evenly from left to right."""
    if len(nodes) <= most:
        return nodes
    nodes = nodes[np.argsort(at[nodes].real, kind="stable")]
    return nodes[np.arange(most) * len(nodes) // most]


def _are_near(at: Numbers, others: Numbers, reach: float) -> Mask:
    """Return which nodes are less than `reach` farther from the others than the nearest one."""
    each, other = (nodes.astype(np.complex64) for nodes in (at, others))
    x, y = (np.subtract.outer(*line) for line in ((each.real, other.real), (each.imag, other.imag)))
    away = np.sqrt((x * x + y * y).min(axis=1, initial=np.inf))
    away[away == 0] = np.inf  # a corner of both parts
    near: Mask = away < away.min(initial=np.inf) + reach
    return near


def _cell(number: Numbers, at: Numbers) -> float:
    """Return the length of a step of nodes, px, by a linear fit; 0 without one."""
    number = number - number.mean()
    square = np.vdot(number, number).real
    return float(np.abs(np.vdot(number, at)) / square) if square > 0 else 0.0


def _energies(first: Numbers, x: Numbers, second: Numbers, y: Numbers) -> Float:
    """Return the energies for each shift of the second side; first, second: numbers; x, y:
    positions, cells.

    Cubic radial functions with a quadratic trend: M [w; c] = [x; 0], energy x' w, with
    M = [K + 1, B; B', 0]. The first side and the trend are eliminated once; the energy is theirs,
    and that of what they leave of the second side. In place of 0 stands -HELD I, since the first
    side may leave the trend open.
    """
    origin, middle, count = first.mean(), y.mean(), len(first)
    first, second = first - origin, second - origin
    x_pairs, y_pairs = (_as_pairs(at - middle) for at in (x, y))
    system = np.zeros((count + TREND, count + TREND))
    system[:count, :count] = _cubes(first, first) + np.eye(count)
    system[:count, count:] = _trend(first)
    system[count:, :count] = system[:count, count:].T
    system[count:, count:] = -HELD * np.eye(TREND)
    inverse = np.linalg.inv(system)
    flat = inverse[:, :count] @ x_pairs
    shifted = SHIFTS[:, None] + second
    terms = np.concatenate([_cubes(shifted, first), _trend(shifted)], axis=2)
    rest = y_pairs - terms @ flat
    own = _cubes(second, second) + np.eye(len(second))
    w = np.linalg.solve(own - terms @ inverse @ terms.transpose(0, 2, 1), rest)
    energy = (x_pairs * flat[:count]).sum() + (rest * w).sum(axis=(1, 2))
    bends: Float = np.where(energy > -ROUNDING, np.maximum(energy, ROUNDING), np.inf)
    return bends


def _as_pairs(values: Numbers) -> Float:
    """Return complex numbers as real ones, (N, 2)."""
    return values.view(np.float64).reshape(-1, 2)


def _trend(number: Numbers) -> Float:
    """Return the terms of a quadratic at each number, (..., N, TREND)."""
    x, y = number.real, number.imag
    return np.stack([np.ones(x.shape), x, y, x * x, y * y, x * y], axis=-1)


def _cubes(a: Numbers, b: Numbers) -> Float:
    """Return the cubed distances of all pairs, (..., A, B)."""
    x, y = (one[..., None] - two[..., None, :] for one, two in ((a.real, b.real), (a.imag, b.imag)))
    x *= x
    y *= y
    x += y
    x *= np.sqrt(x)
    return x
