"""What holds for any configuration and image: the kernels give what the oracle gives; a rotated,
mirrored or inverted image, a crop of a buffer, a frame of a batch have the corners of the image."""

import dataclasses
from types import NoneType
from typing import Any
from unittest import mock

import cv2
import hypothesis
import numpy as np
import pytest
from cases import some
from comparison import MARGIN, POSITION, assert_maps_equal, assert_same_bytes
from configs import CONFIGS, settings_of
from corner_images import board, to_nearest
from hypothesis import strategies as st

from cmp_cl import Corners, Detector, DetectorConfig, Fit, reference
from cmp_cl.corners import Maps

IMAGES = 25  # of a configuration
# of float32: an edge point some px from the corner and its fit, px; a sum over a model of -1 to 1
ROUNDING = 1e-6
Rng = np.random.Generator


def one_of(rng: Rng, *choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def random_part(part: type, rng: Rng) -> Any:
    """Return a valid part of a configuration: each setting its default, a bound or any between."""
    values: dict[str, Any] = {}
    for setting in settings_of(part):
        kind = one_of(rng, *setting.kinds)
        how = one_of(rng, "default", "default", "any", "low", "high")
        if dataclasses.is_dataclass(kind):
            values[setting.name] = random_part(kind, rng)
        elif kind is NoneType:
            values[setting.name] = None
        elif setting.limits is None:
            values[setting.name] = one_of(rng, *(kind if kind is Fit else (False, True)))
        elif how != "default":
            low, high, odd = setting.limits
            between = low + (high - low) * rng.random() ** 4  # small ones find more
            value = kind({"low": low, "high": high, "any": between}[how])
            values[setting.name] = value | 1 if odd else value
    if part is DetectorConfig:
        values["max_corners"] = one_of(rng, 65536, 1, int(rng.integers(1, 1000)))
    return part(**values)


def random_image(rng: Rng, shape: tuple[int, int], dtype: Any) -> np.ndarray:
    """Return a small image: noise, two or three levels, a texture, a board, a ramp or spots."""
    kind = int(rng.integers(9))
    high = 256 if dtype == np.uint8 else one_of(rng, 256, 4096, 65536)
    if kind == 0:
        image = rng.integers(0, high, shape)
    elif kind == 1:
        image = rng.integers(0, high, shape) // (high // 2) * (high - 1)
    elif kind == 2:
        smooth = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), rng.uniform(0.8, 3))
        image = high / 2 + high / 5 * smooth / max(float(smooth.std()), 1e-9)
    elif kind in (3, 4, 5):
        image = board(*shape, rng.uniform(6, 24), angle=rng.uniform(0, 3), blur=1.0)[0] / 256 * high
        image = image + rng.normal(0, one_of(rng, 0, 0.02, 0.1) * high, shape)
    elif kind == 6:
        y, x = np.indices(shape)
        image = (x * rng.integers(0, 9) + y * rng.integers(0, 9)) % high
    elif kind == 7:
        image = rng.integers(0, 3, shape) + int(rng.integers(high))
    else:
        image = np.full(shape, int(rng.integers(high)))
        image[rng.random(shape) < 0.3] = int(rng.integers(high))
    if kind > 1 and rng.random() < 0.2:  # inverted on one side of the middle
        image = np.array(image)
        image[:, shape[1] // 2 :] = high - 1 - image[:, shape[1] // 2 :]
    return np.ascontiguousarray(np.clip(image, 0, high - 1).astype(dtype))


def movement_by_rounding(image: np.ndarray, config: DetectorConfig) -> np.ndarray:
    """Return how far the oracle's own positions move, (N,) px, if its edge points and its model of
    a corner are rounded to float32. Centrelines through points that nearly coincide depend on every
    digit, and so does a step by an edge that is a thousandth of the noise around it."""
    rng = np.random.default_rng(0)
    points_of, model_of = reference.refine.edge_points, reference.edge_step.model_of

    def rounded_points(*arguments: Any) -> Any:
        points = points_of(*arguments)
        return dataclasses.replace(
            points, point=points.point + rng.normal(0, ROUNDING, points.point.shape)
        )

    def rounded_model(*arguments: Any) -> Any:
        return [part + rng.normal(0, ROUNDING, part.shape) for part in model_of(*arguments)]

    there = reference.detect(image, config).xy
    with (
        mock.patch.object(reference.refine, "edge_points", rounded_points),
        mock.patch.object(reference.edge_step, "model_of", rounded_model),
    ):
        moved = [np.abs(reference.detect(image, config).xy - there) for _ in range(60)]
    return np.max(moved, axis=(0, 2))


def assert_as_expected(found: Corners, image: np.ndarray, config: DetectorConfig) -> None:
    """Assert that the corners are the oracle's, but where float32 may decide otherwise."""
    expected, margin = reference.detect_with_margin(image, config)
    np.testing.assert_array_equal(found.pixel, expected.pixel)
    np.testing.assert_array_equal(found.response, expected.response)
    decided = margin > MARGIN
    assert np.isfinite(found.xy).all()
    distance = np.abs(found.xy - expected.xy).max(axis=1, initial=0)
    loose = (distance > POSITION) | (found.method != expected.method)
    if loose[decided].any():
        moved = movement_by_rounding(image, config)
        decided &= margin > moved  # rounding may carry a check over its bound
        np.testing.assert_array_equal(found.method[decided], expected.method[decided])
        assert (distance <= POSITION + 5 * moved)[decided].all(), (distance, moved)


@pytest.mark.parametrize("number", some(range(100), (1, 2)))
def test_drawn_images_of_drawn_shapes_and_settings_give_what_the_oracle_gives(device, number):
    """In a batch, in a stream, alone and as maps."""
    rng = np.random.default_rng(number)
    dtype = one_of(rng, np.uint8, np.uint8, np.uint16)
    config = random_part(DetectorConfig, rng)
    shape = tuple(int(n) for n in rng.integers(1, 72, 2))
    mask = rng.random(shape) < 0.8 if rng.random() < 0.2 else None
    with Detector(shape=shape, dtype=dtype, config=config, device=device, mask=mask) as detector:
        frames = [random_image(rng, shape, dtype) for _ in range(IMAGES)]
        results = detector.batch(frames)
        if mask is None:
            for frame, found in zip(frames, results, strict=True):
                assert_as_expected(found, frame, config)
        for frame, one, other in zip(frames, detector.stream(frames), results, strict=True):
            assert_same_bytes(detector(frame), one)
            assert_same_bytes(one, other)
        assert_maps_equal(detector, frames[0], mask=mask)


# of any image

SIDE = 47
TURNS = [(turns, mirrored) for turns in range(4) for mirrored in (False, True)]
seeds = st.integers(0, 2**32 - 1)
dtypes = st.sampled_from([np.uint8, np.uint16])
configs = st.sampled_from(list(CONFIGS.values()))
several = hypothesis.settings(max_examples=25, deadline=None, derandomize=True)


def any_image(seed, dtype=np.uint8):
    return random_image(np.random.default_rng(seed), (SIDE, SIDE), dtype)


def turned(image, turn):
    turns, mirrored = turn
    image = np.rot90(image, turns, axes=(-2, -1))
    return np.ascontiguousarray(image[..., ::-1] if mirrored else image)


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
@hypothesis.given(seed=seeds, dtype=dtypes, left=st.integers(0, 9), every=st.integers(1, 3))
def test_a_crop_of_a_buffer_has_the_corners_of_its_copy(detector_for, seed, dtype, left, every):
    """Alone, in a batch and in a stream."""
    buffer = np.random.default_rng(seed).integers(0, 256, (SIDE * every, SIDE + 12)).astype(dtype)
    crop = buffer[::every, left : left + SIDE]
    crop[:] = any_image(seed, dtype)
    detector = detector_for(crop, DetectorConfig(full_scale=255))
    alone = detector(crop.copy())
    for found in (detector(crop), *detector.batch([crop, crop]), *detector.stream([crop])):
        assert_same_bytes(found, alone)
