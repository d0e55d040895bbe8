"""The refinement of the oracle, on perfect corners at known positions."""

import math

import numpy as np
import pytest
from corner_images import board, corner, noise, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, EdgeLines, EdgeStep, Midlines
from cmp_cl.corners import Corners, Method

RNG = np.random.default_rng(11)
PLACES = [
    (20 + dx, 20 + dy, a) for dx, dy, a in RNG.uniform((-0.5, -0.5, 0), (0.5, 0.5, 3.1), (8, 3))
]


def found(image: np.ndarray, refinement: object) -> Corners:
    return reference.detect(image, DetectorConfig(refinement=refinement))


def one(image: np.ndarray, refinement: object) -> Corners:
    corners = found(image, refinement)
    assert len(corners) == 1
    return corners


@pytest.mark.parametrize(
    ("refinement", "method", "bound"),
    [
        (None, Method.CENTROID, 0.6),
        (EdgeLines(), Method.EDGE_LINES, 0.06),
        (EdgeStep(), Method.EDGE_STEP, 0.03),
        (Midlines(), Method.CUSP, 0.3),
    ],
)
@pytest.mark.parametrize("opening", [70, 90, 110])
def test_a_perfect_corner_is_found_where_it_is(refinement, method, bound, opening):
    for x, y, angle in PLACES:
        image = corner(x, y, angle, opening=math.radians(opening))
        corners = one(image, refinement)
        assert math.dist(corners.xy[0], (x, y)) < bound
        assert corners.method[0] == method


def test_edges_point_along_the_lines_from_white_to_black_first():
    for x, y, angle in PLACES:
        image = corner(x, y, angle)
        corners = one(image, EdgeLines())
        edges = corners.edges[0].astype(np.float64)
        assert np.abs(np.sin(2 * (edges - angle))).max() < 0.5  # seen from the rounded start
        angles = np.diff([*edges, edges[0]]) % math.tau
        assert angles.sum() == pytest.approx(math.tau)
        for k, edge in enumerate(edges):
            # A clockwise rotation on the screen is towards larger angles.
            after = edge + (edges[(k + 1) % 4] - edge) % math.tau / 2
            row, column = round(y + 5 * math.sin(after)), round(x + 5 * math.cos(after))
            assert (image[row, column] < 120) == (k % 2 == 0)


@pytest.mark.parametrize("cell", [6, 8, 15])
def test_the_step_is_right_with_its_default_cell(cell):
    """A disc that is right for wide cells reaches over the next edges of narrow ones."""
    image, truth = board(90, 90, cell)
    speckled = np.clip(image.astype(np.int64) + noise(image.shape) // 12, 0, 255).astype(np.uint8)
    errors = []
    for refinement in (EdgeStep(), EdgeLines(), EdgeStep(cell=12)):
        distance = to_nearest(truth, found(speckled, refinement).xy)
        inside = distance < 1
        assert inside.mean() > 0.9
        errors.append(np.sqrt(np.square(distance[inside]).mean()))
    assert errors[0] < 0.9 * errors[1]
    assert (errors[2] > errors[1]) == (cell == 6)


@pytest.mark.parametrize("kind", [EdgeLines, Midlines])
def test_a_corner_that_would_move_farther_than_asked_keeps_its_centroid(kind):
    kept = one(corner(20.3, 20.4, 0.7), kind(max_shift=0))
    assert kept.method[0] == Method.KEPT
