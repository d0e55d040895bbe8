"""Tables of the spectral criteria (section 3.3), by ring bits."""

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

RINGS = 1 << 16
TIE = 1e-9  # magnitudes that differ by less count as equal
HALF_SAMPLE = math.radians(11.25)


def magnitudes() -> NDArray[np.float64]:
    """Return the magnitudes |F1|, |F2|, |F3| of the DFT of all ring bits (Eq. 13): (65536, 3)."""
    samples = (np.arange(RINGS)[:, None] >> np.arange(16)) & 1
    turns = np.exp(-2j * np.pi * np.outer(np.arange(16), [1, 2, 3]) / 16)
    result: NDArray[np.float64] = np.abs(samples @ turns)
    return result


def margins() -> NDArray[np.float64]:
    """Return the differences |F2| - |F1| and |F2| - |F3|, exactly 0 at ties: (65536, 2)."""
    f1, f2, f3 = magnitudes().T
    difference = np.stack([f2 - f1, f2 - f3], axis=1)
    return np.where(np.abs(difference) <= TIE, 0, difference)


def response_tables() -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Return each inner ring's response, 0 where it fails, and whether each outer ring passes."""
    f1, f2, f3 = magnitudes().T
    passes: NDArray[np.bool_] = np.min(margins(), axis=1) > 0
    response = np.floor(64 * f2 * (f2 - np.maximum(f1, f3)) + 0.5).astype(np.int32)
    return np.where(passes, np.maximum(response, 1), 0).astype(np.int32), passes.view(np.uint8)


def least_correlation(bound: float) -> NDArray[np.uint8]:
    """Return, by n1 n2, the least max R above bound sqrt(n1 n2) (Eq. 17), else 17: (257,)."""
    square = Fraction(bound) ** 2
    least = np.full(257, 17, np.uint8)
    for product in range(1, 257):
        least[product] = next((r for r in range(17) if r * r > square * product), 17)
    return least


def phase_bound(bound: float) -> int:
    """Return the number of half samples from 0 on whose phase is below the bound, rad."""
    return sum(half * HALF_SAMPLE < bound for half in range(17))
