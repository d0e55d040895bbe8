"""Printing errors: a pattern's own fingerprint, which moves with it.

No print is perfect: each of its corners is misplaced by some hundredths of a cell. The distance of
a node from the cubics through its neighbours leaves these errors and noise. The errors of two
frames agree under the right numbers, and under no others.
"""

import dataclasses
import functools
import math

import cv2
import numpy as np

from cmp_cl.lattice.arrays import Float, Mask, Numbers, Whole
from cmp_cl.lattice.constants import LatticeConstants

FROM_CUBICS = np.zeros((5, 5))  # a node minus the mean of the cubics along its row and column
FROM_CUBICS[2] = FROM_CUBICS[:, 2] = np.array([1, -4, 12, -4, 1]) / 12
GAIN = float(np.square(FROM_CUBICS).sum())  # variance of the result, of errors of variance 1


@dataclasses.dataclass(frozen=True, eq=False)
class Prints:
    """The printing errors of a board.

    error: (R, C) complex, cells, along rows plus 1j along columns, 0 where unknown. known: (R, C).
    cell: mean side of a cell, px.
    """

    error: Numbers
    known: Mask
    cell: float

    def turned(self, quarters: int) -> "Prints":
        """Return the same after quarter turns of the board, as np.rot90 turns arrays."""
        if not quarters % 4:
            return self
        error = np.rot90(self.error, quarters) * (-1j) ** (quarters % 4)
        return Prints(error, np.rot90(self.known, quarters), self.cell)


def prints_of(at: Numbers, clip: float) -> Prints:
    """Return the printing errors of measured nodes; at: (R, C) complex, px, NaN where missing."""
    error, known = np.zeros(at.shape, np.complex128), np.zeros(at.shape, np.bool_)
    if min(at.shape) < 5:
        return Prints(error, known, 1.0)
    pixels = np.ascontiguousarray(at).view(np.float64).reshape(*at.shape, 2)
    rough = np.ascontiguousarray(cv2.filter2D(pixels, -1, FROM_CUBICS)[2:-2, 2:-2])
    step = (at[2:-2, 3:-1] - at[2:-2, 1:-3]) / 2
    off = rough.view(np.complex128)[..., 0]
    inner = ~np.isnan(off) & (np.abs(step) > 1e-6)
    if not inner.any():
        return Prints(error, known, 1.0)
    off = off[inner] / step[inner]
    size = np.abs(off)
    off *= np.minimum(1, clip * np.median(size) / np.maximum(size, 1e-12))
    error[2:-2, 2:-2][inner], known[2:-2, 2:-2] = off, inner
    return Prints(error, known, float(np.abs(step[inner]).mean()))


def agreement(
    rest: Prints, now: Prints, row: Whole, column: Whole, alike: float, k: LatticeConstants
) -> Float:
    """Return the nats for placements of a board by its printing errors, against chance, (P, Q).

    row: (P,), column: (Q,), the number at rest of the board's first node. alike: the share of nodes
        that moved alike since rest, but for whole cells.

    The errors of two frames at n common nodes are pairs of Gaussian numbers. If their correlation
    is r, the likelihood that they belong together exceeds that of chance by -n log(1 - r^2), over
    the mean of 2 n r^2 of all placements: the gain of the cubics if the errors of nodes are
    independent, more if they are the same along rows. The best of all placements agrees by chance
    by the logarithm of how many there are. Errors that a camera makes at the same places of pixels
    in both frames are subtracted, for nodes that moved alike.
    """
    rows, columns = (
        cv2.getOptimalDFTSize(int(n)) for n in np.add(rest.known.shape, now.known.shape)
    )
    size = rows, columns
    x, y, one, square = np.conj(_spectra(now, size))
    rest_x, rest_y, rest_one, rest_square = _spectra_at_rest(rest, size)
    products = np.stack(
        [x * rest_x + y * rest_y, one * rest_one, square * rest_one, one * rest_square]
    )
    planes: Float = np.fft.irfft2(products, size)
    total, count, power, rest_power = planes
    count = np.rint(count)
    camera = 2 * GAIN * k.camera_px**2 / (now.cell * rest.cell) * alike
    power = np.sqrt(np.maximum(power, 1e-15) * np.maximum(rest_power, 1e-15))
    many = count >= k.least_board
    placements = max(int(np.count_nonzero(many)), 1)
    chance = 2 * float(np.sum(count * np.square(total / power), where=many)) / placements
    share = np.clip((total - camera * count) / power, 0, 0.99)
    nats = -count / max(chance, GAIN) * np.log1p(-np.square(share)) - math.log(placements)
    nats = np.maximum(nats, 0)
    low, high = -np.array(now.known.shape), np.array(rest.known.shape)
    inside = ((row > low[0]) & (row < high[0]))[:, None] & ((column > low[1]) & (column < high[1]))
    found: Float = np.where(inside, nats[np.ix_(row % rows, column % columns)], 0.0)
    return found


def _spectra(prints: Prints, size: tuple[int, int]) -> Numbers:
    """Return the spectra of the errors, along rows and along columns, of where they are known, and
    of their squares, (4, rows, columns // 2 + 1)."""
    error = prints.error
    planes = np.stack([error.real, error.imag, prints.known, np.square(np.abs(error))])
    spectra: Numbers = np.fft.rfft2(planes, size)
    return spectra


# of both forms of a pattern at rest, with all its frames
_spectra_at_rest = functools.lru_cache(maxsize=4)(_spectra)
