"""Flat boards of squares, seen by any camera and drawn with exact truth.

A pattern has coordinates (u, v) in cells: node (row r, column c) is at (c, r), and the squares of a
board reach a cell beyond its nodes. A camera is the map from pixels (x, y) to them.
"""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage
from cmp_cl.synthetic.raster import Array, Image, samples
from cmp_cl.synthetic.rendering import newton, render
from cmp_cl.synthetic.scene import Scene

Mask = NDArray[np.bool_]
Camera = Callable[[Array, Array], tuple[Array, Array]]
Mark = Callable[[Array, Array, Array, Array], Mask]

BLACK, WHITE = 45.0, 205.0  # grey levels of a print
_PERIOD = 64  # cells, after which the printing errors repeat


class View(NamedTuple):
    """An image, its corners (N, 4): x, y, row, column; and the whole pattern's rows and columns,
    (0, 0) without an end. cell: px. bits: of the camera."""

    image: GreyImage
    corners: Array
    shape: tuple[int, int]
    cell: float
    bits: int = 8


# cameras


def homography(matrix: Array) -> Camera:
    """Return the camera of a plane. matrix: (3, 3), from cells to pixels.

    Beyond the plane's horizon nothing is seen: NaN.
    """
    back = np.linalg.inv(matrix)

    def to_cells(x: Array, y: Array) -> tuple[Array, Array]:
        u, v, scale = np.tensordot(back, [x, y, np.ones_like(x)], 1)
        scale = np.where(scale > 0, scale, np.nan)
        return u / scale, v / scale

    return to_cells


def plane(
    *,
    cell: float,
    middle: tuple[float, float],
    about: tuple[float, float] = (0.0, 0.0),
    turn: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """Return a pinhole before a plane. middle: px, where the pattern's point `about` is seen.

    turn: degrees. tilt: the perspective, 1/px.
    """
    a, b = cell * np.cos(np.deg2rad(turn)), cell * np.sin(np.deg2rad(turn))
    moved = np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]])
    lean, shift, start = np.eye(3), np.eye(3), np.eye(3)
    lean[2, :2], shift[:2, 2], start[:2, 2] = tilt, middle, (-about[0], -about[1])
    return homography(shift @ lean @ moved @ start)


# pictures


def covered(u: Array, v: Array, shape: tuple[int, int], margin: float = 0.0) -> Mask:
    """Return which points lie on the squares of a board, or so many cells beside them."""
    rows, columns = shape
    inside: Mask = (u > -1 - margin) & (u < columns + margin)
    return inside & (v > -1 - margin) & (v < rows + margin)


