"""Parts are joined where votes, or corners in common, and the surface name one place."""

import numpy as np
import pytest

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import SHIFTS, TURNS, Joining, Placement, Side, bending, factor

ROWS, STEP = 6, 10.0


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


def votes_for(*offsets: int) -> Votes:
    """Return the votes that place each part beside the one before, so many columns further."""
    first = np.arange(len(offsets))
    weight = np.full(len(offsets), float(ROWS))
    return Votes(first, first + 1, 0 * first, np.array(offsets) + 0j, weight)


@pytest.mark.parametrize(
    ("columns", "offsets"),
    [
        ((range(6), range(7, 13), range(14, 20)), (7, 7)),  # the third has votes beside the second
        ((range(8), range(6, 14)), (6,)),  # two columns of corners are in both
    ],
)
def test_parts_are_joined_by_way_of_others_and_by_corners_in_common(columns, offsets):
    units, count = parts(*columns)
    joining = Joining(units, votes_for(*offsets), count, LatticeConstants())
    numbers = joining.run(0, range(1, len(columns)))
    there = np.unique(units.corner)
    width = count // ROWS
    np.testing.assert_array_equal(np.flatnonzero(numbers[:, 3]), there)
    expected = np.stack([there % width, there // width], axis=1)
    np.testing.assert_array_equal(numbers[there, :2], expected)


def test_a_part_whose_votes_and_surface_name_different_places_stays_apart():
    units, count = parts(range(8), range(9, 17))
    none = np.zeros(2, np.int64)
    votes = Votes(none, none + 1, none, np.array([7, 9]) + 0j, np.array([30.0, 20.0]))
    numbers = Joining(units, votes, count, LatticeConstants()).run(0, [1])
    assert numbers[:, 0].max() == 7


@pytest.mark.parametrize(
    ("bent", "votes", "sure"),
    [(0.05, 0.5, True), (0.3, 3.9, False), (0.3, 4.1, True), (2.0, 20.0, False), (2.0, 40.0, True)],
)
def test_a_bent_surface_needs_more_votes_and_a_flat_one_hardly_any(bent, votes, sure):
    units, count = parts(range(8), range(9, 17), bent=bent)
    none = np.zeros(1, np.int64)
    vote = Votes(none, none + 1, none, np.array([9 + 0j]), np.array([votes]))
    numbers = Joining(units, vote, count, LatticeConstants()).run(0, [1])
    assert (numbers[:, 0].max() == 16) == sure


@pytest.mark.parametrize(("offset", "new"), [(4, range(8, 12)), (10, range(12, 18))])
def test_numbers_and_corners_belong_to_the_part_that_is_placed_first(offset, new):
    """Two columns of corners are in both parts, at 6."""
    units, count = parts(range(8), range(6, 14))
    joining = Joining(units, votes_for(6), count, LatticeConstants())
    alone = joining.run(0, [])
    joining.place(1, Placement(0, offset + 0j))
    numbers, old = joining.numbers(), alone[:, 3] == 1
    np.testing.assert_array_equal(numbers[old], alone[old])
    columns = np.unique(numbers[(numbers[:, 3] == 1) & ~old, 0])
    np.testing.assert_array_equal(columns, new)


@pytest.mark.parametrize(("columns", "sure"), [(3, True), (0, False)])
@pytest.mark.parametrize("rows", [6, 7, 8, 9])
@pytest.mark.parametrize("step", [STEP, 12.7 + 2.6j])
def test_one_corner_across_a_gap_shows_no_surface(columns, sure, rows, step):
    """A flat surface does: its energy is 0, on either side of which rounding may put it."""

    def side(number):
        number = number.ravel().astype(complex)
        return Side(step * number, number, np.ones(len(number), np.bool_))

    number = np.arange(6) + 1j * np.arange(rows)[:, None]
    moved = side(9 + number[:, :columns]) if columns else side(9 + number[:1, :1])
    assert (factor(bending(side(number), moved, SHIFTS, LatticeConstants())) > 100) == sure


@pytest.mark.parametrize("one", [Placement(1, 2 + 1j), Placement(2, -3j)])
@pytest.mark.parametrize("other", [Placement(0, 5 + 0j), Placement(3, 1 - 4j)])
def test_a_part_beside_a_turned_one_is_placed_through_it(one, other):
    def placed(number, at):
        return number * TURNS[at.quarter] + at.offset

    number = 3 - 2j
    assert placed(number, one.within(other)) == placed(placed(number, one), other)
    assert placed(placed(number, one), one.inverse()) == number
