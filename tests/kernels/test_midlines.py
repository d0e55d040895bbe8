"""kernels/midlines.cl: the paper's refinement equals the oracle."""

import images
import numpy as np
import pytest
from comparison import assert_corners_equal
from configs import rings

from cmp_cl import DetectorConfig, Fit, Method, Midlines, RingHarmonic

RULES = pytest.mark.parametrize(
    "rule",
    [rings(), DetectorConfig(detection=RingHarmonic(octaves=0))],
    ids=["rings", "harmonic"],
)
FITS = pytest.mark.parametrize("fit", Fit, ids=lambda fit: fit.value)


@RULES
@FITS
@pytest.mark.parametrize("scale", [None, 0.63])
def test_midlines_after_both_rules_are_the_oracles(detector_for, rule, fit, scale):
    image = images.scene(1.5, seed=3).image
    config = rule.replace(refinement=Midlines(fit=fit), scale=scale)
    corners = assert_corners_equal(detector_for(image, config), image)
    assert {Method.MIDLINE, Method.CUSP} & set(corners.method)


@FITS
def test_perfect_squares_whose_midlines_are_parallel_are_refined_as_in_the_oracle(
    detector_for, fit
):
    y, x = np.indices(images.SHAPE)
    image = np.where((x // 12 + y // 12) % 2 == 0, 40, 200).astype(np.uint8)
    config = rings(refinement=Midlines(fit=fit))
    corners = assert_corners_equal(detector_for(image, config), image)
    assert len(corners) == 6 * 5
    assert np.isfinite(corners.xy).all()
    if fit is Fit.LINEAR:
        assert (corners.method != Method.MIDLINE).all()


@pytest.mark.parametrize("max_shift", [0.0, 0.2, 5.0])
def test_a_midline_beyond_the_largest_shift_is_rejected(detector_for, max_shift):
    image = images.scene(1.5, seed=3).image
    kept = [
        (corners.method == Method.KEPT).sum()
        for corners in (
            assert_corners_equal(detector_for(image, config), image)
            for config in (rings(refinement=Midlines(max_shift=most)) for most in (max_shift, 2.0))
        )
    ]
    if max_shift == 0:
        assert kept[0] > 30
    else:
        assert kept[0] > kept[1] if max_shift < 1 else kept[0] <= kept[1]
