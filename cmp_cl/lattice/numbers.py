"""Numberings of a board: every one is a hypothesis with a score, in nats.

A hypothesis is a number of quarter turns, and the number of the first row and the first column.
Printing errors, borders, the motion from a reference and a known size add their nats each; no one
comes first. The best is sure if it beats the second by enough.
"""

import functools
import math
from typing import NamedTuple

import numpy as np

from cmp_cl.lattice.arrays import Board, Border, Float, Numbers, Whole
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
    """Turn the board, then its node (0, 0) has the number (row, column); nats: of its score."""

    nats: float
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
    alone = functools.partial(_like, now, prints_of(now.at, k.print_clip), rest, k=k)
    if previous is None:
        return alone(rest, k.rest_sd_cells)
    decided = alone(previous, k.step_sd_cells)
    if previous.sure:
        return decided
    fresh = alone(rest, k.rest_sd_cells)
    same = fresh.best[1:] == decided.best[1:]
    return decided._replace(margin=min(fresh.margin, decided.margin) if same else 0.0)


def _like(
    now: Board,
    prints: Prints,
    rest: Reference,
    reference: Reference,
    sd_cells: float,
    *,
    k: LatticeConstants,
) -> Decision:
    along, down = now.steps
    ways = np.array([along, down, -along, -down]) / reference.board.steps[0]
    angles = np.abs(np.degrees(np.angle(ways))).tolist()
    against = [min(angle**2 / (2 * k.turn_sd_degrees**2), k.motion_nats) for angle in angles]
    found: list[Numbering] = []
    for quarters in sorted(range(4), key=lambda q: angles[q]):
        # How well a turn agrees with the print must not keep another from being tried.
        if found and -against[quarters] < min(max(found).nats, -min(against)) - 2 * k.sure_nats:
            break
        turned = now.turned(quarters)
        here = turned, prints.turned(quarters), rest, _unmoved(turned.at, reference)
        row, column, score = _scores(*here, against[quarters], sd_cells, k)
        best = np.argsort(-score, axis=None)[:6]
        found += [
            Numbering(float(score[n, m]), quarters, int(row[n]), int(column[m]))
            for n, m in zip(*np.unravel_index(best, score.shape), strict=True)
            if np.isfinite(score[n, m])
        ]
    return decided_by(found)


def decided_by(found: list[Numbering]) -> Decision:
    """Return the best of some numberings."""
    best, *others = sorted(found, key=lambda each: -each.nats)
    margin = best.nats - others[0].nats if others else math.inf
    return Decision(best, others[0] if others else None, margin)


def _scores(
    now: Board,
    prints: Prints,
    rest: Reference,
    at: Float,
    turn: float,
    sd_cells: float,
    k: LatticeConstants,
) -> tuple[Whole, Whole, Float]:
    """Return numbers of the first row, (P,), and of the first column, (Q,), of a board that is
    turned already, and their nats, (P, Q).

    at: (2,), the number of its first node if nothing had moved. turn: nats against its rotation.
    """
    origin, about = np.array(rest.origin), np.rint(at).astype(np.int64)
    low = np.minimum(origin - now.owner.shape + 1, about - 3)
    high = np.maximum(origin + rest.board.owner.shape - 1, about + 3)
    row, column = (np.arange(low[n], high[n] + 1) for n in (0, 1))
    away = np.square(row - at[0])[:, None] + np.square(column - at[1])
    first = row - origin[0], column - origin[1]
    score = agreement(rest.prints, prints, *first, k)
    # What was turned by hand was moved too.
    score -= np.minimum(away / (2 * sd_cells**2) + turn, k.motion_nats)
    score += _of_ends(first[0], now, rest.board, 0, k)[:, None]
    score += _of_ends(first[1], now, rest.board, 1, k)
    odd = np.add.outer(*first) % 2 == 1
    score[odd == (now.sign == rest.board.sign)] = -np.inf
    return row, column, score


