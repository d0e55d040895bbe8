"""The double-layer sampler (section 3.2), and functions of its 16 ring bits.

Offsets are (dx, dy), x right, y down, clockwise from twelve o'clock. Bit i of the ring bits
is sample i, 1 where black. Samples outside the image repeat the border pixel. Tables have
one entry for each of the 65 536 rings.
"""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage


def _whole(*quarter: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """Return a ring from its first quarter, which repeats rotated by quarter turns."""
    quarters = [quarter]
    for _ in range(3):
        quarters.append(tuple((-y, x) for x, y in quarters[-1]))
    return sum(quarters, ())


INNER = _whole((0, -3), (1, -3), (2, -2), (3, -1))
OUTER_5 = _whole((0, -5), (2, -5), (4, -4), (5, -2))
OUTER_4 = _whole((0, -4), (2, -4), (3, -3), (4, -2))
OUTER = {4: OUTER_4, 5: OUTER_5}
REGION = tuple((dx, dy) for dy in range(-2, 3) for dx in range(-2, 3) if abs(dx) + abs(dy) < 4)
PADDING = 5  # px, as far as the outer ring extends


def ring_bits(
    binary: NDArray[np.bool_], offsets: tuple[tuple[int, int], ...]
) -> NDArray[np.uint16]:
    """Return (H, W) uint16: the ring bits around every pixel of a binary image."""
    padded = np.pad(binary, PADDING, mode="edge").astype(np.uint16)
    mask = np.zeros(binary.shape, np.uint16)
    for bit, offset in enumerate(offsets):
        mask |= padded[_window(binary.shape, offset)] << np.uint16(bit)
    return mask


def black_in_region(binary: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (H, W): black pixels of the corrosion region (21 px) around every pixel."""
    padded = np.pad(binary, PADDING, mode="edge").astype(np.int64)
    count = np.zeros(binary.shape, np.int64)
    for offset in REGION:
        count += padded[_window(binary.shape, offset)]
    return count


def _window(shape: tuple[int, ...], offset: tuple[int, int]) -> tuple[slice, slice]:
    """Return the part of an image padded by PADDING that lies at an offset from the image."""
    dx, dy = offset
    return (
        slice(PADDING + dy, PADDING + dy + shape[0]),
        slice(PADDING + dx, PADDING + dx + shape[1]),
    )


def ring_greys(
    image: GreyImage,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    offsets: tuple[tuple[int, int], ...],
) -> NDArray[np.int64]:
    """Return (N, samples) int64: the grey levels of a ring around N pixels."""
    dx, dy = np.array(offsets).T
    height, width = image.shape
    rows = np.clip(y[:, None] + dy, 0, height - 1)
    columns = np.clip(x[:, None] + dx, 0, width - 1)
    greys: NDArray[np.int64] = image[rows, columns].astype(np.int64)
    return greys


def rotate(mask: NDArray[np.uint16], count: int) -> NDArray[np.uint16]:
    """Return rot(v, k), which moves sample i + k to bit i."""
    wide = mask.astype(np.uint32)
    return (wide >> np.uint32(count) | wide << np.uint32(16 - count)).astype(np.uint16)


def bits(mask: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Return (..., 16): the samples of each ring, True where black."""
    return (mask[..., None] >> np.arange(16, dtype=np.uint16) & np.uint16(1)).astype(np.bool_)


def all_rings() -> NDArray[np.uint16]:
    """Return the bits of all 65 536 rings in order."""
    return np.arange(1 << 16).astype(np.uint16)


def runs(mask: NDArray[np.uint16]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the circular runs of N rings: (N, 16) run number of each sample, (N, 16) its colour.

    Runs are numbered from 0 clockwise from the first sample that differs from the one
    before it; in a constant ring every sample is in run 0.
    """
    black = bits(mask)
    starts = black != np.roll(black, 1, axis=1)
    count = np.maximum(starts.sum(axis=1, keepdims=True), 1)
    return (np.cumsum(starts, axis=1) - 1) % count, black
