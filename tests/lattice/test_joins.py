"""Parts are joined where votes, or corners in common, and the surface name one place."""

import numpy as np
import pytest

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import Joining

ROWS, STEP = 6, 10.0
NO_VOTES = Votes(*(np.zeros(0, np.int64) for _ in range(5)), np.zeros(0))


def parts(*columns: range):
    """Return parts of a print that is not quite flat, each of some of its columns and numbered by
    itself, and the number of all corners."""
    width = max(each.stop for each in columns)
    number = np.arange(width) + 1j * np.arange(ROWS)[:, None]
    bent = np.random.default_rng(1).normal(0, 0.3, (2, ROWS, width))
    at = STEP * number + bent[0] + 1j * bent[1]
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
    ), corner.size


def votes_along_rows(units: Units, steps: int) -> Votes:
    """Return a vote in each row from the last column of a part to the first one of the next."""
    ends = [np.flatnonzero(units.part == part).reshape(ROWS, -1) for part in np.unique(units.part)]
    first = np.concatenate([one[:, -1] for one in ends[:-1]])
    count = np.ones(len(first), np.int64)
    second = np.concatenate([other[:, 0] for other in ends[1:]])
    return Votes(first, second, 0 * count, 2 * count, steps * count, 1.0 * count)


@pytest.mark.parametrize(
    ("columns", "steps"),
    [
        ((range(6), range(7, 13), range(14, 20)), 2),  # the third has votes for the second alone
        ((range(8), range(6, 14)), None),  # two columns of corners are in both
    ],
)
def test_parts_are_joined_by_way_of_others_and_by_corners_in_common(columns, steps):
    units, count = parts(*columns)
    votes = NO_VOTES if steps is None else votes_along_rows(units, steps)
    placed = Joining(units, votes, count, LatticeConstants()).run(0, range(1, len(columns)))
    there = np.unique(units.corner)
    width = count // ROWS
    np.testing.assert_array_equal(np.flatnonzero(placed.there), there)
    expected = there % width + 1j * (there // width)
    np.testing.assert_array_equal(placed.number[there], expected)
