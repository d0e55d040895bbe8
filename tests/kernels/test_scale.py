"""kernels/scale.cl: the image at the working scale, equal to the oracle."""

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal
from corner_images import board, noise

from cmp_cl import BinaryRings, DetectorConfig, EdgeLines, EdgeStep, Midlines
from cmp_cl.reference import scale as oracle
from cmp_cl.stages.resampling import resampling_weights, working_shape

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
FACTORS = [0.5, 0.63, 2.0]


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize(
    "name", some(["noise", "texture", "pixels", "worn scene", "white"], ("worn scene",))
)
def test_every_map_of_a_scaled_image_is_the_oracles(detector_for, name, factor):
    image = EIGHT[name]
    maps = assert_maps_equal(
        detector_for(image, DetectorConfig(detection=BinaryRings(), scale=factor)), image
    )
    rows, columns = maps.binary.shape
    assert (rows, columns) == (int(61 * factor + 0.5), int(83 * factor + 0.5))


@pytest.mark.parametrize("factor", some(FACTORS, (0.63,)))
@pytest.mark.parametrize("name", some(["noise", "white", "12-bit scene"], ("noise",)))
def test_sixteen_bits_are_scaled_as_in_the_oracle(detector_for, name, factor):
    image = DEEP[name]
    assert_maps_equal(
        detector_for(image, DetectorConfig(detection=BinaryRings(), scale=factor)), image
    )


@pytest.mark.parametrize("factor", some([0.05, 0.1, 1 / 3, 0.999, 1.001, 1.5, 4.0], (0.1, 1.5)))
def test_odd_factors_give_the_oracles_maps(detector_for, factor):
    image = noise((30, 23), seed=2)
    assert_maps_equal(
        detector_for(image, DetectorConfig(detection=BinaryRings(), scale=factor)), image
    )


@pytest.mark.parametrize("shape", some([(1, 1), (1, 7), (2, 2), (5, 3)], ((1, 1),)))
@pytest.mark.parametrize("factor", [0.05, 0.63, 4.0])
def test_tiny_images_are_scaled_as_in_the_oracle(detector_for, shape, factor):
    image = noise(shape, seed=5)
    assert_maps_equal(
        detector_for(image, DetectorConfig(detection=BinaryRings(), scale=factor)), image
    )


@pytest.mark.parametrize("factor", [0.05, 0.3, 0.5, 0.63, 15 / 31, 1.5, 2.0, 4.0])
@pytest.mark.parametrize("length", [1, 2, 7, 61, 640])
def test_weights_are_those_of_the_oracle(length, factor):
    working = oracle.working_length(length, factor)
    assert working_shape((length, 3), factor)[0] == working
    first, weights = resampling_weights(length, working, factor)
    index, expected = oracle.weights(length, factor)
    for k in range(working):
        one, other = np.zeros(length, np.int64), np.zeros(length, np.int64)
        np.add.at(one, np.minimum(first[k] + np.arange(weights.shape[1]), length - 1), weights[k])
        np.add.at(other, index[k], expected[k])
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "refinement", some([EdgeLines(), EdgeStep(cell=24.0), Midlines(), None], (EdgeStep(cell=24.0),))
)
@pytest.mark.parametrize("factor", FACTORS)
def test_corners_of_a_scaled_image_are_the_oracles(detector_for, factor, refinement):
    image = board(*images.SHAPE, 24 if factor < 1 else 9)[0]
    config = DetectorConfig(detection=BinaryRings(), scale=factor, refinement=refinement)
    corners = assert_corners_equal(detector_for(image, config), image)
    assert len(corners) > 4


def test_a_mask_is_scaled_with_the_image(detector_for):
    image = board(*images.SHAPE, 20)[0]
    mask = np.zeros(images.SHAPE, np.bool_)
    mask[:, :41] = True
    for factor in FACTORS:
        config = DetectorConfig(detection=BinaryRings(), scale=factor)
        corners = assert_corners_equal(detector_for(image, config, mask), image, mask=mask)
        assert len(corners) > 0
        assert_maps_equal(detector_for(image, config, mask), image, mask=mask)


def test_scale_one_is_the_image_as_it_is(detector_for):
    image = EIGHT["scene"]
    plain = detector_for(image, DetectorConfig(detection=BinaryRings()))(image)
    scaled = detector_for(image, DetectorConfig(detection=BinaryRings(), scale=1.0))(image)
    assert plain.xy.tobytes() == scaled.xy.tobytes()
