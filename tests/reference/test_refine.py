"""Refinement of the oracle on perfect corners at known positions."""

import math

import cv2
import numpy as np
import pytest
from corner_images import board, corner, noise, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, EdgeLines, EdgeStep, Fit, Midlines, RingHarmonic
from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.reference import edge_step, edges, refine

RNG = np.random.default_rng(11)
PLACES = [
    (20 + dx, 20 + dy, a) for dx, dy, a in RNG.uniform((-0.5, -0.5, 0), (0.5, 0.5, 3.1), (8, 3))
]


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
@pytest.mark.parametrize("scale", [None, 0.7, 1.5])
def test_a_perfect_corner_is_found_where_it_is(refinement, method, bound, scale):
    # A centroid is as exact as pixels of the working image, which are 1.4 px wide at 0.7.
    bound *= 1.5 if refinement is None and scale == 0.7 else 1
    for x, y, angle in PLACES:
        corners = one(corner(x, y, angle), refinement, scale=scale)
        assert math.dist(corners.xy[0], (x, y)) < bound
        assert corners.method[0] == method


@pytest.mark.parametrize("opening", [70, 110])
def test_a_slanted_corner_is_found_where_it_is(opening):
    for x, y, angle in PLACES:
        image = corner(x, y, angle, opening=math.radians(opening))
        assert math.dist(one(image, EdgeLines()).xy[0], (x, y)) < 0.08
        assert math.dist(one(image, EdgeStep()).xy[0], (x, y)) < 0.03


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


def test_a_step_brings_edge_lines_nearer_to_the_truth():
    image, truth = board(150, 160, 11)
    errors = {}
    for refinement in (EdgeLines(), EdgeStep(cell=11)):
        corners = found(image, refinement)
        distance = to_nearest(truth, corners.xy)
        assert distance.max() < 0.2
        errors[type(refinement)] = np.sqrt((distance**2).mean())
    assert errors[EdgeStep] < errors[EdgeLines] / 2 < 0.02


@pytest.mark.parametrize("refinement", [EdgeLines(), EdgeStep(cell=11)], ids=["lines", "step"])
def test_sigma_grows_with_noise(refinement):
    rng = np.random.default_rng(4)
    image, truth = board(120, 130, 11)
    medians = []
    for level in (0, 4, 12):
        noisy = np.clip(np.rint(image + rng.normal(0, level, image.shape)), 0, 255)
        corners = found(noisy.astype(np.uint8), refinement)
        distance = to_nearest(corners.xy, truth)
        inside = distance < 1
        medians.append(float(np.nanmedian(corners.sigma[inside])))
        if level == 12:
            error = np.sqrt((distance[inside] ** 2).mean() / 2)
            assert 0.5 < error / medians[-1] < 2
    assert medians == sorted(medians)


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


@pytest.mark.parametrize("refinement", [EdgeLines(), EdgeStep(), Midlines()])
def test_corners_whose_refinement_is_rejected_keep_their_centroid(refinement):
    grain = cv2.GaussianBlur(np.random.default_rng(5).normal(0, 160, (120, 140)), (0, 0), 1.5)
    image = np.clip(128 + grain, 0, 255).astype(np.uint8)
    refined, plain = found(image, refinement), found(image, None)
    kept = refined.method == Method.KEPT
    assert 0 < kept.sum() < len(kept)
    assert (refined.refusal[kept] != Refusal.NONE).all()
    np.testing.assert_array_equal(refined.xy[kept], plain.xy[kept])
    assert np.isnan(refined.sigma[kept]).all()
    assert np.isnan(plain.edges).all()


@pytest.mark.parametrize("kind", [EdgeLines, Midlines])
def test_a_corner_that_would_move_farther_than_asked_keeps_its_centroid(kind):
    kept = one(corner(20.3, 20.4, 0.7), kind(max_shift=0))
    assert kept.method[0] == Method.KEPT


