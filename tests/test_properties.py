"""What holds for any image: rotated, mirrored, inverted, cropped from a buffer, in a batch."""

import hypothesis
import numpy as np
import pytest
from cases import some
from comparison import assert_same_bytes
from configs import CONFIGS
from corner_images import board, to_nearest
from drawing import SHARING, random_image, valid_case
from hypothesis import strategies as st

from cmp_cl import DetectorConfig
from cmp_cl.corners import Maps

SIDE = 47
WHOLE = [config for config in CONFIGS.values() if config.scale is None]
TURNS = [(turns, mirrored) for turns in range(4) for mirrored in (False, True)]
seeds = st.integers(0, 2**32 - 1)
dtypes = st.sampled_from([np.uint8, np.uint16])
configs = st.sampled_from(WHOLE)
several = hypothesis.settings(max_examples=25, deadline=None, derandomize=True)


def any_image(seed, dtype=np.uint8):
    return random_image(np.random.default_rng(seed), (SIDE, SIDE), dtype)


def turned(image, turn):
    turns, mirrored = turn
    image = np.rot90(image, turns, axes=(-2, -1))
    return np.ascontiguousarray(image[..., ::-1] if mirrored else image)


@pytest.mark.parametrize("number", some(range(100), (1, 2)))
def test_drawn_images_of_drawn_shapes_and_settings_give_what_the_oracle_gives(device, number):
    valid_case(0, number * SHARING, device.index)


@several
@hypothesis.given(seed=seeds, config=configs, turn=st.sampled_from(TURNS))
def test_rotating_an_image_rotates_its_maps(detector_for, seed, config, turn):
    image = any_image(seed)
    detector = detector_for(image, config)
    plain, other = detector.maps(image), detector.maps(turned(image, turn))
    dense = ("fine", "coarse", "coarse_response", "fine_response")
    if isinstance(plain, Maps):  # the gate looks at the maxima, of which ties choose by place
        dense = ("binary", "candidate", "response", "score")
    for name in dense:
        seen, expected = getattr(other, name), getattr(plain, name)
        if expected is not None:  # a part that the configuration leaves out
            np.testing.assert_array_equal(seen, turned(expected, turn), err_msg=name)


def assert_same_places(found, expected, *, tolerance):
    """Assert that every position, (N, 2), has a partner within the tolerance, px."""
    assert len(found) == len(expected) > 4
    assert to_nearest(found, expected).max() < tolerance
    assert to_nearest(expected, found).max() < tolerance


cells, angles = st.floats(9, 16), st.floats(0.05, 1.5)


@several
@hypothesis.given(cell=cells, angle=angles, turn=st.sampled_from(TURNS))
def test_rotating_a_board_rotates_its_corners(detector_for, cell, angle, turn):
    image = board(SIDE, SIDE, cell, angle=angle)[0]
    detector = detector_for(image)
    y, x = (turned(index, turn) for index in np.indices(image.shape))
    xy = detector(turned(image, turn)).xy
    near = np.rint(xy).astype(int).clip(0, SIDE - 1)
    # Positions within a pixel rotate too.
    step_x = np.array([x[0, 1] - x[0, 0], y[0, 1] - y[0, 0]])
    step_y = np.array([x[1, 0] - x[0, 0], y[1, 0] - y[0, 0]])
    rest = xy - near
    place = np.stack([x[near[:, 1], near[:, 0]], y[near[:, 1], near[:, 0]]], axis=1)
    back = place + rest[:, :1] * step_x + rest[:, 1:] * step_y
    assert_same_places(back, detector(image).xy, tolerance=0.2)


@several
@hypothesis.given(cell=cells, angle=angles)
def test_inverting_a_board_keeps_its_corners(detector_for, cell, angle):
    image = board(SIDE, SIDE, cell, angle=angle)[0]
    detector = detector_for(image)
    assert_same_places(detector(255 - image).xy, detector(image).xy, tolerance=0.2)


@several
@hypothesis.given(
    many=st.lists(seeds, min_size=1, max_size=3),
    dtype=dtypes,
    left=st.integers(0, 9),
    right=st.integers(0, 9),
    every=st.integers(1, 3),
)
def test_crops_are_the_same_in_a_batch_a_stream_or_alone(
    detector_for, many, dtype, left, right, every
):
    images = [any_image(seed, dtype) for seed in many]
    views = []
    for image in images:
        buffer = np.full((SIDE * every, left + SIDE + right), 77, dtype)
        view = buffer[::every, left : left + SIDE]
        view[:] = image
        views.append(view)
    detector = detector_for(images[0], DetectorConfig(full_scale=255))
    alone = [detector(image) for image in images]
    for results in (
        detector.batch(views),
        detector.batch(np.stack(views)),
        detector.stream(views),
        map(detector, views),
    ):
        for one, other in zip(results, alone, strict=True):
            assert_same_bytes(one, other)
