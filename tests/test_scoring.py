"""A score tells which corners are found, missed or false, how far off they are, and which numbers
are right."""

import numpy as np
import pytest

from cmp_cl.synthetic.scoring import agreeing, match, score, total

NOWHERE = (np.nan, np.nan)


@pytest.mark.parametrize(
    ("found", "truth", "partner"),
    [
        ([(1.2, 0), (0.9, 0)], [(0, 0), (2, 0)], [1, 0]),
        ([(0.9, 0), (0.1, 0)], [(0, 0), (2, 0)], [1, 0]),
        ([(0.9, 0), (0.1, 0)], [(0, 0)], [-1, 0]),
    ],
)
def test_the_nearest_pair_is_made_first(found, truth, partner):
    assert list(match(found, truth, 3)) == partner


@pytest.mark.parametrize(
    ("detections", "truth", "ignored", "counts"),
    [  # found, missed, false
        ([(0, 0), (50, 50)], [(0, 0), (10, 0), (20, 0)], [], (1, 2, 1)),
        ([(0, 0), (1, 0)], [(0, 0)], [], (1, 0, 1)),
        ([(0, 0), (30, 1)], [(0, 0)], [(30, 0)], (1, 0, 0)),
        ([(0, 0), (30, 4)], [(0, 0)], [(30, 0)], (1, 0, 1)),
        ([NOWHERE, (0, 0)], [(0, 0), NOWHERE], [], (1, 0, 0)),
        ([], [(5, 5)], [], (0, 1, 0)),
    ],
)
def test_each_detection_finds_one_corner_or_is_false(detections, truth, ignored, counts):
    one = score(detections, truth, 10, ignored=ignored)
    assert (one.found, one.missed, one.false) == counts
    assert one.success == (counts[1:] == (0, 0))


def test_a_detection_finds_a_corner_within_the_distance_that_is_asked_for():
    assert [score([(5, 0)], [(0, 0)], 40, within=most).found for most in (None, 4, 6)] == [0, 0, 1]


def test_errors_are_distances_and_frames_add_up():
    truth = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1) * 10
    one = score(truth[::-1] + np.array([0.3, 0.4]), truth, 10)
    assert one.rmse == pytest.approx(0.5)
    both = total([one, score([], [(5, 5)], 10)])
    assert (both.frames, both.success, both.expected, both.found, both.missed) == (2, 1, 13, 12, 1)
    assert len(both.errors) == 12


TRUE = np.argwhere(np.ones((4, 5)))  # numbers of a board, row by row
ASIDE = TRUE + np.array([0, 1])


@pytest.mark.parametrize(
    ("numbers", "right", "on_the_board"),
    [
        (TRUE, 20, 20),
        (np.array([3, 4]) - TRUE, 20, 20),  # turned by 180 degrees
        (TRUE[:, ::-1], 20, 20),  # mirrored
        (ASIDE, 20, 1),
        (np.where(TRUE[:, :1] < 2, TRUE, ASIDE), 10, 10),
        (np.where(TRUE[:, :1] < 1, TRUE, ASIDE), 15, 5),
    ],
)
def test_numbers_are_right_up_to_one_motion_of_the_lattice(numbers, right, on_the_board):
    assert agreeing(numbers, TRUE).sum() == right
    assert agreeing(numbers, TRUE, (4, 5)).sum() == on_the_board
    assert len(agreeing(TRUE[:0], TRUE[:0])) == 0
