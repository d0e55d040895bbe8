"""Photographs as another lens, light or camera would have shown them, or a hand before the board.

Truth moves with the image. What is changed, and how much, is drawn from a seed for each view.
"""

import functools
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from environment import DATA
from scenes import View, photograph

from cmp_cl.synthetic import boards

FOLDERS = ("puzzleboard", "curved", "stereo_opencv", "stereo_bumblebee2")
BESIDE = 110  # grey level where a warped photograph does not reach
NARROWEST = 8.0  # px, cells after a zoom
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]  # of grey levels, float64


def each(
    change: Callable[[View, np.random.Generator], View], seed: int, count: int
) -> Iterator[View]:
    """Yield the photographs in turn, each changed by its own draw."""
    names = [
        f"{folder}/{path.stem}"
        for folder in FOLDERS
        for path in sorted((DATA / folder).glob("*.json"))
    ]
    for number in range(count if names else 0):
        view = photograph(names[number % len(names)])
        nowhere = np.zeros(view.image.shape, np.bool_)
        known = view if view.region is not None else view._replace(region=nowhere)
        yield change(known, np.random.default_rng(seed + number))


def warped(view: View, draw: np.random.Generator) -> View:
    """Turn, zoom and tilt a view."""
    rows, columns = view.image.shape
    zoom = max(np.exp(draw.uniform(np.log(0.5), np.log(2.5))), NARROWEST / view.cell)
    turn = np.exp(1j * draw.uniform(0, 2 * np.pi))
    ends = np.array([0, columns, columns + 1j * rows, 1j * rows])
    seen = zoom * turn * ends + zoom * columns * 0.1 * (draw.uniform(-1, 1, (2, 4)).T @ [1, 1j])
    seen -= complex(seen.real.min(), seen.imag.min())
    size = int(seen.real.max()) + 1, int(seen.imag.max()) + 1
    flat, there = (np.stack([z.real, z.imag], axis=1).astype(np.float32) for z in (ends, seen))
    matrix = cv2.getPerspectiveTransform(flat, there)
    soft = cv2.GaussianBlur(view.image, (0, 0), 0.4 / zoom) if zoom < 1 else view.image
    border = {"borderMode": cv2.BORDER_CONSTANT}
    image = cv2.warpPerspective(
        soft, matrix, size, flags=cv2.INTER_CUBIC, borderValue=BESIDE, **border
    )
    assert view.region is not None
    mask = view.region.astype(np.uint8)
    region = cv2.warpPerspective(mask, matrix, size, flags=cv2.INTER_NEAREST, **border) > 0
    xy = cv2.perspectiveTransform(view.truth[:, None, :2].astype(np.float64), matrix)[:, 0]
    truth = np.hstack([xy, view.truth[:, 2:]])
    return View(image, truth[boards.inside(truth, image.shape)], zoom * view.cell, None, region)


def _across(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    """Return the distance of each pixel along a drawn direction, 0 in the middle, px."""
    y, x = np.indices(image.shape) - np.array(image.shape)[:, None, None] / 2
    angle = draw.uniform(0, 2 * np.pi)
    return x * np.cos(angle) + y * np.sin(angle)


def shadow(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    left, soft = 1 / draw.uniform(2, 6), draw.uniform(1, 15)
    far = np.clip(_across(image, draw) + draw.uniform(-0.1, 0.1) * image.shape[1], -500, 500)
    return image * (left + (1 - left) / (1 + np.exp(-far / soft)))


def ramp(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    far = _across(image, draw)
    return image * draw.uniform(3, 12) ** ((far - far.max()) / np.ptp(far))


def glare(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    y, x = np.indices(image.shape) / image.shape[1]
    at, wide = (
        draw.uniform(0.3, 0.7, 2) * [1, image.shape[0] / image.shape[1]],
        draw.uniform(0.08, 0.2),
    )
    light = np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * wide**2))
    return image + draw.uniform(100, 200) * light


def blur(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), draw.uniform(0.8, 3))


def moved(image: np.ndarray, half: complex) -> np.ndarray:
    """Return what a camera sees that moves by twice `half`, px, while it exposes an image."""
    far = int(abs(half)) + 1
    kernel = np.zeros((2 * far + 1, 2 * far + 1))
    ends = [(round(far + side * half.real), round(far + side * half.imag)) for side in (-1, 1)]
    cv2.line(kernel, *ends, 1.0)
    return cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)


def motion(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    return moved(image, draw.uniform(1.5, 4.5) * np.exp(1j * draw.uniform(0, np.pi)))


def noise(image: np.ndarray, draw: np.random.Generator) -> np.ndarray:
    return image + draw.normal(0, draw.uniform(5, 25), image.shape)


LIGHTS: tuple[Change, ...] = (shadow, ramp, glare)
CAMERAS: tuple[Change, ...] = (blur, motion, noise)


def by_one_of(changes: tuple[Change, ...]) -> Callable[[View, np.random.Generator], View]:
    """Return what changes the grey levels of a view by one of these, drawn."""

    def change(view: View, draw: np.random.Generator) -> View:
        levels = changes[draw.integers(len(changes))](view.image.astype(np.float64), draw)
        return view._replace(image=np.clip(np.rint(levels), 0, 255).astype(np.uint8))

    return change


def behind_fingers(view: View, draw: np.random.Generator) -> View:
    """Put one to three fingers of one grey before the board."""
    over = np.zeros(view.image.shape, np.uint8)
    for _ in range(draw.integers(1, 4)):
        x, y = view.truth[draw.integers(len(view.truth)), :2].tolist()
        long, wide = view.cell * draw.uniform([4, 1], [12, 2.4])
        cv2.ellipse(over, ((x, y), (wide, long), draw.uniform(0, 180)), 1, -1)
    skin = draw.uniform(40, 220) + 120 * cv2.GaussianBlur(draw.normal(0, 1, over.shape), (0, 0), 3)
    share = cv2.GaussianBlur(over.astype(np.float64), (0, 0), 1)
    image = np.clip((1 - share) * view.image + share * skin, 0, 255).astype(np.uint8)
    column, row = np.rint(view.truth[:, :2]).astype(int).T
    hidden = cv2.dilate(over, np.ones((5, 5), np.uint8))[row, column] > 0
    return view._replace(image=image, truth=view.truth[~hidden], ignored=view.truth[hidden, :2])


CHANGED: dict[str, Callable[[int, int], Iterator[View]]] = {
    "photographs, warped": functools.partial(each, warped),
    "photographs, other light": functools.partial(each, by_one_of(LIGHTS)),
    "photographs, worse camera": functools.partial(each, by_one_of(CAMERAS)),
    "photographs, behind fingers": functools.partial(each, behind_fingers),
}
