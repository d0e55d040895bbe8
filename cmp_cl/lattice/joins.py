"""Parts are placed beside each other across tears, if two kinds of evidence agree; on the host.

Colours: ways of a few steps from the rim of one part to the rim of another, along which black and
white must change after every step, vote for a placement. Squeezed cells can get lost between the
parts, but none is invented, so a count can be too short, never too long. Surface: the map from
numbers to positions bends least across the tear if the placement is right. What is not sure stays
apart.
"""

import itertools
from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Units, Votes
from cmp_cl.lattice.constants import LatticeConstants

TURNS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for.
SHIFTS = np.array([0, 1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j, 2, -2, 2j, -2j])
TREND = 6  # terms of a quadratic
ROUNDING = 1e-9  # cells^2, of the energy of a flat surface, which is 0


class Placement(NamedTuple):
    """A part's numbers times a quarter turn, plus an offset."""

    quarter: int
    offset: complex

    def inverse(self) -> "Placement":
        """Return the placement of the other part in this one's numbers."""
        back = -self.quarter % 4
        return Placement(back, -self.offset * TURNS[back])

    def within(self, other: "Placement") -> "Placement":
        """Return the placement where the part is that this one is beside."""
        quarter = (self.quarter + other.quarter) % 4
        return Placement(quarter, self.offset * TURNS[other.quarter] + other.offset)


class Joining:
    """Joins the parts of a frame. units, votes: of its parts; corners: their number."""

    def __init__(self, units: Units, votes: Votes, corners: int, k: LatticeConstants) -> None:
        self.units, self.k, self.corners = units, k, corners
        parts = len(units.faces)
        bounds = np.searchsorted(units.part, np.arange(parts + 1))
        self.members = [slice(*each) for each in itertools.pairwise(bounds.tolist())]
        self.by_x = np.argsort(units.at.real, kind="stable")
        self.x = units.at.real[self.by_x]
        self.votes: list[list[tuple[int, Placement, float]]] = [[] for _ in range(parts)]
        for first, second, quarter, offset, weight in zip(
            *(each.tolist() for each in votes), strict=True
        ):
            at = Placement(quarter, offset)
            self.votes[second].append((first, at, weight))
            self.votes[first].append((second, at.inverse(), weight))

    def run(self, main: int, others: Iterable[int]) -> NDArray[np.int32]:
        """Place the main part, and beside it each of the others, in their order, that is sure where
        it belongs. One that is not is looked at again once another part beside it is placed.

        Returns `numbers`.
        """
        self.number = np.zeros_like(self.units.number)
        self.rotation = np.zeros_like(self.units.rotation)
        self.placed = np.zeros(len(self.number), np.bool_)  # units that number their corner
        self.taken = np.zeros(self.corners, np.bool_)
        self.keys = np.zeros(0, np.int64)  # of the numbers that are taken, in order
        self.places: dict[int, Placement] = {}
        left = {main, *others}
        beside = {main}
        while beside:
            part = min(beside)
            beside.remove(part)
            at = Placement(0, 0j) if part == main else self.sure(part)
            if at:
                self.place(part, at)
                left.remove(part)
                beside |= {other for other, _, _ in self.votes[part]} & left
        return self.numbers()

    def numbers(self) -> NDArray[np.int32]:
        """Return column, row, quarter turn, and 1 of every corner that is placed so far, (N, 4)."""
        number, found = self.number[self.placed], np.zeros((self.corners, 4), np.int32)
        columns = number.real, number.imag, self.rotation[self.placed], np.ones(len(number))
        found[self.units.corner[self.placed]] = np.rint(np.stack(columns, axis=1))
        return found

    def place(self, part: int, at: Placement) -> None:
        """Number the corners of a part that have no number, and whose number no other has."""
        self.places[part] = at
        some = self.members[part]
        corner = self.units.corner[some]
        number = self.units.number[some] * TURNS[at.quarter] + at.offset
        row, column = (np.rint(each).astype(np.int64) for each in (number.imag, number.real))
        key = (row << 32) + column
        fresh = ~self.taken[corner]
        if len(self.keys):
            fresh &= self.keys[np.searchsorted(self.keys[:-1], key)] != key
        self.number[some] = number
        self.rotation[some] = (self.units.rotation[some] + at.quarter) % 4
        self.placed[some] = fresh
        self.taken[corner[fresh]] = True
        new = np.sort(key[fresh])
        self.keys = np.insert(self.keys, np.searchsorted(self.keys, new), new)

    def sure(self, part: int) -> Placement | None:
        """Return the placement of a part if it is sure.

        It has the most votes, the surface bends least there, and the votes, times how much more it
        bends elsewhere, are enough; more are, where it bends much. Neither is enough alone:
        squeezed cells can get lost between the parts, which makes counts too short; and where cells
        are long the surface expects more of them. Behind a bar few colours are seen, but a flat
        board goes on nowhere else.
        """
        ballots: dict[Placement, float] = defaultdict(float)
        for other, beside, weight in self.votes[part]:
            if place := self.places.get(other):
                ballots[beside.within(place)] += weight
        at = max(ballots, key=lambda each: ballots[each])
        few = ballots[at] < self.k.join_few
        votes, bends = min(ballots[at], 1.0) if few else ballots[at], self.energy(part, at)
        least = self.k.join_votes * max(1.0, bends.min() / self.k.join_bend)
        return at if votes * factor(bends) > least else None

    def energy(self, part: int, at: Placement) -> Float:
        """Return how much the surface bends at a placement of a part, and at others beside it."""
        units, some = self.units, self.members[part]
        moved = Side(units.at[some], units.number[some] * TURNS[at.quarter], units.rim[some])
        x, wide = moved.at.real, 2 * (self.k.span + 1) * moved.cell  # votes are no longer than half
        ends = np.searchsorted(self.x, (x.min() - wide, x.max() + wide))
        near = self.by_x[slice(*ends)]
        near = near[self.placed[near]]
        near = near[~np.isin(units.corner[near], units.corner[some])]
        fixed = Side(units.at[near], self.number[near], units.rim[near])
        return bending(fixed, moved, at.offset + SHIFTS, self.k)


