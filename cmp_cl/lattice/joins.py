"""Parts are placed beside each other across tears, if two kinds of evidence agree; on the host.

Colours: ways of a few steps from the rim of one part to the rim of another, along which black and
white must change after every step, vote for a placement. Squeezed cells can get lost between the
parts, but none is invented, so a count can be too short, never too long. Surface: the map from
numbers to positions bends least across the tear if the placement is right. What is not sure stays
apart.
"""

import dataclasses
import itertools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Units, Votes, Whole
from cmp_cl.lattice.constants import LatticeConstants

DIRECTIONS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for.
SHIFTS = np.array([x + 1j * y for x in range(-2, 3) for y in range(-2, 3) if (x + y) % 2 == 0])
ROUNDED = 0.1  # numbers nearer than that are equal
TREND = 6  # terms of a quadratic
FAR = 1 << 20  # farther than any number
SPARE = 8  # steps between parts, on the map of numbers


@dataclasses.dataclass(eq=False)
class Placed:
    """Corners numbered in one frame, (N,): the node of a part that each is, -1 where none; its
    number and rotation."""

    unit: Whole
    number: Numbers
    rotation: Whole

    @property
    def there(self) -> Mask:
        return self.unit >= 0


class Placement(NamedTuple):
    """A part's numbers times a quarter turn, plus an offset."""

    quarter: int
    offset: complex


def joined(
    units: Units, votes: Votes, corners: int, k: LatticeConstants, main: int, others: Iterable[int]
) -> Placed:
    """Return the main part with each of the others that is sure where it belongs, the surest
    first."""
    return _Joining(units, votes, corners, k).run(main, others)


