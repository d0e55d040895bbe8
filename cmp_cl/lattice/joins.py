"""Parts are placed beside each other across tears, if two kinds of evidence agree; on the host.

Colours: ways of a few steps from the rim of one part to the rim of another, along which black and
white must change after every step, vote for a placement. Squeezed cells can get lost between the
parts, but none is invented, so a count can be too short, never too long. Surface: the map from
numbers to positions bends least across the tear if the placement is right. What is not sure stays
apart.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.constants import LatticeConstants

Whole = NDArray[np.int64]
Float = NDArray[np.float64]
Numbers = NDArray[np.complex128]  # column + 1j row
Mask = NDArray[np.bool_]

DIRECTIONS = np.array([1, 1j, -1, -1j])
# Shifts that keep the colours, of which the one of least bending is looked for.
SHIFTS = np.array([x + 1j * y for x in range(-2, 3) for y in range(-2, 3) if (x + y) % 2 == 0])
FULL = 4  # closed half-edges of a node inside its part
ROUNDED = 0.1  # numbers nearer than that are equal


@dataclasses.dataclass(eq=False)
class Placed:
    """Corners numbered in one frame: part (N,), -1 where none, number and rotation."""

    part: Whole
    number: Numbers
    rotation: Whole

    @property
    def there(self) -> Mask:
        return self.part >= 0


class Placement(NamedTuple):
    """A part's numbers times a quarter turn, plus an offset."""

    quarter: int
    offset: complex