class Side(NamedTuple):
    """Nodes on one side of a tear: positions, px, numbers, and which are at the rim of a part."""

    at: Numbers
    number: Numbers
    rim: Mask

    @property
    def cell(self) -> float:
        """Return the length of a step, px, by a linear fit."""
        number, at = self.number - self.number.mean(), self.at - self.at.mean()
        return float(np.abs(np.vdot(number, at)) / np.vdot(number, number).real)

    def near(self, other: "Side", reach: float, most: int) -> "Side":
        """Return those that are by less than `reach` px farther from the other side's rim than the
        nearest one, at most so many."""
        z, others = self.at.astype(np.complex64), other.at[other.rim].astype(np.complex64)
        if not len(z) or not len(others):
            return Side(self.at[:0], self.number[:0], self.rim[:0])
        x, y = (
            np.maximum(np.maximum(there.min() - own, own - there.max()), 0)
            for own, there in ((z.real, others.real), (z.imag, others.imag))
        )
        box = np.hypot(x, y)  # from the upright rectangle around the others, not farther than they
        some = np.flatnonzero(box <= np.abs(others - z[box.argmin()]).min() + reach)
        away = np.abs(np.subtract.outer(others, z[some])).min(axis=0)
        chosen = some[away < away.min() + reach]
        if len(chosen) > most:
            chosen = chosen[np.linspace(0, len(chosen) - 1, most).astype(np.int64)]
        return Side(self.at[chosen], self.number[chosen], self.rim[chosen])


def factor(energy: Float) -> float:
    """Return by what factor the surface bends more at the second best of `SHIFTS`; 0 if no shift is
    not the best."""
    first, second = np.sort(energy)[:2]
    best = SHIFTS[energy.argmin()] == 0 and np.isfinite(first)
    return float(second / first) if best else 0.0


def bending(fixed: Side, moved: Side, offsets: Numbers, k: LatticeConstants) -> Float:
    """Return the bending energy of the map from numbers to positions, cells, near the tear between
    two sides, for each offset of the second one's numbers; infinite where it is not defined.

    Cubic radial functions with a quadratic trend: M [w; c] = [x; 0], energy x' w, with
    M = [K + I, B; B', 0]. The first side and the trend are eliminated once; the energy is theirs,
    and that of what they leave of the second side.
    """
    if len(moved.at) < TREND // 2:
        return np.full(len(offsets), np.inf)
    middle, cell = moved.at.mean(), moved.cell
    reach = (k.span + 1) / 2 * cell  # three lines of nodes, which a quadratic needs
    one, two = fixed.near(moved, reach, k.tear_most), moved.near(fixed, reach, k.tear_most)
    count = len(one.at)
    if count < TREND or len(two.at) < TREND // 2:
        return np.full(len(offsets), np.inf)
    x, y = (((side.at - middle) / cell).view(np.float64).reshape(-1, 2) for side in (one, two))
    origin = one.number.mean()
    first = one.number - origin
    system = np.zeros((count + TREND, count + TREND))
    system[:count, :count] = _cubes(first, first) + np.eye(count)
    system[:count, count:] = _trend(first)
    system[count:, :count] = system[:count, count:].T
    position = np.concatenate([x, np.zeros((TREND, 2))])
    second = ((two.number - origin) + offsets[:, None]).ravel()
    beside = np.concatenate([_cubes(second, first), _trend(second)], axis=1)
    beside = beside.reshape(len(offsets), -1, count + TREND)
    own = _cubes(two.number, two.number) + np.eye(len(two.at))
    try:
        inverse = np.linalg.inv(system)
        across = beside @ inverse  # one small product an offset: BLAS starts no threads
        left = y - across @ position
        w = np.linalg.solve(own - across @ beside.transpose(0, 2, 1), left)
    except np.linalg.LinAlgError:
        return np.full(len(offsets), np.inf)
    energy: Float = (position * (inverse @ position)).sum() + (left * w).sum(axis=(1, 2))
    return np.where(energy > -ROUNDING, np.maximum(energy, ROUNDING), np.inf)


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
