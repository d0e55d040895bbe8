"""Small images that stages are compared on, all of one shape so that they share kernels."""

import functools

import numpy as np
from corner_images import board, grain, noise
from numpy.typing import NDArray

from cmp_cl import synthetic

Image = NDArray[np.uint8] | NDArray[np.uint16]
SHAPE = (61, 83)


def stripes(width: int, angle: float) -> NDArray[np.uint8]:
    """Return black and white stripes of that width, px."""
    y, x = np.indices(SHAPE)
    across = x * np.cos(angle) + y * np.sin(angle)
    return np.where(np.floor(across / width + 1e-9) % 2 == 0, 30, 220).astype(np.uint8)


def salt_and_pepper(shape: tuple[int, int], share: float) -> NDArray[np.uint8]:
    """Return a grey image of which that share of the pixels is black or white."""
    rng = np.random.default_rng(0)
    image = np.full(shape, 128, np.uint8)
    hit = rng.random(shape) < share
    image[hit] = np.where(rng.random(int(hit.sum())) < 0.5, 0, 255)
    return image


def texture(shape: tuple[int, int], seed: int = 7) -> NDArray[np.uint8]:
    """Return a random texture as fine as the rings, with candidates of every kind."""
    rng = np.random.default_rng(seed)
    grey = 128 + 60 * grain(shape, 1.5, rng) + rng.normal(0, 3, shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@functools.cache
def scene(severity: float = 1.0, *, bits: int = 8, seed: int = 1) -> synthetic.Rendered:
    """Return a pressed gel with cells of about 11 px, 96 x 128."""
    return synthetic.render(
        synthetic.Scene(markers=7, shape=(96, 128), severity=severity, bits=bits, seed=seed)
    )


@functools.cache
def eight_bits() -> dict[str, Image]:
    """Return images by the name of their content."""
    y, x = np.indices(SHAPE)
    images = {
        "black": np.zeros(SHAPE, np.uint8),
        "white": np.full(SHAPE, 255, np.uint8),
        "noise": noise(SHAPE),
        "two levels": noise(SHAPE, seed=1) // 128 * 255,
        "near levels": (noise(SHAPE, seed=2) // 86 + 100).astype(
            np.uint8
        ),  # levels at the threshold
        "texture": texture(SHAPE),
        "ramp": (x * 3).astype(np.uint8),
        "slope": (x + 2 * y).astype(np.uint8),
        "salt and pepper": salt_and_pepper(SHAPE, 0.3),
        "pixels": ((x + y) % 2 * 255).astype(np.uint8),
        "board": board(*SHAPE, 12)[0],
        "fine board": board(*SHAPE, 7)[0],
        "faint board": (board(*SHAPE, 12)[0] // 4 + 100).astype(np.uint8),
        "scene": scene().image[:61, :83],
        "worn scene": scene(1.5).image[30:91, 40:123],
    }
    for width in range(1, 9):
        images[f"stripes {width}"] = stripes(width, 0)
        images[f"slanted stripes {width}"] = stripes(width, 0.5)
    return images


@functools.cache
def sixteen_bits() -> dict[str, Image]:
    """Return images by the name of their content: of 12-bit cameras, and over the whole range."""
    rng = np.random.default_rng(5)
    eight = eight_bits()
    return {
        "black": np.zeros(SHAPE, np.uint16),
        "white": np.full(SHAPE, 65535, np.uint16),
        "noise": rng.integers(0, 65536, SHAPE, dtype=np.uint16),
        "two levels": (rng.integers(0, 2, SHAPE) * 65535).astype(np.uint16),
        "bright": (65535 - rng.integers(0, 3, SHAPE)).astype(np.uint16),
        "board": eight["board"].astype(np.uint16) * 257,
        "texture": eight["texture"].astype(np.uint16) * 257 + rng.integers(0, 99, SHAPE, np.uint16),
        "12-bit scene": scene(bits=12).image[:61, :83],
        "12-bit board": eight["board"].astype(np.uint16) * 16 + 7,
    }
