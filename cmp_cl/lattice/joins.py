"""Parts are placed beside each other across tears, if two kinds of evidence agree; on the host.

Colours: ways of a few steps from the rim of one part to the rim of another, along which black and
white must change after every step, vote for a placement. Squeezed cells can get lost between the
parts, but none is invented, so a count can be too short, never too long. Surface: the map from
numbers to positions bends least across the tear if the placement is right. What is not sure stays
apart.
"""

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Units, Votes, Whole
from cmp_cl.lattice.constants import LatticeConstants

TURNS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for.
SHIFTS = np.array([0, 1 + 1j, 1 - 1j, -1 + 1j, -1 - 1j, 2, -2, 2j, -2j])
TREND = 6  # terms of a quadratic
FAR = 1 << 20  # farther than any number


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


class Joining:
    """Joins the parts of a frame. units, votes: of its parts; corners: their number."""

    def __init__(self, units: Units, votes: Votes, corners: int, k: LatticeConstants) -> None:
        self.units, self.k, self.corners = units, k, corners
        parts = int(units.part.max(initial=-1)) + 1
        bounds = np.searchsorted(units.part, np.arange(parts + 1))
        self.members = [slice(*each) for each in itertools.pairwise(bounds.tolist())]
        self.votes = _from_both_sides(votes)
        bounds = np.searchsorted(self.votes.second, np.arange(parts + 1))
        self.rows = [slice(*each) for each in itertools.pairwise(bounds.tolist())]
        self.beside = [set(self.votes.first[rows].tolist()) for rows in self.rows]

    def run(self, main: int, others: Iterable[int]) -> Placed:
        """Return the main part with each of the others, in their order, that is sure where it
        belongs. One that is not is looked at again once another part beside it is placed."""
        self.placed = Placed(
            np.full(self.corners, -1),
            np.zeros(self.corners, np.complex128),
            np.zeros(self.corners, np.int64),
        )
        self.places = {main: Placement(0, 0j)}
        order = [self.place(main)]
        left = set(others)
        asked = self.beside[main] & left
        while asked:
            part = min(asked)
            asked.remove(part)
            if at := self.sure(part):
                self.places[part] = at
                order.append(self.place(part))
                left.remove(part)
                asked |= self.beside[part] & left
        corner = np.concatenate(order)
        _, first = np.unique(_keys(self.placed.number[corner]), return_index=True)
        self.placed.unit[np.delete(corner, first)] = -1  # a number goes to the part placed first
        return self.placed

    def place(self, part: int) -> Whole:
        """Number the corners of a part that have no number. Return these corners."""
        some, placed, at = self.members[part], self.placed, self.places[part]
        unit = some.start + np.flatnonzero(~placed.there[self.units.corner[some]])
        corner: Whole = self.units.corner[unit]
        placed.unit[corner] = unit
        placed.number[corner] = self.units.number[unit] * TURNS[at.quarter] + at.offset
        placed.rotation[corner] = (self.units.rotation[unit] + at.quarter) % 4
        return corner

    def sure(self, part: int) -> Placement | None:
        """Return the placement of a part if it is sure.

        It has the most votes, and the surface bends least there. Neither is enough alone: squeezed
        cells can get lost between the parts, which makes counts too short; and where cells are long
        the surface expects more of them.
        """
        ballots: dict[Placement, float] = defaultdict(float)
        votes, rows = self.votes, self.rows[part]
        for first, quarter, offset, weight in zip(
            votes.first[rows].tolist(),
            votes.quarter[rows].tolist(),
            votes.offset[rows].tolist(),
            votes.weight[rows].tolist(),
            strict=True,
        ):
            if place := self.places.get(first):
                turned = Placement(
                    (quarter + place.quarter) % 4, offset * TURNS[place.quarter] + place.offset
                )
                ballots[turned] += weight
        if not ballots or max(ballots.values()) < self.k.join_votes:
            return None
        at = max(ballots, key=lambda each: ballots[each])
        return at if self.ratio(part, at) >= self.k.join_bend else None

    def ratio(self, part: int, at: Placement) -> float:
        """Return by what factor the surface bends more at the second best offset; 0 if this one is
        not the best."""
        units, some, there = self.units, self.members[part], self.placed.there
        there[units.corner[some]] = False
        others = self.placed.unit[there]
        fixed = Side(units.at[others], self.placed.number[there], units.rim[others])
        moved = Side(units.at[some], units.number[some] * TURNS[at.quarter], units.rim[some])
        energy = bending(fixed, moved, at.offset + SHIFTS, self.k)
        energy = np.where(energy > 0, energy, np.inf)
        first, second = np.sort(energy)[:2]
        best = SHIFTS[energy.argmin()] == 0 and np.isfinite(first)
        return float(second / first) if best else 0.0