class _Joining:
    def __init__(self, units: Units, votes: Votes, corners: int, k: LatticeConstants) -> None:
        self.units, self.votes, self.k = units, votes, k
        bounds = np.searchsorted(units.part, np.arange(units.part.max(initial=-1) + 2))
        self.members = [slice(*each) for each in itertools.pairwise(bounds.tolist())]
        self.placed = Placed(
            np.full(corners, -1),
            np.zeros(corners, np.complex128),
            np.zeros(corners, np.int64),
        )
        self.disputed: list[complex] = []
        self.used = Occupied(units.number[each] for each in self.members)
        self.ratios: dict[tuple[int, int, complex, int], float] = {}

    def run(self, main: int, others: Iterable[int]) -> Placed:
        self.place(main, Placement(0, 0j))
        left = list(others)
        while left:
            found = [(self.sure(p), p) for p in left]
            best = max(
                ((r, -p, at) for (r, at), p in found if at is not None),
                default=None,
                key=lambda each: each[:2],
            )
            if best is None:
                break
            part = -best[1]
            assert best[2] is not None
            self.place(part, best[2])
            left.remove(part)
        self.leave_out_disputed()
        return self.placed

    def leave_out_disputed(self) -> None:
        """Take the numbers from corners near one that two parts number otherwise. A piece of one of
        them hangs on the wrong side of a tear there; its nodes are found again from the others."""
        for number in self.disputed:
            step = self.placed.number - number
            near = np.maximum(np.abs(step.real), np.abs(step.imag)) < self.k.span + ROUNDED
            self.placed.unit[near] = -1

    def place(self, part: int, at: Placement) -> None:
        """Number the corners of a part that have no number, unless theirs is used."""
        some = self.members[part]
        corner = self.units.corner[some]
        number = self.units.number[some] * DIRECTIONS[at.quarter] + at.offset
        before = self.placed.number[corner]
        free = ~self.placed.there[corner]
        other = ~free & (np.abs(number - before) > ROUNDED)
        self.disputed += [*before[other], *number[other]]
        fresh = free & ~self.used.at(number)
        corner, number = corner[fresh], number[fresh]
        self.placed.unit[corner] = np.arange(some.start, some.stop)[fresh]
        self.placed.number[corner] = number
        self.placed.rotation[corner] = (self.units.rotation[some][fresh] + at.quarter) % 4
        self.used.add(number)

    def ballots(self, part: int) -> tuple[Whole, Numbers, Float]:
        """Return the votes for placements of a part: quarter, offset, weight."""
        units, votes, placed = self.units, self.votes, self.placed
        rows = []
        for a, b, s, t in (
            (votes.first, votes.second, votes.boundary, votes.other),
            (votes.second, votes.first, votes.other, votes.boundary),
        ):
            here = np.flatnonzero((units.part[b] == part) & (placed.unit[units.corner[a]] == a))
            corner, unit = units.corner[a[here]], b[here]
            turn = s[here] + placed.rotation[corner]
            number = placed.number[corner] + votes.steps[here] * DIRECTIONS[turn % 4]
            quarter = (turn - t[here] + 2 - units.rotation[unit]) % 4
            rows.append((quarter, number, votes.weight[here], unit))
        some = self.members[part]
        unit = some.start + np.flatnonzero(placed.there[units.corner[some]])
        corner = units.corner[unit]  # of both parts
        quarter = (placed.rotation[corner] - units.rotation[unit]) % 4
        rows.append((quarter, placed.number[corner], np.ones(len(unit)), unit))
        quarter, number, weight, unit = (np.concatenate(each) for each in zip(*rows, strict=True))
        return quarter, number - units.number[unit] * DIRECTIONS[quarter], weight

    def sure(self, part: int) -> tuple[float, Placement | None]:
        """Return the placement of a part if it is sure, and by how much its surface is better.

        It has the most votes, less the numbers that would be used twice, and the surface bends
        least there. Neither is enough alone: squeezed cells can get lost between the parts, which
        makes counts too short; and where cells are long the surface expects more of them.
        """
        quarter, offset, weight = self.ballots(part)
        if weight.sum() < self.k.join_votes:
            return 0.0, None
        some = self.members[part]
        places, which = np.unique(np.rint(offset) + FAR * quarter, return_inverse=True)
        quarters = np.rint(places.real / FAR).astype(np.int64)
        places -= FAR * quarters
        votes = np.bincount(which, weight)
        free = self.units.number[some][~self.placed.there[self.units.corner[some]]]
        turned = np.multiply.outer(DIRECTIONS[quarters], free) + places[:, None]
        twice = np.count_nonzero(self.used.at(turned), axis=1)
        best = int(np.argmax(votes - twice))
        if votes[best] < self.k.join_votes:
            return 0.0, None
        at = Placement(int(quarters[best]), complex(places[best]))
        ratio = self.ratio(part, *at)
        return (ratio, at) if ratio >= self.k.join_bend else (0.0, None)

    def ratio(self, part: int, turn: int, offset: complex) -> float:
        """Return by what factor the surface bends more at the second best offset; 0 if this one is
        not the best."""
        units, placed = self.units, self.placed
        some = self.members[part]
        there = placed.there
        there[units.corner[some]] = False
        known = part, turn, offset, int(np.count_nonzero(there))
        if known not in self.ratios:
            others = placed.unit[there]
            fixed = Side(units.at[others], placed.number[there], units.rim[others])
            moved = Side(units.at[some], units.number[some] * DIRECTIONS[turn], units.rim[some])
            energy = Tear.between(fixed, moved, self.k).energies(offset + SHIFTS)
            energy = np.where(energy > 0, energy, np.inf)
            first, second = np.sort(energy)[:2]
            best = SHIFTS[energy.argmin()] == 0 and np.isfinite(first)
            self.ratios[known] = float(second / first) if best else 0.0
        return self.ratios[known]


class Occupied:
    """The numbers that corners have, as a map; no part can lie farther from the first than it has
    room for."""

    def __init__(self, parts: Iterable[Numbers]) -> None:
        self.reach = sum(int(np.ptp(n.real) + np.ptp(n.imag)) + SPARE for n in parts)
        self.map = np.zeros((2 * self.reach + 1, 2 * self.reach + 1), np.bool_)

    def _places(self, number: Numbers) -> tuple[Whole, Whole]:
        row, column = (each + self.reach for each in _row_and_column(number))
        return row.clip(0, 2 * self.reach), column.clip(0, 2 * self.reach)

    def add(self, number: Numbers) -> None:
        self.map[self._places(number)] = True

    def at(self, number: Numbers) -> Mask:
        """Return which of the numbers are taken."""
        taken: Mask = self.map[self._places(number)]
        return taken


def _row_and_column(number: Numbers) -> tuple[Whole, Whole]:
    return np.rint(number.imag).astype(np.int64), np.rint(number.real).astype(np.int64)


class Side(NamedTuple):
    """Nodes on one side of a tear: positions, px, numbers, and which are at the rim of a part."""

    at: Numbers
    number: Numbers
    rim: Mask