def _of_ends(first: Whole, now: Board, rest: Board, axis: int, k: LatticeConstants) -> Float:
    """Return the nats of two opposite sides for each number of the first line, (P,).

    Two borders on one line agree. Else the pattern did not end where it seemed to, at rest or now,
    and an object hid its rest. That an object left as many lines as at rest would be chance.
    """
    sides = slice(2 * axis, 2 * axis + 2)
    here, there = (np.array(each.outer_lines)[sides] for each in (now, rest))
    one, other = now.border, rest.border
    nats_now, nats_rest = k.end_nats * one.ends, k.end_nats * other.ends
    unlike = np.abs(one.reach - other.reach) > k.border_step_cells
    same = np.where(unlike, -k.end_nats / 2, 0.0)
    same = np.where(one.ends & other.follows, -nats_now, same)
    same = np.where(other.ends & one.follows, -nats_rest, same)
    beyond = (there[0] - (first + here[0]), first + here[1] - there[1])  # lines, outwards
    total = np.zeros(len(first))
    if (one.ends & other.ends)[sides].all():
        total += math.log(there[1] - there[0] + 1) * ((beyond[0] == 0) & (beyond[1] == 0))
    for n, lines in zip((2 * axis, 2 * axis + 1), beyond, strict=True):
        total += np.where(lines == 0, same[n], np.where(lines > 0, -nats_rest[n], -nats_now[n]))
    return total


def in_shape(now: Board, shape: tuple[int, int], k: LatticeConstants) -> Decision:
    """Return the place of a board that is upright in a pattern of known rows and columns.

    Rows and columns are exchanged if the shape fits better so; the columns then stay nearest to the
    image's x axis. A line that the size lacks, a border inside it, and places in view without
    corners are against a placement. Scores are 0 where all fits.
    """
    turns = [0]
    if shape[0] != shape[1]:
        turns.append(3 if now.steps[0].imag > 0 else 1)
    found = []
    for quarters in turns:
        turned = now.turned(quarters)
        top, bottom, left, right = turned.outer_lines
        rows = _places(top, bottom, shape[0], turned.border, 0, k)
        columns = _places(left, right, shape[1], turned.border, 2, k)
        found += [
            Numbering(a + b, quarters, row, column) for row, a in rows for column, b in columns
        ]
    found.sort(key=lambda each: (-each.nats, abs(each.row) + abs(each.column), each.quarters != 0))
    return decided_by(found)


def _places(
    begin: int, end: int, size: int, border: Border, side: int, k: LatticeConstants
) -> list[tuple[int, float]]:
    """Return numbers for the first line of a board, and their nats.

    begin, end: the first and the last of its lines. size: the lines of the pattern.
    """
    places = []
    lines = end - begin + 1
    for start in range(min(0, size - lines), max(0, size - lines) + 1):
        total = 0.0
        for n, beyond in ((side, -start), (side + 1, start + lines - size)):
            if beyond > 0:
                total -= k.end_nats * beyond
            elif beyond < 0 and not border.follows[n]:
                total -= k.end_nats * bool(border.ends[n] or border.room[n])
            elif beyond == 0 and border.follows[n]:
                total -= k.end_nats
        places.append((start - begin, total))
    return places


def seen_lines(now: Board) -> tuple[int, int]:
    """Return the rows and columns that a board seems to have: its own, and one more on each side
    on which the pattern follows."""
    top, bottom, left, right = now.outer_lines
    more = now.border.follows.astype(int)
    return bottom - top + 1 + more[:2].sum(), right - left + 1 + more[2:].sum()


def _unmoved(at: Numbers, reference: Reference) -> Float:
    """Return the number, (2,) real, of a board's node (0, 0) if the middle of the view had not
    moved since the reference.

    Nodes around the middle are compared with the nearest ones of the reference.
    """
    there = reference.board.at
    along, down = reference.board.steps
    place, nodes = np.argwhere(~np.isnan(at)), np.argwhere(~np.isnan(there))
    z, others = at[tuple(place.T)], there[tuple(nodes.T)]
    middle = complex(np.median(z.real), np.median(z.imag))
    some = np.argsort(np.abs(z - middle), kind="stable")[:: max(len(z) // VOTERS, 1)]
    place, z = place[some], z[some]
    nearest = np.abs(np.subtract.outer(z, others)).argmin(axis=1)
    off, area = z - others[nearest], (along.conjugate() * down).imag or 1.0
    x, y = (off.conj() * down).imag / area, (along.conjugate() * off).imag / area
    number = nodes[nearest] + np.stack([y, x], axis=1) - place + reference.origin
    unmoved: Float = np.median(number, axis=0)
    return unmoved
