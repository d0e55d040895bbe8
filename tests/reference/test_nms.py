"""The oracle's non-maximum suppression against a walk over every pixel."""

import itertools

import numpy as np
import pytest

from cmp_cl.reference.paper import nms


def tent(response: np.ndarray, row: int, column: int) -> int:
    total = 0
    for dy, dx in itertools.product(range(-2, 3), repeat=2):
        r, c = row + dy, column + dx
        if 0 <= r < response.shape[0] and 0 <= c < response.shape[1]:
            total += (3 - abs(dy)) * (3 - abs(dx)) * int(response[r, c])
    return total


def kept(response: np.ndarray, score: np.ndarray, radius: int) -> set[tuple[int, int]]:
    """Decide pixel by pixel: larger 10 S + R wins, among equals the earlier in raster order."""
    height, width = response.shape

    def key(row: int, column: int) -> tuple[int, int]:
        return 10 * int(score[row, column]) + int(response[row, column]), -(row * width + column)

    result = set()
    for row, column in np.argwhere(response > 0):
        neighbours = itertools.product(
            range(max(row - radius, 0), min(row + radius + 1, height)),
            range(max(column - radius, 0), min(column + radius + 1, width)),
        )
        if all(key(row, column) >= key(*other) for other in neighbours if response[other] > 0):
            result.add((int(row), int(column)))
    return result


def sparse(shape: tuple[int, int], share: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < share, rng.integers(1, 6, shape), 0).astype(np.int32)


@pytest.mark.parametrize("radius", [1, 3, 5])
@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (19, 23)])
def test_maxima_are_those_of_a_walk_over_the_pixels(radius, share, shape):
    response = sparse(shape, share, seed=radius)
    score = nms.score(response)
    for row, column in np.ndindex(shape):
        assert score[row, column] == tent(response, row, column)
    found = {tuple(map(int, place)) for place in np.argwhere(nms.maxima(response, score, radius))}
    assert found == kept(response, score, radius)


def test_the_centroid_is_rounded_halves_up():
    response = np.zeros((20, 20), np.int32)
    response[9, 9], response[9, 10], response[11, 10], response[9, 12] = 5, 3, 2, 5
    centroid, rounded = nms.centroids(response, np.array([9]), np.array([9]))
    np.testing.assert_allclose(centroid, [[9 + 5 / 10, 9 + 4 / 10]])  # (9, 12) is outside
    np.testing.assert_array_equal(rounded, [[10, 9]])  # halves go up
