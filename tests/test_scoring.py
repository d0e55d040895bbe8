"""A score tells which corners are found, missed or false, and how far off they are."""

import numpy as np
import pytest

from cmp_cl.synthetic.scoring import match, score, total


def test_the_nearest_pair_is_made_first():
    truth = [(0, 0), (2, 0)]
    assert list(match([(1.2, 0), (0.9, 0)], truth, 3)) == [1, 0]
    assert list(match([(0.9, 0), (0.1, 0)], truth, 3)) == [1, 0]
    assert list(match([(0.9, 0), (0.1, 0)], [(0, 0)], 3)) == [-1, 0]


def test_a_perfect_answer_succeeds():
    truth = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1) * 10
    answer = score(truth[::-1] + np.array([0.3, 0.4]), truth, 10)
    assert (answer.expected, answer.found, answer.missed, answer.false) == (12, 12, 0, 0)
    assert answer.success == answer.frames == 1
    assert answer.rmse == pytest.approx(0.5)


def test_missed_and_false_corners_are_counted():
    answer = score([(0, 0), (50, 50)], [(0, 0), (10, 0), (20, 0)], 10)
    assert (answer.found, answer.missed, answer.false, answer.success) == (1, 2, 1, 0)


def test_a_second_detection_of_a_corner_is_false():
    answer = score([(0, 0), (1, 0)], [(0, 0)], 10)
    assert (answer.found, answer.false) == (1, 1)


def test_detections_at_junctions_do_not_count():
    answer = score([(0, 0), (30, 1)], [(0, 0)], 10, ignored=[(30, 0)])
    assert (answer.false, answer.success) == (0, 1)
    assert score([(0, 0), (30, 4)], [(0, 0)], 10, ignored=[(30, 0)]).false == 1


def test_a_position_that_is_nan_is_neither_truth_nor_detection():
    answer = score([(np.nan, 0), (0, 0)], [(0, 0), (np.nan, np.nan)], 10)
    assert (answer.expected, answer.found, answer.false) == (1, 1, 0)


def test_frames_add_up():
    both = total([score([(0, 0)], [(0, 0)], 10), score([], [(5, 5)], 10)])
    assert (both.frames, both.success, both.expected, both.missed) == (2, 1, 2, 1)
    assert len(both.errors) == 1
