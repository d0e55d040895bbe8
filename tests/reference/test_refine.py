"""The working scale and the refinement of the oracle, on perfect corners at known positions."""

import math

import cv2
import numpy as np
import pytest
from corner_images import board, corner, noise, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, EdgeLines, EdgeStep, Midlines, RingHarmonic
from cmp_cl.corners import Corners, Method
from cmp_cl.reference import scale

RNG = np.random.default_rng(11)
PLACES = [
    (20 + dx, 20 + dy, a) for dx, dy, a in RNG.uniform((-0.5, -0.5, 0), (0.5, 0.5, 3.1), (8, 3))
]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("factor", [0.25, 0.5, 1.5, 2.0])
def test_scaling_agrees_with_opencv(dtype, factor):
    image = noise((40, 48)).astype(dtype)
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
    peer = cv2.resize(image, None, fx=factor, fy=factor, interpolation=how)
    scaled = scale.to_working(image, factor)
    assert scaled.dtype == dtype
    assert np.abs(scaled.astype(np.int64) - peer).max() <= 1


def found(image: np.ndarray, refinement: object, **changes: object) -> Corners:
    rule = RingHarmonic(octaves=0)  # a working scale takes their place
    config = DetectorConfig(detection=rule, refinement=refinement, **changes)
    return reference.detect(image, config)


def one(image: np.ndarray, refinement: object, **changes: object) -> Corners:
    corners = found(image, refinement, **changes)
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
@pytest.mark.parametrize(
    ("opening", "scale"), [(90, None), (90, 0.7), (90, 1.5), (70, None), (110, None)]
)
def test_a_perfect_corner_is_found_where_it_is(refinement, method, bound, opening, scale):
    # A centroid is as exact as pixels of the working image, which are 1.4 px wide at 0.7.
    bound *= 1.5 if refinement is None and scale == 0.7 else 1
    for x, y, angle in PLACES:
        image = corner(x, y, angle, opening=math.radians(opening))
        corners = one(image, refinement, scale=scale)
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
