"""kernels/centroid.cl, centroids.cl: corners in raster order, at the centroid of the response."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal
from configs import rings

from cmp_cl import DetectorConfig, Method, RingHarmonic, reference

EIGHT = images.eight_bits()
RULES = {
    "rings": rings(refinement=None),
    "harmonic": DetectorConfig(detection=RingHarmonic(octaves=0), refinement=None),
    "every maximum": DetectorConfig(
        detection=RingHarmonic(noise=0, relative=0, octaves=0),
        nms_radius=1,
        refinement=None,
    ),
}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ["texture", "scene"])
def test_centroids_are_in_raster_order(detector_in_form, name, rule):
    image = EIGHT[name]
    corners = assert_corners_equal(detector_in_form(image, RULES[rule]), image)
    y, x = np.nonzero(reference.maps(image, RULES[rule]).maximum)
    np.testing.assert_array_equal(corners.pixel, np.stack([x, y], axis=1))
    assert (corners.method == Method.CENTROID).all()
    assert (np.abs(corners.xy - corners.pixel) <= 2).all()  # px: the window has 5 x 5
    assert (corners.xy != corners.pixel).any()


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("scale", some([0.63, 2.0], (0.63,)))
def test_centroids_of_a_scaled_image_equal_the_oracle(detector_in_form, rule, scale):
    image = EIGHT["scene"]
    config = RULES[rule].replace(scale=scale)
    assert len(assert_corners_equal(detector_in_form(image, config), image)) > 5
