"""The spectral criteria (section 3.3, Eqs. 13 and 17) on ring bits."""

import functools
import math
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import SpectralCriteria
from cmp_cl.reference.paper import ring

TIE = 1e-9


def spectral(
    inner: NDArray[np.uint16], outer: NDArray[np.uint16], criteria: SpectralCriteria
) -> dict[str, Any]:
    """Evaluate the spectral criteria but that of corrosion at every pixel, given its ring bits.

    Returns fields of `cmp_cl.corners.Maps`; the response is that of a candidate.
    """
    minus_1, minus_3 = spectrum_differences()
    spectrum_12 = np.minimum(minus_1[inner], minus_1[outer])
    spectrum_23 = np.minimum(minus_3[inner], minus_3[outer])
    largest, best = cross_correlation(inner, outer)
    n1, n2 = np.bitwise_count(outer), np.bitwise_count(inner)
    half_samples = smallest_shifts()[best]
    candidate = (
        (spectrum_12 > 0)
        & (spectrum_23 > 0)
        & (largest >= least_correlations(criteria.correlation)[n1, n2])
        & (half_samples * (math.pi / 16) < criteria.phase)
    )
    product = n1.astype(np.float64) * n2
    return dict(
        spectrum_12=spectrum_12.astype(np.float32),
        spectrum_23=spectrum_23.astype(np.float32),
        correlation=(largest / np.sqrt(np.maximum(product, 1))).astype(np.float32),
        phase=(half_samples * (math.pi / 16)).astype(np.float32),
        candidate=candidate,
        response=responses()[inner],
    )


@functools.cache
def magnitudes() -> NDArray[np.float64]:
    """Return |F1|, |F2| and |F3| of the discrete Fourier transform of each ring: (65536, 3)."""
    return np.abs(np.fft.fft(ring.bits(ring.all_rings()).astype(np.float64), axis=1)[:, 1:4])


@functools.cache
def spectrum_differences() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return |F2| - |F1| and |F2| - |F3|, exactly 0 where they are within 1e-9: (65536,) each."""
    f1, f2, f3 = magnitudes().T
    minus_1, minus_3 = f2 - f1, f2 - f3
    return (
        np.where(np.abs(minus_1) <= TIE, 0.0, minus_1),
        np.where(np.abs(minus_3) <= TIE, 0.0, minus_3),
    )


@functools.cache
def responses() -> NDArray[np.int32]:
    """Return max(1, floor(64 |F2| (|F2| - max(|F1|, |F3|)) + .5)): (65536,)."""
    difference = np.minimum(*spectrum_differences())
    product = 64 * magnitudes()[:, 1] * difference
    return np.maximum(1, np.floor(product + 0.5)).astype(np.int32)


def cross_correlation(
    inner: NDArray[np.uint16], outer: NDArray[np.uint16]
) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Return the largest R(k) = sum of g1(i) g2(i + k) (Eq. 17), and a bit for each of its k."""
    largest = np.zeros(inner.shape, np.uint8)
    best = np.zeros(inner.shape, np.uint16)
    for k in range(16):
        value = np.bitwise_count(outer & ring.rotate(inner, k))
        bit = np.uint16(1 << k)
        best = np.where(value > largest, bit, np.where(value == largest, best | bit, best))
        largest = np.maximum(largest, value)
    return largest, best


@functools.cache
def least_correlations(bound: float) -> NDArray[np.int64]:
    """Return, per n1 and n2, the smallest integer R with R / sqrt(n1 n2) > bound: (17, 17).

    It is decided exactly, by R^2 > bound^2 n1 n2. If n1 n2 = 0 it is 17, which no R reaches.
    """
    square = Fraction(bound) ** 2
    table = np.full((17, 17), 17)
    for n1 in range(1, 17):
        for n2 in range(1, 17):
            passing = (r for r in range(17) if r * r > square * n1 * n2)
            table[n1, n2] = next(passing, 17)
    return table


@functools.cache
def smallest_shifts() -> NDArray[np.uint8]:
    """Return twice the smallest |centre| of the circular runs of best k, by their bits: (65536,).

    A run of L bits from bit s has the centre s + (L - 1) / 2, wrapped to (-8, 8]. The result is 0
    if all bits or none are set.
    """
    best = ring.bits(ring.all_rings())
    table = np.full(1 << 16, 255, np.uint8)
    for start in range(16):
        starts = best[:, start] & ~best[:, start - 1]
        inside = np.ones(1 << 16, np.bool_)
        for length in range(1, 16):
            inside &= best[:, (start + length - 1) % 16]
            ends = starts & inside & ~best[:, (start + length) % 16]
            twice = (2 * start + length - 1) % 32
            table[ends] = np.minimum(table[ends], min(twice, 32 - twice))
    table[[0, -1]] = 0
    return table
