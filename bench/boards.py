"""Boards that are drawn: sharp or blurred, with ink that spreads, noise, steep light, JPEG."""

import math

import cv2
import numpy as np
from scenes import View

from cmp_cl.image import GreyImage
from cmp_cl.synthetic.boards import corners_in, inside, samples

SHAPE = (480, 640)
SAMPLES = 3  # of a pixel, along each axis
BLACK, WHITE = 40.0, 200.0
MARGIN = 12  # px from the border, or .6 cells: nearer corners are not scored


def view(image: GreyImage, truth: np.ndarray, cell: float) -> View:
    """Return an image full of cells; corners and detections near its border do not count."""
    margin = max(MARGIN, 0.6 * cell)
    y, x = (
        np.minimum(each, n - 1 - each) for each, n in zip(np.indices(SHAPE), SHAPE, strict=True)
    )
    away = inside(truth, SHAPE, margin)
    return View(
        image,
        truth[away],
        cell,
        region=np.minimum(x, y) >= margin,
        ignored=truth[~away],
        within=min(max(3.0, 0.1 * cell), cell / 3),  # halved frames are less exact
    )


def board(
    cell: float,
    *,
    angle: float = 0.1,
    tilt: float = 0.0,
    blur: float = 0.7,
    ink: float = 0.0,
    start: tuple[float, float] = (0.37, 0.21),
) -> tuple[np.ndarray, np.ndarray]:
    """Return the reflectance of a board, (H, W) 0 to 1, and its corners.

    cell, blur: px. tilt: by how much cells shrink from the left side to the right. ink: px by which
        black squares grow, or shrink if it is negative.
    """
    cos, sin = math.cos(angle) / cell, math.sin(angle) / cell

    def camera(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        depth = 1 + tilt * (x / SHAPE[1] - 0.5)
        u, v = (x - SHAPE[1] / 2) * depth, (y - SHAPE[0] / 2) * depth
        return cos * u + sin * v + start[0], cos * v - sin * u + start[1]

    at = np.stack(camera(*samples(SHAPE, SAMPLES)))
    edge = np.abs(at - np.rint(at)) * cell * SAMPLES  # samples to an edge, along both axes
    side = np.where(np.floor(at) % 2, 1, -1) * np.minimum(2 * edge, 1)  # an edge is a sample wide
    grey = (1 - side[0] * side[1]) / 2
    if ink:
        inked = np.clip(abs(ink) * SAMPLES - edge.min(axis=0) + 0.5, 0, 1)
        grey += inked * (float(ink < 0) - grey)
    grey = cv2.GaussianBlur(grey, (0, 0), max(blur, 0.4) * SAMPLES, borderType=cv2.BORDER_REPLICATE)
    grey = grey.reshape(SHAPE[0], SAMPLES, SHAPE[1], SAMPLES).mean(axis=(1, 3))
    return grey, corners_in(camera, SHAPE)[:, :2]


def photographed(
    reflectance: np.ndarray,
    rng: np.random.Generator,
    *,
    noise: float = 0.0,
    correlation: float = 0.0,
    light: float = 1.0,
    exposure: float = 1.0,
    quality: int | None = None,
) -> GreyImage:
    """Return the grey levels of a reflectance.

    noise: standard deviation, grey levels. correlation: px that the noise is smoothed by.
        light: the least over the most; it falls from corner to corner. quality: of JPEG.
    """
    rows, columns = reflectance.shape
    y, x = np.indices(reflectance.shape)
    fall = light ** ((x / columns + y / rows) / 2)
    grey = (BLACK + (WHITE - BLACK) * reflectance) * fall * exposure
    grain = rng.normal(size=reflectance.shape)
    if correlation:
        grain = cv2.GaussianBlur(grain, (0, 0), correlation)
    image = np.clip(np.rint(grey + noise * grain / grain.std()), 0, 255).astype(np.uint8)
    if quality is not None:
        _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
    return image


def cluttered(rng: np.random.Generator, reflectance: np.ndarray) -> np.ndarray:
    """Return the reflectance with a wall instead of its right half, and shapes, bars and words on
    it."""
    scene = np.full(SHAPE, rng.integers(0, 256), np.uint8)
    for _ in range(rng.integers(20, 60)):
        grey, size = int(rng.integers(0, 256)), int(rng.integers(4, 120))
        x, y = (int(rng.integers(0, n)) for n in SHAPE[::-1])
        kind = rng.integers(4)
        if kind == 0:
            corners = np.add(rng.normal(0, size / 2, (5, 2)), (x, y)).astype(np.int32)
            cv2.fillConvexPoly(scene, cv2.convexHull(corners), grey, cv2.LINE_AA)
        elif kind == 1:
            axes = (size, int(rng.integers(3, 60)))
            cv2.ellipse(scene, (x, y), axes, rng.uniform(0, 180), 0, 360, grey, -1, cv2.LINE_AA)
        elif kind == 2:
            end = (x + int(rng.integers(-200, 200)), y + int(rng.integers(-200, 200)))
            cv2.line(scene, (x, y), end, grey, int(rng.integers(2, 20)), cv2.LINE_AA)
        else:
            word, scale = "".join(rng.choice(list("AKXMW4&%#"), 6)), rng.uniform(0.5, 4)
            cv2.putText(scene, word, (x, y), 0, scale, grey, int(scale * 3), cv2.LINE_AA)
    soft = cv2.GaussianBlur(scene / 255, (0, 0), rng.choice([0.7, 1.5, 4]))
    return np.hstack([reflectance[:, : SHAPE[1] // 2], soft[:, SHAPE[1] // 2 :]])


def drawn(seed: int) -> tuple[View, list[str]]:
    """Return a board of drawn cells (8 to 200 px), blur, ink, noise, light and compression, and
    which of these are strong."""
    rng = np.random.default_rng(seed)
    cell = math.exp(rng.uniform(math.log(8), math.log(200)))
    blur = min(rng.exponential(1.5) + 0.4, 8.0, cell / 5)
    ink = cell * rng.uniform(-0.1, 0.1) if rng.random() < 0.5 else 0.0
    reflectance, truth = board(
        cell,
        angle=rng.uniform(0, math.pi / 2),
        tilt=rng.uniform(-0.3, 0.3),
        blur=blur,
        ink=ink,
        start=(rng.random(), rng.random()),
    )
    clutter = rng.random() < 0.3
    if clutter:
        reflectance = cluttered(rng, reflectance)
        truth = truth[truth[:, 0] < SHAPE[1] // 2]
    exposure, light = rng.choice([0.3, 1, 1, 1.5]), rng.choice([1, 0.4, 0.15])
    noise = min(rng.choice([0, 0.02, 0.05, 0.1]), light / 4)
    image = photographed(
        reflectance,
        rng,
        noise=noise * (WHITE - BLACK) * exposure,
        correlation=rng.choice([0, 0, 0.7, 1.5, 3]),
        light=light,
        exposure=exposure,
        quality=rng.choice([None, None, 90, 60, 30]),
    )
    strong = {
        "spread ink": ink != 0,
        "noise, wide": noise > 0.03 and cell >= 40 and not clutter,
        "noise": noise > 0.03,
        "clutter": clutter,
        "cells under 20 px": cell < 20,
    }
    return view(image, truth, cell), [name for name, true in strong.items() if true]
