"""Corners inside the cells of boards with dots, rings and codes."""

import dataclasses
import functools

import cv2
import numpy as np
import pytest
from corner_images import board

import cmp_cl
from cmp_cl import DetectorConfig, EdgeLines, Midlines, RingHarmonic
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.marks import drop_marks
from cmp_cl.synthetic import random_scene, render
from cmp_cl.synthetic.scoring import match

FINE = 8  # samples a pixel


@functools.cache
def marked(mark: str, cell: float = 24, shape: tuple[int, int] = (230, 300)):
    """Return a rotated board whose cells hold such marks, and its corners 6 px inside, (N, 2)."""
    rows, columns = shape
    y, x = ((np.arange(n * FINE) + 0.5) / FINE - 0.5 for n in shape)
    cos, sin = np.cos(0.2) / cell, np.sin(0.2) / cell
    u = cos * x[None] + sin * y[:, None] + 0.37
    v = cos * y[:, None] - sin * x[None] + 0.21
    black = (np.floor(u) + np.floor(v)) % 2 == 0
    across, down = u % 1 - 0.5, v % 1 - 0.5
    apart = np.hypot(across, down)
    within = np.maximum(abs(across), abs(down))
    marks = {
        "nothing": np.zeros_like(black),
        "dot": apart < 0.28,
        "ring": (apart < 0.32) & (apart > 0.18),
        "cross": (within < 0.32) & (np.minimum(abs(across), abs(down)) < 0.09),
        "code": (within < 0.36) & ((np.floor(across * 8) + np.floor(down * 8)) % 2 == 0) & ~black,
    }
    grey = np.where(black ^ marks[mark], 40, 200).astype(np.float32)
    grey = cv2.GaussianBlur(grey, (0, 0), 0.8 * FINE)
    image = cv2.resize(grey, (columns, rows), interpolation=cv2.INTER_AREA)
    i, j = np.meshgrid(np.arange(-30, 30), np.arange(-30, 30))
    place = np.stack([i.ravel() - 0.37, j.ravel() - 0.21], axis=1)
    place = place @ np.array([[cos, sin], [-sin, cos]]) * cell * cell
    inside = ((place >= 6) & (place <= (columns - 7, rows - 7))).all(axis=1)
    return np.rint(image).astype(np.uint8), place[inside]


def judged(corners: cmp_cl.Corners, truth: np.ndarray, shape: tuple[int, int]) -> tuple[int, int]:
    """Return how many corners are missed, and how many false ones lie inside, a cell or more from
    the edges of the image."""
    partner = match(corners.xy, truth, 3)
    other = corners.xy[partner < 0]
    far = ((other >= 24) & (other <= (shape[1] - 25, shape[0] - 25))).all(axis=1)
    return len(truth) - int((partner >= 0).sum()), int(far.sum())


@pytest.mark.parametrize("mark", ["dot", "ring", "cross", "code"])
def test_corners_in_cells_are_dropped_and_those_of_the_board_are_kept(mark, detector_for):
    image, truth = marked(mark)
    corners = detector_for(image)(image)
    missed, false = judged(corners, truth, image.shape)
    assert false >= 20
    assert judged(drop_marks(corners, image), truth, image.shape)[0] == missed == 0
    assert judged(drop_marks(corners, image), truth, image.shape)[1] <= false // 20


def test_inverse_and_mirrored_boards_lose_their_marks_too(detector_for):
    image, truth = marked("dot")
    inverse, mirrored = 255 - image, np.ascontiguousarray(image[:, ::-1])
    at_mirror = np.stack([image.shape[1] - 1 - truth[:, 0], truth[:, 1]], axis=1)
    for seen, where in ((inverse, truth), (mirrored, at_mirror)):
        kept = drop_marks(detector_for(seen)(seen), seen)
        assert judged(kept, where, image.shape) == (0, 0)


def test_16_bits_keep_the_corners_that_8_bits_keep(detector_for):
    image, _ = marked("ring")
    deep = image.astype(np.uint16) * 257
    there = drop_marks(detector_for(image)(image), image).pixel
    np.testing.assert_array_equal(drop_marks(detector_for(deep)(deep), deep).pixel, there)


def test_no_corner_of_a_plain_board_is_dropped(detector_for):
    for cell in (7, 12, 30):
        image, _ = board(150, 200, cell)
        corners = detector_for(image)(image)
        assert len(drop_marks(corners, image)) == len(corners) > 20


@pytest.mark.parametrize(("seed", "markers"), [(900_720, 20), (900_730, 30), (900_570, 44)])
def test_no_corner_of_a_torn_gel_is_dropped(seed, markers, detector_for):
    image = render(random_scene(seed, markers=markers, severity=1.75)).image
    corners = detector_for(image)(image)
    np.testing.assert_array_equal(drop_marks(corners, image).xy, corners.xy)


def test_edges_that_end_at_no_corner_span_no_cell(detector_for):
    image = np.kron([[40, 200], [200, 40]], np.ones((70, 70))).astype(np.uint8)
    image[20:52, 20:52] = np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.ones((8, 8))) * 160 + 40
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    corners = detector_for(image)(image)
    lone = np.argmin(np.abs(corners.xy - 69.5).sum(axis=1))
    assert np.abs(corners.xy[lone] - 69.5).max() < 0.1
    assert len(drop_marks(corners, image)) == len(corners) >= 10


def test_kept_corners_are_unchanged_in_every_field(detector_for):
    image, _ = marked("dot")
    corners = detector_for(image)(image)
    kept = drop_marks(corners, image)
    rank = {tuple(pixel): n for n, pixel in enumerate(corners.pixel)}
    rows = [rank[tuple(pixel)] for pixel in kept.pixel]
    assert rows == sorted(rows)
    for field in dataclasses.fields(corners):
        before, after = getattr(corners, field.name), getattr(kept, field.name)
        expected = before[rows] if isinstance(before, np.ndarray) else before
        np.testing.assert_array_equal(after, expected)


def test_an_image_without_corners_stays_without_corners(detector_for):
    flat = np.full((60, 70), 90, np.uint8)
    assert len(drop_marks(detector_for(flat)(flat), flat)) == 0


@pytest.mark.parametrize("refinement", [None, Midlines()])
def test_corners_without_edges_are_refused(refinement, detector_for):
    image, _ = marked("dot")
    corners = detector_for(image, DetectorConfig(refinement=refinement))(image)
    with pytest.raises(ConfigError, match="no edges: detect them with refinement EdgeStep"):
        drop_marks(corners, image)


def test_edge_lines_are_enough(detector_for):
    image, truth = marked("dot")
    corners = detector_for(image, DetectorConfig(refinement=EdgeLines()))(image)
    assert judged(drop_marks(corners, image), truth, image.shape) == (0, 0)


@pytest.mark.parametrize("scale", [0.6, 2.0])
def test_corners_of_a_working_scale_lose_their_marks_too(scale, detector_for):
    image, truth = marked("dot")
    corners = detector_for(image, DetectorConfig(detection=RingHarmonic(octaves=0), scale=scale))(
        image
    )
    before, after = (
        judged(each, truth, image.shape) for each in (corners, drop_marks(corners, image))
    )
    assert after[0] == before[0]
    assert after[1] <= before[1] // 20


def test_another_image_is_refused(detector_for):
    image, _ = marked("dot")
    corners = detector_for(image)(image)
    with pytest.raises(ImageError, match="not of this image"):
        drop_marks(corners, image[:100])
    with pytest.raises(ImageError, match=r"of uint8 or uint16, got shape \(230, 300\)"):
        drop_marks(corners, image.astype(np.float32))