def at_centre(image: np.ndarray, refinement: object) -> refine.Refined:
    height, width = image.shape
    start = np.array([[width // 2, height // 2]])
    return refine.refine(image, start, start + 0.25, refinement, 1.0)


@pytest.mark.parametrize(
    "refinement", [EdgeLines(), EdgeStep(), Midlines(), Midlines(fit=Fit.QUADRATIC)]
)
@pytest.mark.parametrize(
    "image",
    [
        np.full((21, 21), 9, np.uint8),
        np.tile(np.repeat(np.array([0, 255], np.uint8), 3), (21, 4)),
        np.tile(np.arange(0, 210, 10, dtype=np.uint8), (21, 1)),
        noise((21, 21), seed=5),
    ],
    ids=["flat", "stripes", "ramp", "noise"],
)
def test_no_position_is_nan(image, refinement):
    result = at_centre(image, refinement)
    assert np.isfinite(result.xy).all()
    assert np.linalg.norm(result.xy - np.array(image.shape[::-1]) // 2) < 2.5
    if result.method[0] == Method.KEPT:
        assert (result.xy == np.array(image.shape[::-1]) // 2 + 0.25).all()


def rays(angles: list[float]) -> edges.EdgePoints:
    """Return edge points where four rays from the start meet circles of 3, 4 and 5 px."""
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    point = np.array([3.0, 4.0, 5.0])[:, None, None] * unit
    return edges.EdgePoints(
        point=point[None],
        valid=np.ones((1, 3), np.bool_),
        direction=3 * unit[None],
        margin=np.full(1, np.inf),
    )


def model(x: float, y: float, angles: tuple[float, float]) -> np.ndarray:
    """Return (41, 41) uint16: the corner model itself, black between the two directions."""
    row, column = np.mgrid[0:41, 0:41].astype(np.float64)
    sides = []
    for angle in angles:
        a = ((row - y) * math.cos(angle) - (column - x) * math.sin(angle)) / 1.2
        sides.append(a / np.sqrt(1 + a * a))
    return np.rint(30000 + 28000 * sides[0] * sides[1]).astype(np.uint16)


def columns_of_step(
    ux: np.ndarray, uy: np.ndarray, angles: tuple[float, float], radius: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return weight (N,), P (N,) and its slopes along x and y (N, 2) at offsets (N,)."""
    normals = np.array([(-math.sin(angle), math.cos(angle)) for angle in angles])
    a, b = normals @ np.stack([ux, uy]) / 1.2
    f, g = a / np.hypot(1, a), b / np.hypot(1, b)
    weight = np.clip(4 * (1 - (ux**2 + uy**2) / radius**2), 0, 1)
    slopes = np.stack([g / np.hypot(1, a) ** 3, f / np.hypot(1, b) ** 3], axis=1) / 1.2
    return weight, f * g, slopes @ normals


def step_by_least_squares(
    image: np.ndarray, start: int, x: np.ndarray, angles: tuple[float, float], radius: float
) -> tuple[np.ndarray, float]:
    """Return the step and the trace of its covariance with a general solver.

    Terms without the image are summed over 16 x 16 points per pixel, for an integral.
    """
    offset = np.arange(-12, 13)
    dx, dy = (each.ravel() for each in np.meshgrid(offset, offset))
    weight, p, slopes = columns_of_step(dx - x[0], dy - x[1], angles, radius)
    grey = image[start + dy, start + dx].astype(np.float64)
    root = np.sqrt(weight)
    m, c = np.linalg.lstsq(root[:, None] * np.stack([p * 0 + 1, p], axis=1), root * grey)[0]
    residual = grey - m - c * p
    ratio = c / max(m, abs(c))

    def system(ux, uy, p, slopes):
        light = np.stack([ux, uy], axis=1) * (1 + ratio * p)[:, None]
        return np.concatenate([-c * slopes, light], axis=1)

    right = system(dx - x[0], dy - x[1], p, slopes).T @ (weight * residual)
    fine = (np.arange(-12 * 16, 12 * 16) + 0.5) / 16
    ux, uy = (each.ravel() for each in np.meshgrid(fine, fine))
    fine_weight, fine_p, fine_slopes = columns_of_step(ux, uy, angles, radius)
    whole = system(ux, uy, fine_p, fine_slopes)
    matrix = whole.T @ (fine_weight[:, None] * whole) / 16**2

    # A free fit first: how much the gradient of the light improves it, and the noise that is left.
    free, edges = np.linalg.solve(matrix, right), np.linalg.solve(matrix[:2, :2], right[:2])
    gained = right @ free - right[:2] @ edges
    noise = ((weight * residual**2).sum() - right @ free) / weight.sum()
    surely = max(0, 1 - 9 * noise / gained)
    expected = (1e-3 * max(m, abs(c))) ** 2 + surely * (free[2:] ** 2).sum() / 2
    held = matrix + np.diag([0, 0, noise / expected, noise / expected])
    fitted = np.linalg.solve(held, right)

    square = (len(offset), len(offset))
    w = weight.reshape(square)
    r = np.where(w > 0, residual.reshape(square), 0)
    right_of, left_of = (np.roll(r, step, axis=1) for step in (-1, 1))
    alike = (w * r * right_of).sum()
    opposite = (w * r * (right_of + left_of)[::-1, ::-1]).sum() / 2
    rho2 = ((weight * residual**2).sum() - alike) / weight.sum()
    by_light = 2 * fitted[2:] @ right[2:] - fitted[2:] @ matrix[2:, 2:] @ fitted[2:]
    odd = ((alike - opposite) / 2 - by_light) / weight.sum() / c**2
    variance = np.trace(np.linalg.inv(held)[:2, :2]) * rho2
    return fitted[:2], variance / 2 + 1000 * max(odd, 0) ** 2


@pytest.mark.parametrize("cell", [6, 9, 12])
@pytest.mark.parametrize("light", [0.0, 0.02])
def test_a_step_is_weighted_least_squares(cell, light):
    angles = (0.2, 1.5)
    across = 1 + light * (np.arange(41) - 20)
    rough = (model(20.1, 19.9, angles) // 64 * across).astype(np.uint16)
    image = (rough + noise(rough.shape, seed=cell) // 4).astype(np.uint16)
    start, shift = np.array([[20, 20]]), np.array([[0.04, -0.05]])
    radius = min(max(0.75 * cell, 4.5), 9)
    step, variance = step_by_least_squares(image, 20, shift[0], angles, radius)
    points = rays([*angles, angles[0] + math.pi, angles[1] + math.pi])
    found = edge_step.edge_step(image, start, shift, points, EdgeStep(cell=cell), 1.0)
    np.testing.assert_allclose(found.position, shift + step, rtol=1e-3)
    expected = edge_step.STEP_ERROR**2 + variance
    np.testing.assert_allclose(found.variance, expected, rtol=1e-3)
