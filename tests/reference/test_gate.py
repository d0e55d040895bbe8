"""The contrast gate of the oracle on sectors drawn by hand."""

import numpy as np
from configs import rings
from corner_images import board

from cmp_cl import reference
from cmp_cl.config import SectorContrast
from cmp_cl.reference.paper import gate, ring

X = np.array([10])
Y = np.array([10])
INNER = np.array([0x0F0F], np.uint16)  # samples 0 to 3 and 8 to 11 are black


def painted(inner: list[int], outer: list[int]) -> np.ndarray:
    image = np.full((21, 21), 90, np.uint8)
    for grey, (dx, dy) in zip(inner, ring.INNER, strict=True):
        image[10 + dy, 10 + dx] = grey
    for grey, (dx, dy) in zip(outer, ring.OUTER_5, strict=True):
        image[10 + dy, 10 + dx] = grey
    return image


def test_contrasts_are_those_worked_out_by_hand():
    inner = [10, 20, 30, 40, 210, 220, 230, 240, 50, 60, 70, 80, 200, 190, 180, 170]
    outer = [0, 5, 10, 15, 250, 240, 230, 220, 20, 25, 30, 35, 150, 160, 170, 180]
    sc1, sc2, sm = gate.sector_contrast(painted(inner, outer), X, Y, INNER, 5)
    # Inner: the largest of each white run 240 and 200, the smallest of each black 10 and 50.
    assert sc1[0] == 200 - 50
    assert sc2[0] == 180 - 20
    # Sums of both rings: white 1840 and 1400, black 130 and 370, each of length 4.
    assert sm[0] == 8 * 1400 // 4 - 8 * 370 // 4


def test_means_are_rounded_down_per_run():
    inner = np.array([0x1F07], np.uint16)  # runs of 3 black, 5 white, 5 black, 3 white
    greys = [1, 1, 1, 7, 7, 7, 7, 7, 2, 2, 2, 2, 3, 7, 7, 8]
    sm = gate.sector_contrast(painted(greys, greys), X, Y, inner, 5)[2]
    white = min(8 * 70 // 5, 8 * 44 // 3)
    black = max(8 * 6 // 3, 8 * 22 // 5)
    assert sm[0] == white - black == 112 - 35


def test_the_bound_takes_rank_9n_plus_9_div_10():
    contrast = SectorContrast(minimum=0, relative=1)
    for n, rank in [(1, 1), (2, 2), (9, 9), (10, 9), (11, 10), (20, 18), (100, 90)]:
        values = np.random.default_rng(n).permutation(np.arange(1, n + 1))
        assert gate.contrast_bound(values, contrast, 255) == rank


def test_the_noise_amplitude_is_that_of_the_definition():
    image = np.zeros((5, 6), np.uint8)
    image[2, 2] = 9
    # The filter weighs a pixel by 4, its four neighbours by 2 and the diagonal ones by 1.
    assert gate.noise_amplitude(image) == (9 * 16, 3 * 4)
    ramp = (np.arange(6)[None] * 3 + np.arange(5)[:, None] * 7).astype(np.uint8)
    assert gate.noise_amplitude(ramp) == (0, 12)
    assert gate.noise_amplitude(image[:2]) == (0, 0)
    assert gate.noise_amplitude(image[:, :1]) == (0, 0)


def test_twelve_bits_raise_the_least_contrast_and_nothing_else():
    image, _ = board(80, 90, 12)
    deep = image.astype(np.uint16) * 16
    eight = reference.maps(image, rings())
    twelve = reference.maps(deep, rings(full_scale=4095))
    np.testing.assert_array_equal(eight.response, twelve.response)
    np.testing.assert_array_equal(16 * eight.contrast, twelve.contrast)
    np.testing.assert_array_equal(eight.maximum, twelve.maximum)
    assert not reference.maps(deep, rings()).maximum.any()
