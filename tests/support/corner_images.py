"""Images of black and white corners at known positions, for tests."""

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.synthetic import boards

OVERSAMPLING = 8  # samples of a pixel, along each axis


def corner(x: float, y: float, angle: float, *, opening: float = math.pi / 2) -> NDArray[np.uint8]:
    """Return (41, 41): grey levels 40 and 200, divided by two lines through (x, y) at angle and at
    angle + opening, rad."""
    u = (np.arange(41 * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    sides = [
        (u[:, None] - y) * math.cos(a) - (u[None] - x) * math.sin(a)
        for a in (angle, angle + opening)
    ]
    fine = np.where(sides[0] * sides[1] > 0, 40.0, 200.0)
    fine = cv2.GaussianBlur(fine, (0, 0), 0.7 * OVERSAMPLING, borderType=cv2.BORDER_REPLICATE)
    grey = fine.reshape(41, OVERSAMPLING, 41, OVERSAMPLING).mean(axis=(1, 3))
    return np.rint(grey).astype(np.uint8)


@functools.cache
def board(
    rows: int,
    columns: int,
    cell: float,
    *,
    angle: float = 0.1,
    blur: float = 0.7,
    samples: int = OVERSAMPLING,
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return an image full of a rotated checkerboard, (rows, columns), and its corners that are at
    least 6 px inside, (N, 2) px.

    cell, blur: px. angle: rad. samples: of a pixel, along each axis.
    """
    camera = boards.plane(cell=cell, middle=(0, 0), about=(0.37, 0.21), turn=math.degrees(angle))
    size = rows, columns
    view = boards.drawn(camera, size, levels=(40, 200), blur=blur, noise=0, count=samples)
    view.image.flags.writeable = False  # all who ask for it share it
    return view.image, view.corners[boards.inside(view.corners, size, 6), :2]


def to_nearest(points: NDArray, others: NDArray) -> NDArray[np.float64]:
    """Return how far each point, (N, 2), is from the nearest of others, (M, 2)."""
    return np.linalg.norm(points[:, None] - others, axis=2).min(axis=1, initial=np.inf)


def from_nearest(points: NDArray, others: NDArray) -> NDArray[np.float64]:
    """Return the offset of each point, (N, 2), from the nearest of others, (M, 2)."""
    apart = points[:, None] - others
    nearest = np.linalg.norm(apart, axis=2).argmin(axis=1)
    return apart[np.arange(len(points)), nearest]


def grain(
    shape: tuple[int, int], smooth: float, seed: int | np.random.Generator = 0
) -> NDArray[np.float64]:
    """Return normal noise of variance 1 that neighbours share. smooth: px."""
    noise = np.random.default_rng(seed).normal(size=shape)
    noise = cv2.GaussianBlur(noise, (0, 0), smooth) if smooth else noise
    return noise / noise.std()


def noise(shape: tuple[int, int], seed: int = 0) -> NDArray[np.uint8]:
    """Return uniform noise over all grey levels."""
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