class Tear(NamedTuple):
    """Nodes on both sides of a tear: numbers and positions, cells."""

    fixed: Numbers
    fixed_at: Numbers
    moved: Numbers
    moved_at: Numbers
    rough: float

    @classmethod
    def between(cls, fixed: Side, moved: Side, k: LatticeConstants) -> "Tear":
        """Choose the nodes near the tear: within some cells of the nearest on their own side."""
        middle, number = moved.at.mean(), moved.number - moved.number.mean()
        cell = float(np.abs(np.vdot(number, moved.at - middle)) / np.vdot(number, number).real)
        sides = []
        for one, other in ((fixed, moved), (moved, fixed)):
            chosen = _nearest(one, other.at[other.rim], k.span * cell)
            if len(chosen) > k.tear_most:
                chosen = chosen[np.linspace(0, len(chosen) - 1, k.tear_most).astype(np.int64)]
            sides.append(chosen)
        a, b = sides
        fixed_at, moved_at = fixed.at[a] - middle, moved.at[b] - middle
        return cls(fixed.number[a], fixed_at / cell, moved.number[b], moved_at / cell, k.tear_rough)

    def energies(self, offsets: Numbers) -> Float:
        """Return the bending energy of the map from numbers to positions, for each offset of the
        second side; infinite where it is not defined.

        Cubic radial functions with a quadratic trend: M [w; c] = [x; 0], energy x' w, with
        M = [K + rough I, B; B', 0]. The first side and the trend are eliminated once; the energy is
        theirs, and that of what they leave of the second side.
        """
        count = len(self.fixed)
        if count < TREND or len(self.moved) < TREND // 2:
            return np.full(len(offsets), np.inf)
        origin = self.fixed.mean()
        first = self.fixed - origin
        system = np.zeros((count + TREND, count + TREND))
        system[:count, :count] = _cubes(first, first) + self.rough * np.eye(count)
        system[:count, count:] = _trend(first)
        system[count:, :count] = system[:count, count:].T
        position = np.zeros((count + TREND, 2))
        position[:count] = np.stack([self.fixed_at.real, self.fixed_at.imag], axis=1)
        second = ((self.moved - origin) + offsets[:, None]).ravel()
        beside = np.concatenate([_cubes(second, first), _trend(second)], axis=1)
        beside = beside.reshape(len(offsets), -1, count + TREND)
        own = _cubes(self.moved, self.moved) + self.rough * np.eye(len(self.moved))
        try:
            inverse = np.linalg.inv(system)
            across = beside @ inverse  # one small product an offset: BLAS starts no threads
            left = np.stack([self.moved_at.real, self.moved_at.imag], axis=1) - across @ position
            w = np.linalg.solve(own - across @ beside.transpose(0, 2, 1), left)
        except np.linalg.LinAlgError:
            return np.full(len(offsets), np.inf)
        of_first = (position * (inverse @ position)).sum()
        energy: Float = of_first + (left * w).sum(axis=(1, 2))
        return energy


def _nearest(side: Side, others: Numbers, reach: float) -> Whole:
    """Return the indices of the nodes that are by less than `reach` farther from some others than
    the nearest one, px."""
    z, rim = side.at.astype(np.complex64), side.at[side.rim].astype(np.complex64)
    others = others.astype(np.complex64)
    if not len(rim) or not len(others):
        return np.arange(0)
    most = np.abs(np.subtract.outer(rim, others)).min() + reach
    x, y = (
        np.maximum(np.maximum(other.min() - own, own - other.max()), 0)
        for own, other in ((z.real, others.real), (z.imag, others.imag))
    )
    some = np.flatnonzero(np.hypot(x, y) <= most)  # from the upright rectangle around the others
    away = np.abs(np.subtract.outer(others, z[some])).min(axis=0)
    chosen: Whole = some[away < away.min() + reach]
    return chosen


def _trend(number: Numbers) -> Float:
    """Return the terms of a quadratic at each number, (..., N, TREND)."""
    x, y = number.real, number.imag
    return np.stack([np.ones(x.shape), x, y, x * x, y * y, x * y], axis=-1)


def _cubes(a: Numbers, b: Numbers) -> Float:
    """Return the cubed distances of all pairs, (A, B)."""
    x, y = np.subtract.outer(a.real, b.real), np.subtract.outer(a.imag, b.imag)
    x *= x
    y *= y
    x += y
    x *= np.sqrt(x)
    return x