def corners_in(camera: Camera, size: tuple[int, int], shape: tuple[int, int] = (0, 0)) -> Array:
    """Return the corners (N, 4) that an image of that size shows: x, y, row, column.

    Newton's method starts at the pixel nearest to each.
    """
    x, y = (each.ravel() for each in samples(size))
    u, v = camera(x, y)
    column, row = np.rint(u), np.rint(v)
    known = np.isfinite(u + v)
    if shape != (0, 0):
        known &= (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    every = np.stack([x, y, row, column, np.hypot(u - column, v - row)], axis=1)[known]
    every = every[np.lexsort(every.T[[4, 3, 2]])]
    first = np.ones(len(every), np.bool_)
    first[1:] = (every[1:, 2:4] != every[:-1, 2:4]).any(axis=1)
    nearest = every[first]
    xy = newton(lambda at: np.stack(camera(*at.T), axis=1), nearest[:, 3:1:-1], nearest[:, :2])
    seen = np.concatenate([xy, nearest[:, 2:4]], axis=1)
    return seen[inside(seen, size)]


def inside(corners: Array, size: tuple[int, int], margin: float = 0) -> Mask:
    """Return which corners lie in an image of that size, so many px from its edge."""
    xy, last = corners[:, :2], np.array(size[::-1]) - 1
    return np.asarray(((xy >= margin) & (xy <= last - margin)).all(axis=1))


def cell_of(corners: Array) -> float:
    """Return the median distance of corners that are neighbours in a row, px."""
    by = {(row, column): (x, y) for x, y, row, column in corners.tolist()}
    apart = [np.subtract(by[r, c + 1], xy) for (r, c), xy in by.items() if (r, c + 1) in by]
    return float(np.median(np.hypot(*np.transpose(apart)))) if apart else float("nan")


def drawn(
    camera: Camera,
    size: tuple[int, int],
    shape: tuple[int, int] = (0, 0),
    *,
    levels: tuple[float, float] = (BLACK, WHITE),
    margin: float = 1.0,
    ground: Image | float = 110.0,
    front: Image | float = np.nan,
    mark: Mark | None = None,
    wear: float = 0.0,
    sheet: int = 77,
    blur: float = 0.7,
    noise: float = 2.0,
    seed: int | np.random.Generator = 0,
    bits: int = 8,
    count: int = 2,
) -> View:
    """Return the view of a board of that shape, or of a pattern without an end.

    size: (H, W). levels: grey levels, of 255, of the print. margin: paper around the squares,
        cells. ground, front: what is behind the board, and before it where it is not NaN: grey
        levels, one, or an array with one or `count` samples a pixel.
    mark: which points of a square have the other colour: from (u, v) from its middle, and its row
        and column. wear: standard deviation of the printing errors, cells, from the seed `sheet`.
    blur: standard deviation, px. noise: grey levels of 255. count: samples a pixel.
    """
    u, v = camera(*samples(size, count))
    if wear:
        u, v = _worn(u, v, wear, sheet)
    column, row = np.floor(u), np.floor(v)
    white = (row + column) % 2 != 0
    if mark is not None:
        white ^= mark(u - column - 0.5, v - row - 0.5, row, column)
    level = np.where(white, levels[1], levels[0])
    if shape != (0, 0):
        paper = np.where(covered(u, v, shape, margin), levels[1], _spread(ground, size, count))
        level = np.where(covered(u, v, shape), level, paper)
    before = _spread(front, size, count)
    level = np.where(np.isnan(before), level, before).astype(np.float32)
    small: Image = cv2.resize(level, size[::-1], interpolation=cv2.INTER_AREA)
    if blur:
        small = cv2.GaussianBlur(small, (0, 0), blur)
    small = small + noise * np.random.default_rng(seed).standard_normal(size)
    high = 2**bits - 1
    image = np.clip(np.rint(small * (high / 255)), 0, high).astype(f"u{(bits + 7) // 8}")
    seen = corners_in(camera, size, shape)
    return View(image, seen, shape, cell_of(seen), bits)


def _spread(level: Image | float, size: tuple[int, int], count: int) -> Image:
    """Return grey levels at each sample."""
    level = np.asarray(level, np.float64)
    if level.shape == size:
        return np.kron(level, np.ones((count, count)))
    return np.broadcast_to(level, (size[0] * count, size[1] * count))


def _worn(u: Array, v: Array, wear: float, sheet: int) -> tuple[Array, Array]:
    """Return the points moved by printing errors, which are linear within cells."""
    error = np.random.default_rng(sheet).normal(0, wear, (_PERIOD, _PERIOD, 2)).astype(np.float32)
    error = np.pad(error, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    at_u, at_v = (np.asarray(each % _PERIOD, np.float32) for each in (u, v))
    off = cv2.remap(error, at_u, at_v, cv2.INTER_LINEAR)
    return u + off[..., 0], v + off[..., 1]


def gel(scene: Scene) -> View:
    """Return the view of a rendered gel."""
    shot = render(scene)
    number = np.indices(shot.truth.shape[:2]).transpose(1, 2, 0)
    corners = np.concatenate([shot.truth, number], axis=2).reshape(-1, 4)
    return View(shot.image, corners, shot.truth.shape[:2], shot.cell, scene.bits)