def units_of(
    root: Whole,
    column: Whole,
    row: Whole,
    direction: Whole,
    contradicted: Mask,
    xy: NDArray[np.float32],
    k: LatticeConstants,
) -> tuple[Units, Whole]:
    """Return the units of all parts of at least `least_part` faces, and the faces of these parts.

    root, column, row, direction, contradicted: (4 N,), by half-edge.
    """
    h = np.flatnonzero((root >= 0) & ~contradicted)
    roots, inverse, count = np.unique(root[h], return_inverse=True, return_counts=True)
    order = np.lexsort((roots, -count))
    order = order[count[order] >= FULL * k.least_part]
    rank = np.full(len(roots), -1)
    rank[order] = np.arange(len(order))
    part = rank[inverse]
    h, part = h[part >= 0], part[part >= 0]
    _, first, faces = np.unique(
        part * (len(root) // 4 + 1) + (h >> 2), return_index=True, return_counts=True
    )
    h, part = h[first], part[first]
    z = xy.astype(np.float64).view(np.complex128)[:, 0]
    units = Units(
        corner=h >> 2,
        part=part,
        number=column[h] + 1j * row[h],
        rotation=(direction[h] - h) % 4,
        rim=faces < FULL,
        at=z[h >> 2],
    )
    return units, count[order] // FULL


def joined(units: Units, votes: Votes, corners: int, k: LatticeConstants, main: int = 0) -> Placed:
    """Return the main part with every other that is sure where it belongs, the surest first."""
    return _Joining(units, votes, corners, k).run(main)


class _Joining:
    def __init__(self, units: Units, votes: Votes, corners: int, k: LatticeConstants) -> None:
        self.units, self.votes, self.k = units, votes, k
        self.members = [
            np.flatnonzero(units.part == p) for p in range(int(units.part.max(initial=-1)) + 1)
        ]
        self.placed = Placed(
            np.full(corners, -1), np.zeros(corners, np.complex128), np.zeros(corners, np.int64)
        )
        self.used: Whole = np.zeros(0, np.int64)
        self.inward = [_inward(units.number[each], k) for each in self.members]
        self.energy: dict[tuple[int, int, int], dict[complex, float]] = {}

    def run(self, main: int) -> Placed:
        self.place(main, Placement(0, 0j))
        left = [p for p in range(len(self.members)) if p != main]
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
        return self.placed

    def place(self, part: int, at: Placement) -> None:
        """Number the corners of a part that have no number, unless theirs is used."""
        some = self.members[part]
        corner = self.units.corner[some]
        number = self.units.number[some] * DIRECTIONS[at.quarter] + at.offset
        key = _keys(number)
        _, first = np.unique(key, return_index=True)
        alone = np.zeros(len(key), np.bool_)
        alone[first] = True
        fresh = alone & ~self.placed.there[corner] & ~np.isin(key, self.used)
        corner = corner[fresh]
        self.placed.part[corner] = part
        self.placed.number[corner] = number[fresh]
        self.placed.rotation[corner] = (self.units.rotation[some][fresh] + at.quarter) % 4
        self.used = np.concatenate([self.used, key[fresh]])

    def ballots(self, part: int) -> tuple[Whole, Numbers, Float, Whole]:
        """Return the votes for placements of a part: quarter, offset, weight, unit."""
        units, votes, placed = self.units, self.votes, self.placed
        rows = []
        for a, b, s, t in (
            (votes.first, votes.second, votes.boundary, votes.other),
            (votes.second, votes.first, votes.other, votes.boundary),
        ):
            here = np.flatnonzero(
                (units.part[b] == part) & (placed.part[units.corner[a]] == units.part[a])
            )
            corner, unit = units.corner[a[here]], b[here]
            turn = s[here] + placed.rotation[corner]
            number = placed.number[corner] + votes.steps[here] * DIRECTIONS[turn % 4]
            quarter = (turn - t[here] + 2 - units.rotation[unit]) % 4
            rows.append((quarter, number, votes.weight[here], unit))
        unit = self.members[part][placed.there[units.corner[self.members[part]]]]
        corner = units.corner[unit]  # of both parts
        quarter = (placed.rotation[corner] - units.rotation[unit]) % 4
        rows.append((quarter, placed.number[corner], np.ones(len(unit)), unit))
        quarter, number, weight, unit = (np.concatenate(each) for each in zip(*rows, strict=True))
        return quarter, number - units.number[unit] * DIRECTIONS[quarter], weight, unit

    def sure(self, part: int) -> tuple[float, Placement | None]:
        """Return the placement of a part if it is sure, and by how much its surface is better."""
        k, units = self.k, self.units
        quarter, offset, weight, unit = self.ballots(part)
        if weight.sum() < k.join_votes:
            return 0.0, None
        some = self.members[part]
        key = np.stack([quarter, np.rint(offset.real), np.rint(offset.imag)], axis=1).astype(
            np.int64
        )
        places, which = np.unique(key, axis=0, return_inverse=True)
        which = which.ravel()
        # One stretch of a rim has one cause: its votes count as their root.
        around = np.angle(units.at[unit] - units.at[some].mean())
        octant = np.floor((around / np.pi + 1) * k.join_octants / 2).astype(np.int64)
        sums = np.bincount(
            which * k.join_octants + octant % k.join_octants,
            weight,
            minlength=k.join_octants * len(places),
        ).reshape(-1, k.join_octants)
        score, raw = np.sqrt(sums).sum(axis=1), sums.sum(axis=1)
        free = ~self.placed.there[units.corner[some]]
        for n, (q, x, y) in enumerate(places):  # numbers that are used already are against it
            number = units.number[some[free]] * DIRECTIONS[q] + complex(x, y)
            score[n] -= np.isin(_keys(number), self.used).sum()
        order = np.argsort(-score, kind="stable")
        best = order[0]
        second = max(float(score[order[1]]), 0.0) if len(order) > 1 else 0.0
        colours = score[best] - second >= k.join_margin and second <= k.join_ratio * score[best]
        if len(order) > 1:
            colours &= bool(np.sort(raw)[-2] <= k.join_ratio * raw[best])
        turn, favourite = int(places[best, 0]), complex(places[best, 1], places[best, 2])
        at, ratio = self.flattest(part, turn, favourite)
        agreed = abs(at - favourite) < ROUNDED
        away = at - offset
        same = (np.abs(away) < ROUNDED) & (quarter == turn)
        member = np.searchsorted(some, unit)
        inward = self.inward[part][member] * DIRECTIONS[turn]
        explained = (away * inward.conj()).real >= k.join_inward * np.abs(away)
        against = weight[~same & ((quarter != turn) | ~explained)].sum()
        support = weight[same].sum()
        if against > k.join_against * support:
            return 0.0, None
        bend = k.join_bend if agreed else k.join_bend**2
        alone = ratio >= bend and support >= k.join_votes
        if not alone and not (colours and agreed and ratio > 1):
            return 0.0, None
        return ratio, Placement(turn, at)

    def flattest(self, part: int, turn: int, start: complex) -> tuple[complex, float]:
        """Return the offset of least bending energy, downhill from a start, and by what factor the
        second has more; 0 if none is least."""
        units, placed = self.units, self.placed
        some = self.members[part]
        there = np.flatnonzero(placed.there)
        there = there[~np.isin(there, units.corner[some])]
        if not hasattr(self, "z"):
            self.z = np.zeros(len(placed.part), np.complex128)
            self.z[units.corner] = units.at
        known = self.energy.setdefault((part, turn, len(there)), {})
        tear = Tear.between(
            self.z[there],
            placed.number[there],
            units.at[some],
            units.number[some] * DIRECTIONS[turn],
            self.k,
        )
        at = start
        for _ in range(4):
            new = [each for each in at + SHIFTS if each not in known]
            known.update(zip(new, tear.energies(np.array(new)), strict=True))
            energy = np.array([known[each] for each in at + SHIFTS])
            energy = np.where(energy > 0, energy, np.inf)
            least = int(energy.argmin())
            if SHIFTS[least] == 0:
                first, second = np.sort(energy)[:2]
                return at, float(second / first) if np.isfinite(first) else 0.0
            at = complex(at + SHIFTS[least])
        return at, 0.0


def _keys(number: Numbers) -> Whole:
    return np.rint(number.real).astype(np.int64) * 1_000_003 + np.rint(number.imag).astype(np.int64)


def _inward(number: Numbers, k: LatticeConstants) -> Numbers:
    """Return the unit sum of the steps from each node to the part's nodes near it."""
    column, row = np.rint(number.real).astype(np.int64), np.rint(number.imag).astype(np.int64)
    reach = int(k.join_near_steps)
    column, row = column - column.min() + reach, row - row.min() + reach
    there = np.zeros((row.max() + reach + 1, column.max() + reach + 1), np.bool_)
    there[row, column] = True
    total = np.zeros(len(number), np.complex128)
    for down in range(-reach, reach + 1):
        for across in range(-reach, reach + 1):
            if np.hypot(across, down) <= k.join_near_steps:
                total += there[row + down, column + across] * complex(across, down)
    unit: Numbers = total / np.maximum(np.abs(total), 1e-9)
    return unit


class Tear(NamedTuple):
    """Nodes on both sides of a tear: numbers, the number of those of the first side, positions."""

    number: Numbers
    fixed: int
    at: Numbers
    rough: float

    @classmethod
    def between(
        cls, za: Numbers, na: Numbers, zb: Numbers, nb: Numbers, k: LatticeConstants
    ) -> "Tear":
        """Choose the nodes near the tear: in each sector around b, those within some cells of the
        nearest on their own side."""
        cell = _cell_of(zb, nb)
        middle = zb.mean()
        near = np.abs(za - middle) < np.abs(zb - middle).max() + k.tear_wide_cells * cell
        za, na = za[near], na[near]
        apart = np.abs(za[:, None] - zb[None]) / cell if len(za) else np.zeros((0, len(zb)))
        sides = []
        for z, distance in (
            (za, apart.min(axis=1, initial=np.inf)),
            (zb, apart.min(axis=0, initial=np.inf)),
        ):
            turn = (np.angle(z - middle) / np.pi + 1) * k.tear_sectors / 2
            sector = np.floor(turn).astype(np.int64) % k.tear_sectors
            gap = np.full(k.tear_sectors, np.inf)
            np.minimum.at(gap, sector, distance)
            some = (distance < gap[sector] + k.tear_deep_cells) & (gap[sector] < k.tear_wide_cells)
            chosen = np.flatnonzero(some)
            if len(chosen) > k.tear_most:
                chosen = chosen[np.linspace(0, len(chosen) - 1, k.tear_most).astype(np.int64)]
            sides.append(chosen)
        a, b = sides
        at = np.concatenate([za[a], zb[b]]) / cell
        return cls(np.concatenate([na[a], nb[b]]), len(a), at - at.mean(), k.tear_rough)

    def energies(self, offsets: Numbers) -> Float:
        """Return the bending energy of the map from numbers to positions, for each offset of the
        second side; infinite where it is not defined.

        Cubic radial functions with a quadratic trend: [K + rough I, B; B', 0] [w; c] = [x; 0],
        energy x' w.
        """
        count = len(self.number)
        energy = np.full(len(offsets), np.inf)
        if self.fixed < 6 or count - self.fixed < 3:
            return energy
        position = np.zeros((count + 6, 2))
        position[:count] = np.stack([self.at.real, self.at.imag], axis=1)
        for n, offset in enumerate(offsets):
            p = self.number.copy()
            p[self.fixed :] += offset
            p -= p[: self.fixed].mean()
            distance = np.abs(p[:, None] - p[None])
            system = np.zeros((count + 6, count + 6))
            system[:count, :count] = distance**3 + self.rough * np.eye(count)
            x, y = p.real, p.imag
            trend = np.stack([np.ones(count), x, y, x * x, y * y, x * y], axis=1)
            system[:count, count:], system[count:, :count] = trend, trend.T
            try:
                w = np.linalg.solve(system, position)[:count]
            except np.linalg.LinAlgError:
                continue
            energy[n] = (w * position[:count]).sum()
        return energy


def _cell_of(z: Numbers, number: Numbers) -> float:
    """Return the median distance of neighbours in a part, px."""
    order = np.lexsort((number.real, number.imag))
    step = np.diff(number[order])
    beside = np.abs(step - 1) < ROUNDED
    lengths = np.abs(np.diff(z[order]))[beside]
    order = np.lexsort((number.imag, number.real))
    beside = np.abs(np.diff(number[order]) - 1j) < ROUNDED
    lengths = np.concatenate([lengths, np.abs(np.diff(z[order]))[beside]])
    return float(np.median(lengths)) if len(lengths) else 1.0
