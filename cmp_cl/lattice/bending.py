"""How much the surface bends across tears, of many tears at once; on the host."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Units, Votes, Whole
from cmp_cl.lattice.constants import LatticeConstants

TURNS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for, in diagonal steps
# away from the first side: counts across a tear are too short, so such a step often bends less.
SHIFTS = np.array([0, 1, 1j, -1j, -1, 1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j])
IN_TURN = np.s_[:2], np.s_[2:]  # of them; at most tears the first ones decide
TREND = 6  # terms of a quadratic
ROUNDING = 1e-9  # cells^2, of the energy of a flat surface, which is 0
HELD = 1e-7  # of squared terms, in the energy, so that those which nodes leave open are 0
NOWHERE = 1e30  # cells^2, the variance of a node that is not there
SEEN = 512  # tears whose nodes are looked for at once
SOLVED = 16_000  # pairs of nodes of tears whose systems are solved at once, beside eight tears
RIM = 128  # nodes, of a rim, to which distances are taken
PAIRS = 1 << 15  # of nodes whose distances are taken at once, in the processor's cache


def _in_turns(some: Whole, most: int) -> Iterator[Whole]:
    """Yield so many of them at a time."""
    return (some[start : start + most] for start in range(0, len(some), most))


class _Sides(NamedTuple):
    """Nodes on one side of each tear, (T, N): positions, px, numbers at the placement, and which
    there are, the first ones."""

    at: Numbers
    number: Numbers
    there: Mask

    @property
    def nodes(self) -> Whole:
        """Return their numbers, (T,)."""
        nodes: Whole = self.there.sum(axis=1)
        return nodes

    @property
    def variance(self) -> Float:
        """Return the matrices of the nodes' variances, cells^2, (T, N, N)."""
        return np.eye(self.there.shape[1]) * np.where(self.there, 1, NOWHERE)[:, None]

    def chosen(self, some: Whole) -> "_Sides":
        """Return the sides of some tears."""
        most = int(self.nodes[some].max())
        return _Sides._make(each[some, :most] for each in self)

    def mean(self, values: Numbers) -> Numbers:
        """Return the mean of values of the nodes, (T, 1)."""
        mean: Numbers = np.sum(values, axis=1, where=self.there) / self.nodes
        return mean[:, None]


