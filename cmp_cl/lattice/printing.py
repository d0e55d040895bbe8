"""Printing errors: a pattern's own fingerprint, which moves with it.

No print is perfect: each of its corners is misplaced by some hundredths of a cell. The distance of
a node from the cubics through its neighbours leaves these errors and noise. The errors of two
frames agree under the right numbers, and under no others.
"""

from typing import NamedTuple

import cv2
import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Whole
from cmp_cl.lattice.constants import LatticeConstants

FROM_CUBICS = np.zeros((5, 5))  # a node minus the mean of the cubics along its row and column
FROM_CUBICS[2] = FROM_CUBICS[:, 2] = np.array([1, -4, 12, -4, 1]) / 12
GAIN = float(np.square(FROM_CUBICS).sum())  # variance of the result, of errors of variance 1


class Prints(NamedTuple):
    """The printing errors of a board.

    error: (R, C) complex, cells, along rows plus 1j along columns, 0 where unknown. known: (R, C).
    cell: mean side of a cell, px. power: mean square of the errors, cells^2.
    """

    error: Numbers
    known: Mask
    cell: float
    power: float

    def turned(self, quarters: int) -> "Prints":
        """Return the same after quarter turns of the board, as np.rot90 turns arrays."""
        if not quarters % 4:
            return self
        error = np.rot90(self.error, quarters) * (-1j) ** (quarters % 4)
        return self._replace(error=error, known=np.rot90(self.known, quarters))


def prints_of(at: Numbers, clip: float) -> Prints:
    """Return the printing errors of measured nodes; at: (R, C) complex, px, NaN where missing."""
    error, known = np.zeros(at.shape, np.complex128), np.zeros(at.shape, np.bool_)
    if min(at.shape) < 5:
        return Prints(error, known, 1.0, 0.0)
    pixels = np.ascontiguousarray(at).view(np.float64).reshape(*at.shape, 2)
    rough = np.ascontiguousarray(cv2.filter2D(pixels, -1, FROM_CUBICS)[2:-2, 2:-2])
    step = (at[2:-2, 3:-1] - at[2:-2, 1:-3]) / 2
    off = rough.view(np.complex128)[..., 0]
    inner = ~np.isnan(off) & (np.abs(step) > 1e-6)
    if not inner.any():
        return Prints(error, known, 1.0, 0.0)
    off = off[inner] / step[inner]
    size = np.abs(off)
    off *= np.minimum(1, clip * np.median(size) / np.maximum(size, 1e-12))
    error[2:-2, 2:-2][inner], known[2:-2, 2:-2] = off, inner
    cell = float(np.abs(step[inner]).mean())
    return Prints(error, known, cell, float(np.square(np.abs(off)).mean()))


def agreement(rest: Prints, now: Prints, row: Whole, column: Whole, k: LatticeConstants) -> Float:
    """Return the nats for placements of a board by its printing errors, against chance, (P, Q).

    row: (P,), column: (Q,), the number at rest of the board's first node.

    The errors of two frames of n common nodes are pairs of Gaussian numbers. If their correlation
    is r, the likelihood that they belong together exceeds that of chance by -n log(1 - r^2), over
    the gain of the cubics, because errors of neighbours depend on each other. Errors that a camera
    makes at the same pixels of every frame are subtracted.
    """
    rows, columns = (
        cv2.getOptimalDFTSize(int(n)) for n in np.add(rest.known.shape, now.known.shape)
    )
    size = [rows, columns]
    total = _correlation(now.error, rest.error, size)
    count = np.rint(_correlation(now.known, rest.known, size))
    power = np.sqrt(max(now.power * rest.power, 1e-30))
    camera = 2 * GAIN * k.camera_px**2 / (now.cell * rest.cell)
    share = np.clip((total / np.maximum(count, 1) - camera) / power, 0, 0.99)
    nats = -count / GAIN * np.log1p(-np.square(share))
    low, high = -np.array(now.known.shape), np.array(rest.known.shape)
    inside = ((row > low[0]) & (row < high[0]))[:, None] & ((column > low[1]) & (column < high[1]))
    found: Float = np.where(inside, nats[np.ix_(row % rows, column % columns)], 0.0)
    return found


def _correlation(now: Numbers | Mask, rest: Numbers | Mask, size: list[int]) -> Float:
    """Return the real part of the sum of conj(now[n]) rest[n + k] over n, by k; k < 0 is last."""
    product = np.conj(np.fft.fft2(now, size)) * np.fft.fft2(rest, size)
    real: Float = np.fft.ifft2(product).real
    return real
