"""Numberings of a board: every one is a hypothesis with a score, in nats.

A hypothesis is a number of quarter turns, and the number of the first row and the first column.
Printing errors, borders, the motion from a reference and a known size add their nats each; no one
comes first. The best is sure if it beats the second by enough.
"""

import cmath
import functools
import math
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Board, Float, Numbers, Whole
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.printing import Prints, agreement, prints_of

VOTERS = 100  # nodes that show the motion from a reference


class Reference(NamedTuple):
    """A board with numbers; origin: the number of its node (0, 0); sure: whether it has them."""

    board: Board
    prints: Prints
    origin: tuple[int, int]
    sure: bool = True


class Numbering(NamedTuple):
    """Turn the board, then its node (0, 0) has the number (row, column); nats: of its score; away:
    how far that is from what is expected, by which the best of equals is chosen."""

    nats: float
    away: float
    quarters: int
    row: int
    column: int


class Decision(NamedTuple):
    """The best numbering, the second, None if there is no other, and by how many nats the best is
    better."""

    best: Numbering
    second: Numbering | None
    margin: float


def like_rest(
    now: Board, rest: Reference, previous: Reference | None, k: LatticeConstants
) -> Decision:
    """Return the numbers of a board from those of the pattern at rest.

    previous: the frame before, in the numbers of `rest`; the pattern as a whole moves little since.
        If it was not sure itself, the numbers are continued, but only the frame at rest can make
        them sure.
    """
    since_rest = _motion(now, rest)
    alike = since_rest.alike(k)
    alone = functools.partial(_like, now, prints_of(now.at, k.print_clip), rest, alike, k)
    if previous is None:
        return alone(since_rest, k.rest_sd_cells)
    decided = alone(_motion(now, previous), k.step_sd_cells)
    if previous.sure:
        return decided
    fresh = alone(since_rest, k.rest_sd_cells)
    same = fresh.best[2:] == decided.best[2:]
    return decided._replace(margin=min(fresh.margin, decided.margin) if same else 0.0)


class _Motion(NamedTuple):
    """What some nodes of a board tell of its motion since a reference.

    before, after: (M,), the number of the middle of the view in the reference, and its place in the
        board, as a node tells by the mean steps of each. off: (M,), from the nearest node of the
        reference to where the node is now, cells. steps: of the reference, px.
    """

    before: Numbers
    after: Numbers
    off: Numbers
    steps: tuple[complex, complex]

    def unmoved(self, quarters: int, shape: tuple[int, ...]) -> Float:
        """Return the number, (2,) real, of the node (0, 0) of a board of that shape after quarter
        turns, if the middle of the view had not moved."""
        rows, columns = np.subtract(shape, 1).tolist()
        first = (0, 1j * columns, columns + 1j * rows, rows)[quarters]
        number = self.before - ((-1j) ** quarters * self.after + first)
        return np.array([np.median(number.imag), np.median(number.real)])

    def alike(self, k: LatticeConstants) -> float:
        """Return the greatest share of nodes that moved alike, but for whole cells."""
        apart = np.subtract.outer(self.off, self.off)
        near = np.abs(apart - np.rint(apart)) < k.near_cells
        return float(near.mean(axis=1).max())


