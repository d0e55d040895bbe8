"""Parts are joined across tears if two kinds of evidence agree; on the host.

Colours: ways of a few steps from the rim of one part to the rim of another, along which black and
white must change after every step, vote for a placement. Squeezed cells can get lost between the
parts, but none is invented, so a count can be too short, never too long. Surface: the map from
numbers to positions bends least across the tear if the placement is right. What is not sure stays
apart.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Board, Float, Mask, Numbers, Units, Votes, Whole
from cmp_cl.lattice.bending import TURNS, bending
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.parts import keys, summed

Lead = tuple[int, int, float]  # two parts, and by how many votes their placement leads
# Of the second of two parts beside the first, in the same numbers.
BESIDE = Votes(
    first=np.zeros(1, np.int64),
    second=np.ones(1, np.int64),
    quarter=np.zeros(1, np.int64),
    offset=np.zeros(1, np.complex128),
    weight=np.zeros(1),
)


def joined(units: Units, votes: Votes, k: LatticeConstants) -> Units:
    """Return the nodes of the parts that begin a board, each with the parts that are joined to it,
    in its numbers.

    In rounds, each part is asked whether it belongs beside a larger one that begins a board, the
    largest first. Those that are sure are one part from then on. Others are asked about another
    one, and again where votes are new. A corner, and a number, belongs to the larger of two parts,
    so parts that begin a board are asked before smaller ones, whose places are less sure.
    """
    refused: set[Lead] = set()
    begin = max(int(np.count_nonzero(units.faces >= k.least_board)), 1)  # the first ones
    while True:
        asked = _asked(votes.chosen(votes.second < begin), refused)
        if not len(asked.first):
            asked = _asked(votes.chosen(votes.first < begin), refused)
        if not len(asked.first):
            return units.chosen(units.part < begin)
        sure = _are_sure(units, asked, k)
        refused.update(_leads(asked))
        if sure.any():
            at = Placements.of(asked.chosen(sure), len(units.faces))
            units, votes = at.units(units), at.votes(votes)


class Placements(NamedTuple):
    """Where parts lie: into, (P,) the part whose numbers each one gets, maybe its own; its numbers
    times so many quarter turns, plus an offset, are numbers of that one."""

    into: Whole
    quarter: Whole
    offset: Numbers

    @classmethod
    def of(cls, sure: Votes, parts: int) -> "Placements":
        """Return the placements in the largest parts; sure: one for each part, in their order."""
        at = cls(np.arange(parts), np.zeros(parts, np.int64), np.zeros(parts, np.complex128))
        for first, second, quarter, offset, _ in zip(*sure, strict=True):
            at.into[second] = at.into[first]
            at.quarter[second] = (quarter + at.quarter[first]) % 4
            at.offset[second] = offset * TURNS[at.quarter[first]] + at.offset[first]
        return at

    def units(self, units: Units) -> Units:
        """Return the nodes of the parts after that, each corner and each number of a part once."""
        part, turn = self.into[units.part], self.quarter[units.part]
        number = units.number * TURNS[turn] + self.offset[units.part]
        rotation = (units.rotation + turn) % 4
        moved = units._replace(part=part, number=number, rotation=rotation)
        moved = moved.chosen(np.argsort(part, kind="stable"))  # of a larger part first
        moved = moved.chosen(_is_new(moved.part, moved.corner))
        return moved.chosen(_is_new(moved.part, keys(moved.number)))

    def votes(self, votes: Votes) -> Votes:
        """Return the votes between the parts after that."""
        first, second = self.into[votes.first], self.into[votes.second]
        turn, origin = self.quarter[votes.first], self.offset[votes.first]
        quarter = (votes.quarter - self.quarter[votes.second]) % 4
        offset = votes.offset - self.offset[votes.second] * TURNS[quarter]
        quarter, offset = (quarter + turn) % 4, offset * TURNS[turn] + origin
        back = -quarter % 4
        swapped = second < first
        every = Votes(
            first=np.minimum(first, second),
            second=np.maximum(first, second),
            quarter=np.where(swapped, back, quarter),
            offset=np.where(swapped, -offset * TURNS[back], offset),
            weight=votes.weight,
        )
        return summed(every.chosen(first != second))


def _is_new(part: Whole, key: Whole) -> Mask:
    """Return which nodes are the first with their key in their part."""
    new = np.zeros(len(key), np.bool_)
    new[np.unique(part * (key.max() + 1) + key, return_index=True)[1]] = True
    return new


def _asked(votes: Votes, refused: set[Lead]) -> Votes:
    """Return placements that were not refused with the same lead: for each part the one with the
    most votes beside the largest other part. Their weight is by how many they lead there."""
    is_first = _is_first(votes.first, votes.second)
    starts, pair = np.flatnonzero(is_first), is_first.cumsum() - 1
    most = np.maximum.reduceat(votes.weight, starts)
    best = np.flatnonzero(votes.weight == most[pair])
    best = best[_is_first(pair[best])]
    others = votes.weight.copy()
    others[best] = 0
    lead = most - np.maximum.reduceat(others, starts)
    asked = votes.chosen(best)._replace(weight=lead)
    asked = asked.chosen(np.array([lead not in refused for lead in _leads(asked)], np.bool_))
    asked = asked.chosen(np.lexsort((asked.first, asked.second)))
    return asked.chosen(_is_first(asked.second))


def _leads(asked: Votes) -> Iterable[Lead]:
    """Return both parts and the weight of each."""
    return zip(asked.first.tolist(), asked.second.tolist(), asked.weight.tolist(), strict=True)


def _is_first(*keys: Whole) -> Mask:
    """Return which rows are the first of those with equal keys, that stand together."""
    first = np.ones(len(keys[0]), np.bool_)
    first[1:] = np.logical_or.reduce([key[1:] != key[:-1] for key in keys])
    return first


def _are_sure(units: Units, asked: Votes, k: LatticeConstants) -> Mask:
    """Return which placements are sure.

    They lead by some votes, the surface bends least there, and the lead, times how much more it
    bends elsewhere, is enough. Neither is enough alone: squeezed cells can get lost between the
    parts, which makes counts too short; and where cells are long the surface expects more of them.
    Behind a bar few colours are seen, but a flat board goes on nowhere else.
    """
    sure: Mask = asked.weight * factor(bending(units, asked, k)) > k.join_votes
    return sure


def factor(energy: Float) -> Float:
    """Return by what factor the surface bends more at the second best of `SHIFTS`, (T, 9) to (T,);
    0 if no shift is not the best."""
    first, second = np.sort(energy)[:, :2].T
    best = (energy.argmin(axis=1) == 0) & np.isfinite(first)
    times: Float = np.divide(second, first, out=np.zeros(len(first)), where=best)
    return times


def goes_on(board: Board, some: Mask, k: LatticeConstants) -> bool:
    """Return whether some places of a board, (R, C), surely go on as the others: the surface
    through both bends far more where its corners lie by other numbers."""
    row, column = np.nonzero(board.owner >= 0)
    part = some[row, column]
    if 2 * np.count_nonzero(part) > len(part):
        part = ~part
    if not part.any():
        return False
    nodes = Units(
        corner=board.owner[row, column].astype(np.int64),
        part=part.astype(np.int64),
        number=column + 1j * row,
        rotation=np.zeros(len(row), np.int64),
        rim=np.ones(len(row), np.bool_),
        at=board.at[row, column],
        faces=np.zeros(2, np.int64),
    ).chosen(np.argsort(part, kind="stable"))
    return bool(factor(bending(nodes, BESIDE, k))[0] >= math.exp(k.sure_nats))
