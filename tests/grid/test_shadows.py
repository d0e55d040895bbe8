"""A shadow across a board takes no corner at its rim."""

import cv2
import numpy as np
import pytest

from cmp_cl import DetectorConfig, build_grid, detect

CELL = 24  # px
ROWS, COLUMNS = 6, 8  # inner corners


def shadowed(place: float, slope: float, light: float, soft: float) -> np.ndarray:
    """Draw a board with a shadow on its right.

    place: where the shadow begins in the first row, cells from the first column of corners.
    slope: columns by which its edge moves per row. light: share of the light in the shadow.
    soft: standard deviation of its edge, px.
    """
    row, column = np.indices((ROWS + 1, COLUMNS + 1))
    cells = np.where((row + column) % 2, 210.0, 40.0)
    board = np.pad(np.kron(cells, np.ones((CELL, CELL))), 2 * CELL, constant_values=210)
    y, x = np.indices(board.shape) / CELL - 3
    shade = np.where(x - slope * y > place, light, 1.0)
    image = cv2.GaussianBlur(board, (0, 0), 0.8) * cv2.GaussianBlur(shade, (0, 0), soft)
    noise = np.random.default_rng(760100).normal(0, 2, image.shape)
    return (image + noise).clip(0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("soft", [0.7, 4.0])
@pytest.mark.parametrize("light", [0.25, 0.4])
@pytest.mark.parametrize(("place", "slope"), [(3.3, 0.0), (0.2, 0.0), (2.6, 0.3), (6.6, 0.0)])
def test_every_corner_that_is_found_in_a_shadow_is_a_node(place, slope, light, soft):
    image = shadowed(place, slope, light, soft)
    corners = detect(image, DetectorConfig.for_cell(CELL))
    grid = build_grid(corners, image)
    row, column = np.indices((ROWS, COLUMNS))
    truth = np.stack([column, row], axis=-1) * CELL + 3 * CELL - 0.5
    away = np.linalg.norm(corners.xy[:, None] - truth.reshape(-1, 2), axis=2)
    seen = away.min(axis=0) < 2
    kept = np.linalg.norm(grid.xy[grid.valid][:, None] - truth.reshape(-1, 2), axis=2)
    assert seen.mean() > 0.9
    assert (kept.min(axis=0) < 2)[seen].all()
    assert (kept.min(axis=1) < 2).all()
