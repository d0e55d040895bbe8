"""The spectral criteria of the oracle against their formulas."""

import math

import numpy as np

from cmp_cl.config import SpectralCriteria
from cmp_cl.reference.paper import ring, spectral

MASKS = np.random.default_rng(5).integers(0, 1 << 16, 300).astype(np.uint16)
OTHERS = np.random.default_rng(6).integers(0, 1 << 16, 300).astype(np.uint16)


def samples(mask: int) -> list[int]:
    return [int(mask) >> i & 1 for i in range(16)]


def correlations(inner: int, outer: int) -> list[int]:
    g1, g2 = samples(outer), samples(inner)
    return [sum(g1[i] * g2[(i + k) % 16] for i in range(16)) for k in range(16)]


def phase(values: list[int]) -> float:
    """Return the smallest |centre|, in samples, of the circular runs of the largest value."""
    best = [value == max(values) for value in values]
    if all(best):
        return 0.0
    centres = []
    for start in range(16):
        if best[start] and not best[start - 1]:
            length = next(n for n in range(1, 16) if not best[(start + n) % 16])
            centre = (start + (length - 1) / 2) % 16
            centres.append(centre if centre <= 8 else centre - 16)
    return min(map(abs, centres))


def test_correlation_and_phase_follow_their_definitions():
    largest, best = spectral.cross_correlation(MASKS, OTHERS)
    shift = spectral.smallest_shifts()[best] / 2
    for k, (inner, outer) in enumerate(zip(MASKS, OTHERS, strict=True)):
        values = correlations(inner, outer)
        assert largest[k] == max(values)
        assert samples(best[k]) == [int(value == max(values)) for value in values]
        assert shift[k] == phase(values)


def around(mask: int, criteria: SpectralCriteria, outer: int | None = None) -> spectral.Spectral:
    inner = np.array([[mask]], np.uint16)
    other = inner if outer is None else np.array([[outer]], np.uint16)
    return spectral.spectral(np.zeros((1, 1), np.bool_), inner, other, criteria)


def test_a_perfect_corner_passes_and_its_response_is_the_formula():
    found = around(0x0F0F, SpectralCriteria(corrosion_threshold=None))
    f1, f2, f3 = spectral.magnitudes()[0x0F0F]
    assert found.candidate[0, 0]
    assert found.response[0, 0] == math.floor(64 * f2 * (f2 - max(f1, f3)) + 0.5)
    assert found.correlation[0, 0] == 1
    assert found.phase[0, 0] == 0
    assert found.spectrum_12[0, 0] == np.float32(f2 - f1)
    assert found.corrosion is None


def test_candidates_follow_the_definition():
    criteria = SpectralCriteria(corrosion_threshold=None)
    four = ring.all_rings()[ring.popcount(ring.all_rings() ^ ring.rotate(ring.all_rings(), 1)) == 4]
    rng = np.random.default_rng(8)
    inner = rng.choice(four, 2000)
    flips = (1 << rng.integers(0, 16, (4, 2000))).astype(np.uint16)
    outer = inner ^ np.bitwise_or.reduce(flips, axis=0)
    found = spectral.spectral(np.zeros((1, 2000), np.bool_), inner[None], outer[None], criteria)
    on_the_bound = 0
    for k in range(2000):
        values = correlations(inner[k], outer[k])
        product = sum(samples(inner[k])) * sum(samples(outer[k]))
        on_the_bound += 16 * max(values) ** 2 == 9 * product > 0
        spectra = [spectral.magnitudes()[mask] for mask in (inner[k], outer[k])]
        passes = (
            all(f2 > f1 + 1e-9 and f2 > f3 + 1e-9 for f1, f2, f3 in spectra)
            and 16 * max(values) ** 2 > 9 * product
            and phase(values) * 22.5 < 20
        )
        assert found.candidate[0, k] == passes
    assert on_the_bound > 0
    assert 100 < found.candidate.sum() < 1900
