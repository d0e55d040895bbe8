"""Checkerboards seen from the front, moved by a known map of the plane."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

Map = Callable[[NDArray[np.float64]], NDArray[np.float64]]

_SAMPLES = 4  # of a pixel, along each axis


def moved_board(
    shape: tuple[int, int],
    cell: float,
    displacement: Map,
    *,
    board: tuple[float, float, float, float] | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> NDArray[np.uint8]:
    """Return a checkerboard whose point q at rest appears at q + displacement(q), px.

    board: (x0, y0, x1, y1) of the pattern at rest, px; it is grey around it. None means that the
    pattern is everywhere. Its corners lie at whole multiples of the cell, px. noise: standard
    deviation, grey levels.
    """
    rows, columns = shape
    across = (np.arange(columns * _SAMPLES) + 0.5) / _SAMPLES - 0.5
    down = (np.arange(rows * _SAMPLES) + 0.5) / _SAMPLES - 0.5
    seen = np.stack(np.meshgrid(across, down), axis=-1)
    rest = seen
    for _ in range(60):
        rest = seen - displacement(rest)
    # Edges are as soft as a sample is wide; hard ones would move to the raster of the samples.
    phase = rest / cell % 2
    to_edge = cell * np.select([phase < 0.5, phase < 1.5], [phase, 1 - phase], phase - 2)
    image = 125.0 - 85.0 * np.clip(2 * _SAMPLES * to_edge, -1, 1).prod(axis=-1)
    if board is not None:
        inside = (rest >= board[:2]).all(axis=-1) & (rest < board[2:]).all(axis=-1)
        image[~inside] = 125.0
    image = cv2.GaussianBlur(image, (0, 0), 0.7 * _SAMPLES)
    small = image.reshape(rows, _SAMPLES, columns, _SAMPLES).mean(axis=(1, 3))
    small += np.random.default_rng(seed).normal(0, noise, shape) if noise else 0
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)
