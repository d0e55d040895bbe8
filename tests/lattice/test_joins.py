"""Parts are joined where votes, or corners in common, and the surface name one place."""

import numpy as np
import pytest

from cmp_cl.lattice import joins
from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.bending import TURNS, bending
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import Placements, factor, joined

K, ROWS, STEP = LatticeConstants(), 6, 10.0


def parts(*columns: range, bent: float = 0.3):
    """Return parts of a print that is not quite flat, each of some of its columns and numbered by
    itself, and the number of all corners. bent: px."""
    width = max(each.stop for each in columns)
    number = np.arange(width) + 1j * np.arange(ROWS)[:, None]
    x, y = np.random.default_rng(1).normal(0, bent, (2, ROWS, width))
    at = STEP * number + x + 1j * y
    corner = np.arange(ROWS * width).reshape(ROWS, width)
    places = [np.s_[:, each.start : each.stop] for each in columns]
    rank = np.repeat(np.arange(len(columns)), [corner[place].size for place in places])
    return Units(
        corner=np.concatenate([corner[place].ravel() for place in places]),
        part=rank,
        number=np.concatenate([(number[p] - number[p][0, 0]).ravel() for p in places]),
        rotation=np.zeros(len(rank), np.int64),
        rim=np.ones(len(rank), np.bool_),
        at=np.concatenate([at[place].ravel() for place in places]),
        faces=np.array([(len(each) - 1) * (ROWS - 1) for each in columns]),
    ), corner.size


def votes_for(*offsets: complex) -> Votes:
    """Return the votes that place each part beside the one before, so many columns further."""
    first = np.arange(len(offsets))
    weight = np.full(len(offsets), float(ROWS))
    return Votes(first, first + 1, 0 * first, np.array(offsets) + 0j, weight)


def vote(offset: int, weight: float) -> Votes:
    """Return the votes for the second of two parts so many columns further."""
    return votes_for(offset)._replace(weight=np.array([weight]))


@pytest.mark.parametrize("seed", range(12))
def test_parts_are_joined_as_they_lie_however_they_are_turned_and_numbered(seed):
    """Side by side or with columns of corners in common, in any order of their sizes; votes are
    between neighbours."""
    draw, start, columns = np.random.default_rng(seed), 0, []
    for width in draw.integers(5, 11, 4).tolist():
        columns.append(range(start, start + width))
        start += width + draw.choice([-2, 1])
    columns.sort(key=len, reverse=True)
    units, count = parts(*columns)
    column = np.array([each.start for each in columns])
    turn, origin = draw.integers(0, 4, 4), draw.integers(-9, 10, (4, 2)) @ [1, 1j]
    number = units.number * TURNS[turn[units.part]] + origin[units.part]
    units = units._replace(number=number, rotation=turn[units.part])
    order = np.argsort(column)
    one, two = np.sort([order[:-1], order[1:]], axis=0)
    quarter = (turn[one] - turn[two]) % 4
    offset = (column[two] - column[one]) * TURNS[turn[one]] - origin[two] * TURNS[quarter]
    votes = Votes(one, two, quarter, offset + origin[one], np.full(3, float(ROWS)))
    found = joined(units, votes, K)
    np.testing.assert_array_equal(np.sort(found.corner), np.unique(units.corner))
    assert not found.part.any()
    row, true = np.divmod(found.corner, count // ROWS)
    expected = (true - column[0] + 1j * row) * TURNS[turn[0]] + origin[0]
    np.testing.assert_array_equal(found.number, expected)
    np.testing.assert_array_equal(found.rotation, turn[0])


@pytest.mark.parametrize(
    ("bent", "votes", "sure"),
    [
        (0.05, {9: 0.3}, True),
        (0.3, {9: 2.0}, False),
        (0.3, {9: 8.0}, True),
        (2.0, {9: 8.0}, False),
        (2.0, {9: 30.0}, True),
        (0.6, {9: 30.0, 7: 15.0}, True),
        (0.6, {9: 30.0, 7: 28.0}, False),
        (0.3, {7: 30.0, 9: 20.0}, False),  # votes and the surface name different places
    ],
)
def test_a_bent_surface_needs_more_votes_in_the_lead_and_a_flat_one_hardly_any(bent, votes, sure):
    units, _ = parts(range(8), range(9, 17), bent=bent)
    none = np.zeros(len(votes), np.int64)
    given = Votes(none, none + 1, none, np.array([*votes]) + 0j, np.array([*votes.values()]))
    assert (joined(units, given, K).part.max() == 0) == sure


def test_a_part_that_is_not_sure_is_asked_again_once_more_votes_are_for_it():
    """The third lies beside the first and the second, with too few votes for each."""
    units, _ = parts(range(8), range(9, 15), range(16, 21))
    votes = Votes(
        first=np.array([0, 0, 1]),
        second=np.array([1, 2, 2]),
        quarter=np.zeros(3, np.int64),
        offset=np.array([9, 16, 7]) + 0j,
        weight=np.array([6.0, 2.5, 2.5]),
    )
    assert not joined(units, votes, K).part.any()
    alone = votes.chosen(np.array([0, 2]))
    np.testing.assert_array_equal(np.unique(joined(units, alone, K).part), [0, 2])


def test_parts_that_begin_a_board_are_placed_before_smaller_ones(monkeypatch):
    units, _ = parts(range(8), range(9, 15), range(19, 25), range(16, 18))
    asked = []

    def noted(units: Units, votes: Votes, k: LatticeConstants) -> np.ndarray:
        asked.append(votes.second.tolist())
        return bending(units, votes, k)

    monkeypatch.setattr(joins, "bending", noted)
    first, second = np.zeros(3, np.int64), np.arange(1, 4)
    votes = Votes(first, second, first, np.array([9, 19, 16]) + 0j, np.full(3, 30.0))
    joined(units, votes, K)
    assert asked == [[1, 2], [3]]


@pytest.mark.parametrize(("offset", "new"), [(4, range(8, 12)), (10, range(12, 18))])
def test_numbers_and_corners_belong_to_the_larger_part(offset, new):
    """Two columns of corners are in both parts, at 6."""
    units, _ = parts(range(8), range(6, 14))
    none = np.zeros(2, np.int64)
    moved = Placements(none, none, np.array([0, offset]) + 0j).units(units)
    old = moved.corner % 14 < 8
    np.testing.assert_array_equal(moved.number[old], units.number[units.part == 0])
    np.testing.assert_array_equal(np.unique(moved.number[~old].real), new)


@pytest.mark.parametrize(("columns", "sure"), [(3, True), (0, False)])
@pytest.mark.parametrize("rows", [6, 7, 8, 9])
@pytest.mark.parametrize("step", [STEP, 12.7 + 2.6j])
def test_one_corner_across_a_gap_shows_no_surface(columns, sure, rows, step):
    """A flat surface does: its energy is 0, on either side of which rounding may put it."""
    number = np.arange(6) + 1j * np.arange(rows)[:, None]
    moved = (9 + number[:, :columns]) if columns else 9 + number[:1, :1]
    both = np.concatenate([number.ravel(), moved.ravel()])
    one, rank = np.ones(len(both), np.bool_), np.repeat([0, 1], [number.size, moved.size])
    units = Units(np.arange(len(both)), rank, both, 0 * rank, one, step * both, np.zeros(2, int))
    assert (factor(bending(units, vote(0, 1.0), K))[0] > 100) == sure
