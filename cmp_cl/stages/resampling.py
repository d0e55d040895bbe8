"""The working scale (section 3.2: the sampler has one size): sizes and weights.

Pixel x of an image maps to (x + 0.5) s - 0.5 of the image scaled by s. Sizes and weights are
computed in integers from the exact ratio s, so that every machine has the same.
"""

import functools
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

WEIGHT_SUM = 2048  # sum of the integer weights of an output pixel along one axis


def working_shape(shape: tuple[int, int], scale: float) -> tuple[int, int]:
    """Return (H, W) of an image of that shape at a working scale, at least (1, 1)."""
    exact = Fraction(scale)
    rows, columns = (max(1, int(n * exact + Fraction(1, 2))) for n in shape)
    return rows, columns


def full_pixels(
    pixel: NDArray[np.int32], lengths: tuple[int, ...], scale: float
) -> NDArray[np.int32]:
    """Return the pixels of a full image nearest to those of the scaled one, (N, A), along axes of
    these lengths."""
    nearest = np.floor((pixel + 0.5) / scale)
    held: NDArray[np.float64] = np.clip(nearest, 0, np.subtract(lengths, 1))
    return held.astype(np.int32)


@functools.lru_cache(maxsize=8)
def resampling_weights(
    size: int, working: int, scale: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the inputs of each output pixel of one axis: the first inputs (working,), and integer
    weights (working, taps) that sum to WEIGHT_SUM.

    Below scale 1 an output pixel is the mean over its area. Above scale 1 it is interpolated
    linearly, with the border repeated. A weight is the difference of the rounded cumulative shares.
    """
    up, down = Fraction(scale).as_integer_ratio()
    first, shares = zip(
        *(
            _area(n, size, up, down) if scale < 1 else _between(n, size, up, down)
            for n in range(working)
        ),
        strict=True,
    )
    taps = max(len(share) for share in shares)
    weights = np.zeros((working, taps), np.int32)
    for row, share in zip(weights, shares, strict=True):
        rounded = [(2 * WEIGHT_SUM * part + whole) // (2 * whole) for part, whole in share]
        row[: len(share)] = np.diff([0, *rounded])
    inputs = np.array(first, np.int32)
    inputs.flags.writeable = weights.flags.writeable = False
    return inputs, weights


def _area(n: int, size: int, up: int, down: int) -> tuple[int, list[tuple[int, int]]]:
    """Return first input and cumulative area shares of output n; lengths count 1 / up pixels."""
    low, high = n * down, min((n + 1) * down, size * up)
    first, last = low // up, (high - 1) // up
    return first, [(min((i + 1) * up, high) - low, high - low) for i in range(first, last + 1)]


def _between(n: int, size: int, up: int, down: int) -> tuple[int, list[tuple[int, int]]]:
    """Return the same for the two inputs around the centre of output n."""
    whole = 2 * up
    position = min(max((2 * n + 1) * down - up, 0), (size - 1) * whole)
    first = min(position // whole, max(size - 2, 0))
    return first, [(whole - (position - first * whole), whole), (whole, whole)]