class Surface:
    """The nodes of parts, from left to right in each, their rims, and the size of a cell, px."""

    def __init__(self, units: Units) -> None:
        self.units = units = units.chosen(np.lexsort((units.at.real, units.part)))
        part, parts = units.part, len(units.faces)
        rim = np.flatnonzero(units.rim)
        self.rim = rim[_are_left(part[rim], RIM)]
        self.bounds, self.rims = (
            np.searchsorted(each, np.arange(parts + 1)) for each in (part, part[self.rim])
        )
        self.low, self.high = np.full(parts, np.inf), np.full(parts, -np.inf)
        np.minimum.at(self.low, part, units.at.imag)
        np.maximum.at(self.high, part, units.at.imag)
        self.left = units.at.real.min(initial=np.inf)
        self.wide = units.at.real.max(initial=-np.inf) - self.left + 1
        self.key = part * self.wide + units.at.real - self.left  # they ascend
        self.cell = _cells(units)

    def bending(self, asked: Votes, least: Float, k: LatticeConstants) -> Float:
        """Return the bending energy of the map from numbers to positions, cells^2, near the tear at
        each placement, for each shift of it, (T, 9); infinite where it is not defined.

        least: (T,), times that the energy of a shift must exceed that of the placement. If the
        first shift's does not, the others are infinite.
        """
        energy = np.full((len(asked.first), len(SHIFTS)), np.inf)
        size = np.diff(self.bounds)[asked.second]
        for some in _in_turns(np.argsort(size, kind="stable"), SEEN):
            one, two = self._beside(asked.chosen(some), k)
            known = np.flatnonzero((one.nodes >= TREND) & (two.nodes >= TREND // 2))
            nodes = one.nodes + two.nodes
            known = known[np.argsort(-nodes[known], kind="stable")]
            while len(known):  # the first ones have most nodes
                count = 8 + SOLVED // int(nodes[known[0]]) ** 2
                each, known = known[:count], known[count:]
                tears, sides = some[each], (one.chosen(each), two.chosen(each))
                energy[tears] = _energies(*sides, self.cell[asked.second[tears]], least[tears])
        return energy

    def _beside(self, asked: Votes, k: LatticeConstants) -> tuple[_Sides, _Sides]:
        """Return the nodes of both parts near the tear at each placement: less than three lines,
        which a quadratic needs, farther from the other's rim than the nearest one. A corner of both
        is of the smaller part."""
        at, tears = self.units.at, np.arange(len(asked.first))
        reach = (k.span + 1) / 2 * self.cell[asked.second]
        start, stop, low, high = (
            each[asked.second] for each in (self.bounds, self.bounds[1:], self.low, self.high)
        )
        around = 3 * reach  # nodes with votes are less than two apart
        ends = np.stack([at.real[start] - around, at.real[stop - 1] + around]) - self.left
        ends = asked.first * self.wide + np.clip(ends, 0, self.wide - 0.5)
        tear, one = _spans(*np.searchsorted(self.key, ends))
        y = at.imag[one]
        some = (y > (low - around)[tear]) & (y < (high + around)[tear])
        tear, one = tear[some], one[some]
        rim = self.rims[asked.second], self.rims[asked.second + 1]
        near = _are_near(at[one], tear, at[self.rim], rim, reach)
        tear, one = tear[near], one[near]
        outer = np.flatnonzero(self.units.rim[one])
        outer = outer[_are_left(tear[outer], RIM)]
        rim = np.searchsorted(tear[outer], tears), np.searchsorted(tear[outer], tears, "right")
        own, two = _spans(start, stop)
        near = _are_near(at[two], own, at[one[outer]], rim, reach)
        fixed = self._sides(tear, one, len(tears), k.tear_most)
        moved = self._sides(own[near], two[near], len(tears), k.tear_most)
        turned = moved.number * TURNS[asked.quarter][:, None] + asked.offset[:, None]
        return fixed, moved._replace(number=turned)

    def _sides(self, tear: Whole, node: Whole, tears: int, most: int) -> _Sides:
        """Return nodes tear by tear, at most so many of each."""
        left = _are_left(tear, most)
        tear, node = tear[left], np.append(node[left], 0)
        count = np.bincount(tear, minlength=tears)[:, None]
        place = np.arange(most)
        there = place < count
        some = node[np.where(there, place + count.cumsum()[:, None] - count, -1)]
        return _Sides(self.units.at[some], self.units.number[some], there)


def _are_left(group: Whole, most: int) -> Mask:
    """Return which nodes, that stand group by group, are left if no group has more than so many."""
    count = np.bincount(group)
    place = (np.arange(len(group)) - (count.cumsum() - count)[group]) * most
    count = np.maximum(count, most)[group]
    left: Mask = place // count != (place - most) // count
    return left


def _cells(units: Units) -> Float:
    """Return the length of a step in each part, px, by a linear fit; 0 without one, (P,)."""

    def total(values: Numbers) -> Numbers:
        real, imag = (
            np.bincount(units.part, each, len(units.faces)) for each in (values.real, values.imag)
        )
        total: Numbers = real + 1j * imag
        return total

    count = np.maximum(total(np.ones(len(units.part), np.complex128)), 1)
    number, at = (each - (total(each) / count)[units.part] for each in (units.number, units.at))
    square = total(number * number.conj()).real
    cell: Float = np.abs(total(number.conj() * at)) / np.where(square > 0, square, 1)
    return cell


def _spans(start: Whole, stop: Whole) -> tuple[Whole, Whole]:
    """Return all whole numbers from each start to its stop, and of which start each is."""
    length = stop - start
    which = np.repeat(np.arange(len(length)), length)
    return which, np.arange(len(which)) + (start - length.cumsum() + length)[which]


def _are_near(
    at: Numbers, tear: Whole, others: Numbers, rim: tuple[Whole, Whole], reach: Float
) -> Mask:
    """Return which nodes, that stand tear by tear, are less than `reach` of their tear farther from
    its others than the nearest one. The others of a tear are those from one place to another."""
    start, stop = (each[tear] for each in rim)
    away = np.full(len(at), np.inf, np.float32)
    some = np.flatnonzero(stop > start)
    pairs = (stop - start)[some].cumsum()
    ends = np.searchsorted(pairs, np.arange(PAIRS, pairs[-1:].sum() + 1, PAIRS))
    for block in np.split(some, ends):
        if len(block):
            length = stop[block] - start[block]
            _, other = _spans(start[block], stop[block])
            apart = np.repeat(at[block], length) - others[other]
            square = apart.real**2 + apart.imag**2
            away[block] = np.sqrt(np.minimum.reduceat(square, length.cumsum() - length))
    away[away == 0] = np.inf  # a corner of both parts
    nearest = np.full(len(reach), np.inf, np.float32)
    np.minimum.at(nearest, tear, away)
    near: Mask = away < (nearest + reach.astype(np.float32))[tear]
    return near


def _energies(one: _Sides, two: _Sides, cell: Float, least: Float) -> Float:
    """Return the energies for each shift of the second sides; cell: px, of each tear.

    Cubic radial functions with a quadratic trend: M [w; c] = [x; 0], energy x' w, with
    M = [K + V, B; B', 0]. The first side and the trend are eliminated once; the energy is theirs,
    and that of what they leave of the second side. V is 1 for a node, and without end for one that
    is not there. In place of 0 stands -HELD I, since the first side may leave the trend open.
    """
    tears, most = one.at.shape
    origin, middle = one.mean(one.number), two.mean(two.at)
    first, second = one.number - origin, two.number - origin
    away = two.mean(second)
    shifts = SHIFTS * (np.copysign(1, away.real) + 1j * np.copysign(1, away.imag))
    x, y = (_as_pairs((side.at - middle) / cell[:, None]) for side in (one, two))
    system = np.zeros((tears, most + TREND, most + TREND))
    system[:, :most, :most] = _cubes(first, first) + one.variance
    system[:, :most, most:] = _trend(first)
    system[:, most:, :most] = system[:, :most, most:].transpose(0, 2, 1)
    system[:, most:, most:] = -HELD * np.eye(TREND)
    inverse = np.linalg.inv(system)
    flat = inverse[:, :, :most] @ x
    known = (x * flat[:, :most]).sum(axis=(1, 2))[:, None]
    own = (_cubes(second, second) + two.variance)[:, None]
    energy, left = np.full((tears, len(SHIFTS)), np.inf), np.arange(tears)
    for turn in IN_TURN:
        shifted, beside = shifts[left, turn, None] + second[left, None], first[left, None]
        terms = np.concatenate([_cubes(shifted, beside), _trend(shifted)], axis=3)
        across = terms @ inverse[left, None]  # one small product a shift: BLAS starts no threads
        rest = y[left, None] - terms @ flat[left, None]
        w = np.linalg.solve(own[left] - across @ terms.transpose(0, 1, 3, 2), rest)
        both = known[left] + (rest * w).sum(axis=(2, 3))
        energy[left, turn] = np.where(both > -ROUNDING, np.maximum(both, ROUNDING), np.inf)
        left = left[energy[left, 1] > least[left] * energy[left, 0]]
    return energy


def _as_pairs(values: Numbers) -> Float:
    """Return complex numbers as real ones, (T, N, 2)."""
    return np.stack([values.real, values.imag], axis=-1)


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
