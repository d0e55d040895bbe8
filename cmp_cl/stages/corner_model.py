"""The moments of EDGE_STEP's corner model, which depend on its radius and on the edges' angle."""

import functools
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeStep

STEP_RADIUS = (0.75, 4.5, 9.0)  # of EDGE_STEP's disc: cells, and its least and largest px
BLUR = 1.2  # px, of the model's edges
NARROW = 1e-3  # rad: used in place of 0
ANGLES = 256  # enough for float32


def step_radius(refinement: EdgeStep) -> float:
    """Return the radius of EDGE_STEP's disc, px of the image."""
    share, least, most = STEP_RADIUS
    return min(max(share * refinement.cell, least), most)


@functools.lru_cache(maxsize=8)
def moments(radius: float) -> NDArray[np.float32]:
    """Return the table of kernels/corner_model.clh, (ANGLES + 1, 2, 8) float32.

    radius: of the disc, px. Entry k is of half an angle between the normals whose sine is larger
    than its cosine by 2 k / ANGLES - 1; the axes are s and t. The slope along an axis is divided
    by the square of that cosine, or of that sine, so that it stays finite and smooth.

    In polar coordinates: Gauss-Legendre along the radius, equal angles in a quadrant, as P is even
    in s and in t.
    """
    count = math.ceil(2 * radius) + 8
    node, part = np.polynomial.legendre.leggauss(count)
    flat = math.sqrt(0.75)  # share of the radius at which the weight begins to fall
    r = radius * np.concatenate([flat * (node + 1), 1 + flat + (1 - flat) * node]) / 2
    ring = radius * np.concatenate([flat * part, (1 - flat) * part]) / 2 * r
    direction = (np.arange(count)[:, None] + 0.5) * (math.pi / 2 / count)
    s, t = (r * np.cos(direction)).ravel(), (r * np.sin(direction)).ravel()
    w = np.tile(np.clip(4 * (1 - (r / radius) ** 2), 0, 1) * ring * (2 * math.pi / count), count)
    table = np.zeros((ANGLES + 1, 2, 8))
    for entry, difference in zip(table, np.linspace(-1, 1, ANGLES + 1), strict=True):
        half = math.asin(difference / math.sqrt(2)) + math.pi / 4
        half = min(half, math.pi / 2 - NARROW)
        near, far = math.cos(half) / BLUR * s, math.sin(half) / BLUR * t
        a, b = near + far, near - far
        by_a, by_b = 1 / np.sqrt(1 + a * a), 1 / np.sqrt(1 + b * b)
        f, g = a * by_a, b * by_b
        slope = (by_a**3 * g + f * by_b**3) / (BLUR * math.cos(half))
        columns = np.stack([slope, s, f * g * s])
        entry[0, :6] = ((w * columns) @ columns.T)[np.triu_indices(3)]
    # If the other normal is reversed, s and t are exchanged and P changes its sign.
    table[:, 1, :6] = table[::-1, 0, :6] * [1, -1, 1, 1, -1, 1]
    return table.astype(np.float32)
