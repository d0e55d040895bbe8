"""The working scale (section 3.2): an image resampled so that the sampler fits its cells.

With the scale s, working pixel x' lies at x = (x' + .5) / s - .5 of the full image.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage

ONE = 2048
# px: a centroid so little before the border of a pixel starts beyond it. Symmetric corners lie on
# such borders exactly, and the rounding of the division would decide.
BORDER = 2.0**-10


def working_length(length: int, scale: float) -> int:
    """Return max(1, floor(length s + .5)), exactly."""
    return max(1, int(Fraction(scale) * length + Fraction(1, 2)))


def to_working(image: GreyImage, scale: float) -> GreyImage:
    """Return the image at working size: floor((sum of wy wx I + 2^21) / 2^22), in its own dtype."""
    if scale == 1:
        return image
    rows = _resample(image.astype(np.int64), scale)
    both = _resample(rows.T, scale).T
    rounded = (both + (1 << 21)) >> 22
    return rounded.astype(np.uint8) if image.dtype == np.uint8 else rounded.astype(np.uint16)


def _resample(values: NDArray[np.int64], scale: float) -> NDArray[np.int64]:
    index, weight = weights(values.shape[0], scale)
    result = np.zeros((len(index), values.shape[1]), np.int64)
    for tap in range(index.shape[1]):
        result += weight[:, tap, None] * values[index[:, tap]]
    return result


def weights(length: int, scale: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the input pixels and weights of each working pixel of one axis: (n, taps) each.

    Per working pixel x' the weights are integers that sum to 2048. Input pixel i, in
    ascending order, gets floor(2048 c_i + .5) - floor(2048 c_(i-1) + .5) where c_i is

    s < 1: the share of the interval from x' / s to min(length, (x' + 1) / s) that lies
        below i + 1, where pixel i covers i to i + 1;
    s > 1: 1 - f for the pixel floor(x) and 1 for the next, with x = (x' + .5) / s - .5,
        f = x - floor(x), and both pixel numbers clipped to the image.

    It is computed in rational numbers from the exact value of s. Unused taps have weight 0.
    """
    p, q = Fraction(scale).as_integer_ratio()
    taps: list[list[tuple[int, int]]] = []
    for k in range(working_length(length, scale)):
        if scale < 1:
            taps.append(_box(k * q, min(length * p, (k + 1) * q), p))
        else:
            floor, rest = divmod((2 * k + 1) * q - p, 2 * p)
            below = _rounded_share(2 * p - rest, 2 * p)
            pixels = (min(max(floor + step, 0), length - 1) for step in (0, 1))
            taps.append(list(zip(pixels, (below, ONE - below), strict=True)))
    most = max(len(tap) for tap in taps)
    table = np.zeros((2, len(taps), most), np.int64)
    for k, tap in enumerate(taps):
        table[:, k, : len(tap)] = np.transpose(tap)
    return table[0], table[1]


def _box(low: int, high: int, unit: int) -> list[tuple[int, int]]:
    """Return the pixels under the interval low..high, each `unit` wide, and their weights."""
    taps = []
    before = 0
    for pixel in range(low // unit, -(-high // unit)):
        up_to = _rounded_share(min((pixel + 1) * unit, high) - low, high - low)
        taps.append((pixel, up_to - before))
        before = up_to
    return taps


def _rounded_share(part: int, whole: int) -> int:
    """Return floor(2048 part / whole + .5)."""
    return (2 * ONE * part + whole) // (2 * whole)


def to_full(position: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """Map positions at working size to positions in the full image."""
    return (position + 0.5) / scale - 0.5


def nearest(position: NDArray[np.float64], lengths: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the nearest pixel to positions (N, A) along axes of these lengths."""
    return np.clip(np.floor(position + 0.5), 0, np.subtract(lengths, 1)).astype(np.int64)


def mask_at_working(mask: NDArray[np.bool_], scale: float) -> NDArray[np.bool_]:
    """Return the mask at working size: its value at the full pixel nearest to each pixel."""
    if scale == 1:
        return mask
    rows, columns = (
        nearest(
            to_full(np.arange(working_length(n, scale))[:, None].astype(np.float64), scale), (n,)
        )
        for n in mask.shape
    )
    return mask[rows, columns.T]