def _from_both_sides(votes: Votes) -> Votes:
    """Return the votes, and the same for the first part beside the second, by the second part."""
    back = (-votes.quarter) % 4
    other = Votes(votes.second, votes.first, back, -votes.offset * TURNS[back], votes.weight)
    both = [np.concatenate(each) for each in zip(votes, other, strict=True)]
    order = np.argsort(both[1], kind="stable")
    return Votes(*(each[order] for each in both))


def _keys(number: Numbers) -> Whole:
    """Return one whole number for each."""
    column, row = np.rint(number.real), np.rint(number.imag)
    return (column * FAR + row).astype(np.int64)


class Side(NamedTuple):
    """Nodes on one side of a tear: positions, px, numbers, and which are at the rim of a part."""

    at: Numbers
    number: Numbers
    rim: Mask

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


def bending(fixed: Side, moved: Side, offsets: Numbers, k: LatticeConstants) -> Float:
    """Return the bending energy of the map from numbers to positions, cells, near the tear between
    two sides, for each offset of the second one's numbers; infinite where it is not defined.

    Cubic radial functions with a quadratic trend: M [w; c] = [x; 0], energy x' w, with
    M = [K + rough I, B; B', 0]. The first side and the trend are eliminated once; the energy is
    theirs, and that of what they leave of the second side.
    """
    middle, number = moved.at.mean(), moved.number - moved.number.mean()
    cell = float(np.abs(np.vdot(number, moved.at - middle)) / np.vdot(number, number).real)
    reach = k.span * cell
    one, two = fixed.near(moved, reach, k.tear_most), moved.near(fixed, reach, k.tear_most)
    count = len(one.at)
    if count < TREND or len(two.at) < TREND // 2:
        return np.full(len(offsets), np.inf)
    x, y = (((side.at - middle) / cell).view(np.float64).reshape(-1, 2) for side in (one, two))
    origin = one.number.mean()
    first = one.number - origin
    system = np.zeros((count + TREND, count + TREND))
    system[:count, :count] = _cubes(first, first) + k.tear_rough * np.eye(count)
    system[:count, count:] = _trend(first)
    system[count:, :count] = system[:count, count:].T
    position = np.concatenate([x, np.zeros((TREND, 2))])
    second = ((two.number - origin) + offsets[:, None]).ravel()
    beside = np.concatenate([_cubes(second, first), _trend(second)], axis=1)
    beside = beside.reshape(len(offsets), -1, count + TREND)
    own = _cubes(two.number, two.number) + k.tear_rough * np.eye(len(two.at))
    try:
        inverse = np.linalg.inv(system)
        across = beside @ inverse  # one small product an offset: BLAS starts no threads
        left = y - across @ position
        w = np.linalg.solve(own - across @ beside.transpose(0, 2, 1), left)
    except np.linalg.LinAlgError:
        return np.full(len(offsets), np.inf)
    energy: Float = (position * (inverse @ position)).sum() + (left * w).sum(axis=(1, 2))
    return energy


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