def _motion(now: Board, reference: Reference) -> _Motion:
    there = reference.board.at
    place, nodes = np.argwhere(~np.isnan(now.at)), np.argwhere(~np.isnan(there))
    z, others = now.at[tuple(place.T)], there[tuple(nodes.T)]
    middle = complex(z.real.min() + z.real.max(), z.imag.min() + z.imag.max()) / 2
    some = np.argsort(np.abs(z - middle), kind="stable")[:: max(len(z) // VOTERS, 1)]
    place, z = place[some], z[some]
    nearest = np.abs(np.subtract.outer(z, others)).argmin(axis=1)
    number, other = nodes[nearest] + reference.origin, others[nearest]
    return _Motion(
        number @ [1j, 1] + _in_cells(middle - other, reference.board.steps),
        place @ [1j, 1] + _in_cells(middle - z, now.steps),
        _in_cells(z - other, reference.board.steps),
        reference.board.steps,
    )


def _in_cells(way: Numbers, steps: tuple[complex, complex]) -> Numbers:
    """Return ways in px as columns + 1j rows of steps to the next column and row."""
    along, down = steps
    area = (along.conjugate() * down).imag or 1.0
    column, row = (way.conj() * down).imag / area, (along.conjugate() * way).imag / area
    return np.asarray(column + 1j * row, np.complex128)


def _like(
    now: Board,
    prints: Prints,
    rest: Reference,
    alike: float,
    k: LatticeConstants,
    motion: _Motion,
    sd_cells: float,
) -> Decision:
    found: list[Numbering] = []
    for quarters in range(4):
        turned = now.turned(quarters)
        angle = np.degrees(cmath.phase(turned.steps[0] / motion.steps[0]))
        turn = angle**2 / (2 * k.turn_sd_degrees**2)
        at = motion.unmoved(quarters, now.owner.shape)
        here = turned, prints.turned(quarters), rest, at
        row, column, score, moved = _scores(*here, turn, alike, sd_cells, k)
        best = np.lexsort((moved.ravel(), -score.ravel()))[:2]
        found += [
            Numbering(float(score[n, m]), float(moved[n, m]), quarters, int(row[n]), int(column[m]))
            for n, m in zip(*np.unravel_index(best, score.shape), strict=True)
            if np.isfinite(score[n, m])
        ]
    return decided_by(found)


def decided_by(found: list[Numbering]) -> Decision:
    """Return the best of some numberings."""
    best, *others = sorted(found, key=lambda each: (-each.nats, each.away))
    margin = best.nats - others[0].nats if others else math.inf
    return Decision(best, others[0] if others else None, margin)


def _scores(
    now: Board,
    prints: Prints,
    rest: Reference,
    at: Float,
    turn: float,
    alike: float,
    sd_cells: float,
    k: LatticeConstants,
) -> tuple[Whole, Whole, Float, Float]:
    """Return numbers of the first row, (P,), and of the first column, (Q,), of a board that is
    turned already, their nats, and what their motion alone would be against them, (P, Q).

    at: (2,), the number of its first node if nothing had moved. turn: nats against its rotation.
    alike: the share of nodes that moved alike since rest.
    """
    origin, about = np.array(rest.origin), np.rint(at).astype(np.int64)
    low = np.minimum(origin - now.owner.shape + 1, about - 3)
    high = np.maximum(origin + rest.board.owner.shape - 1, about + 3)
    row, column = (np.arange(low[n], high[n] + 1) for n in (0, 1))
    away = np.square(row - at[0])[:, None] + np.square(column - at[1])
    first = row - origin[0], column - origin[1]
    score = agreement(rest.prints, prints, *first, alike, k)
    moved: Float = away / (2 * sd_cells**2) + turn
    score -= np.minimum(moved, k.motion_nats)  # what was turned by hand was moved too
    score += _of_ends(first[0], now, rest.board, 0, k)[:, None]
    score += _of_ends(first[1], now, rest.board, 1, k)
    odd = np.add.outer(*first) % 2 == 1
    score[odd == (now.sign == rest.board.sign)] = -np.inf
    return row, column, score, moved


def _of_ends(first: Whole, now: Board, rest: Board, axis: int, k: LatticeConstants) -> Float:
    """Return the nats of two opposite sides for each number of the first line, (P,).

    Two borders on one line agree. Else the pattern did not end where it seemed to, at rest or now,
    and an object hid its rest. That an object left as many lines as at rest would be chance.
    """
    sides = slice(2 * axis, 2 * axis + 2)
    here, there = (np.array(each.outer_lines)[sides] for each in (now, rest))
    ends_now, ends_rest = now.border.ends[sides], rest.border.ends[sides]
    beyond = np.stack([there[0] - (first + here[0]), first + here[1] - there[1]])  # lines, outwards
    against = np.where(beyond > 0, ends_rest[:, None], ends_now[:, None] & (beyond < 0))
    total: Float = -k.end_nats * against.sum(axis=0)
    if (ends_now & ends_rest).all():
        total += math.log(there[1] - there[0] + 1) * (beyond == 0).all(axis=0)
    return total


def in_shape(now: Board, shape: tuple[int, int], k: LatticeConstants) -> Decision:
    """Return the place of a board that is upright in a pattern of known rows and columns.

    Rows and columns are exchanged if the shape fits better so; the columns then stay nearest to the
    image's x axis. A line that the size lacks, a border inside it, and places in view without
    corners are against a placement, and a little an end in view that shows no border. Scores are 0
    where all fits.
    """
    turns = [0]
    if shape[0] != shape[1]:
        turns.append(3 if now.steps[0].imag > 0 else 1)
    found = []
    for quarters in turns:
        turned = now.turned(quarters)
        top, bottom, left, right = turned.farthest_lines
        shown = turned.border.ends, turned.border.follows, turned.border.room
        sides = [*zip(*(each.tolist() for each in shown), strict=True)]
        rows = _places(top, bottom, shape[0], sides[:2], k)
        columns = _places(left, right, shape[1], sides[2:], k)
        found += [
            Numbering(a + b, abs(row) + abs(column), quarters, row, column)
            for row, a in rows
            for column, b in columns
        ]
    return decided_by(found)


def _places(
    begin: int, end: int, size: int, sides: list[tuple[bool, ...]], k: LatticeConstants
) -> list[tuple[int, float]]:
    """Return the best two numbers for the first line of a board, and their nats.

    begin, end: the first and the last line that it has. size: the lines of the pattern. sides:
    whether the pattern ends before the first and after the last line, follows, and has room there.
    """
    places = []
    lines = end - begin + 1
    for start in range(min(0, size - lines), max(0, size - lines) + 1):
        total = 0.0
        beyond = -start, start + lines - size
        for (ends, follows, room), further in zip(sides, beyond, strict=True):
            if further > 0:
                total -= k.end_nats * further
            elif further < 0 and not follows:
                total -= k.end_nats * (ends or room)
            elif further == 0 and follows:
                total -= k.end_nats
            elif further == 0 and room and not ends:
                total -= k.bare_nats
        places.append((start - begin, total))
    best = sorted(places, key=lambda each: (-each[1], abs(each[0])))
    return sorted(best[:2])


def seen_lines(now: Board) -> tuple[int, int]:
    """Return the rows and columns that a board seems to have: its own, and one more on each side
    on which the pattern follows."""
    top, bottom, left, right = now.farthest_lines
    more = now.border.follows.astype(int)
    return bottom - top + 1 + more[:2].sum(), right - left + 1 + more[2:].sum()
