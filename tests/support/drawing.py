"""Drawn configurations and small images, which a detector must search as the oracle does.

Compiling takes longer than anything else, so the compiled settings are drawn once for SHARING
configurations in a row. All else, shapes and images too, is drawn for each configuration. Case K of
a seed is always the same.
"""

import dataclasses
from types import NoneType
from typing import Any
from unittest import mock

import cv2
import numpy as np
from comparison import MARGIN, POSITION, assert_maps_equal, assert_same_bytes
from configs import settings_of
from corner_images import board

from cmp_cl import (
    Corners,
    Detector,
    DetectorConfig,
    Fit,
    RingHarmonic,
    reference,
)

IMAGES = 25  # of a configuration
SHARING = 5  # configurations in a row that compile the same
FREE = {  # settings that do not go into the text of the kernels
    *("sector_threshold", "ring_threshold", "corrosion_threshold", "correlation"),
    *("phase", "minimum", "relative", "noise", "max_shift", "cell", "octaves", "scale"),
    "full_scale",
}
# of float32: an edge point some px from the corner and its fit, px; a sum over a model of -1 to 1
ROUNDING = 1e-6
Rng = np.random.Generator


def _one(rng: Rng, *choices: Any) -> Any:
    return choices[int(rng.integers(len(choices)))]


def random_part(part: type, compiled: Rng, rng: Rng) -> Any:
    """Return a valid part of a configuration: each setting its default, a bound or any between.

    What goes into the text of the kernels is drawn from `compiled`, all else from `rng`.
    """
    values: dict[str, Any] = {}
    for setting in settings_of(part):
        kind, draw = _one(compiled, *setting.kinds), rng if setting.name in FREE else compiled
        how = _one(draw, "default", "default", "any", "low", "high")
        if dataclasses.is_dataclass(kind):
            values[setting.name] = random_part(kind, compiled, rng)
        elif kind is NoneType:
            values[setting.name] = None
        elif setting.limits is None:
            values[setting.name] = _one(compiled, *(kind if kind is Fit else (False, True)))
        elif how != "default":
            low, high, odd = setting.limits
            between = low + (high - low) * draw.random() ** 4  # small ones find more
            value = kind({"low": low, "high": high, "any": between}[how])
            values[setting.name] = value | 1 if odd else value
    if part is DetectorConfig:
        values["max_corners"] = _one(rng, 65536, 1, int(rng.integers(1, 1000)))
        if isinstance(values["detection"], RingHarmonic) and values.get("scale"):
            values["detection"] = dataclasses.replace(values["detection"], octaves=0)
    return part(**values)


def random_image(rng: Rng, shape: tuple[int, int], dtype: Any) -> np.ndarray:
    """Return a small image: noise, two or three levels, a texture, a board, a ramp or spots."""
    kind = int(rng.integers(9))
    high = 256 if dtype == np.uint8 else _one(rng, 256, 4096, 65536)
    if kind == 0:
        image = rng.integers(0, high, shape)
    elif kind == 1:
        image = rng.integers(0, high, shape) // (high // 2) * (high - 1)
    elif kind == 2:
        smooth = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), rng.uniform(0.8, 3))
        image = high / 2 + high / 5 * smooth / max(float(smooth.std()), 1e-9)
    elif kind in (3, 4, 5):
        image = board(*shape, rng.uniform(6, 24), angle=rng.uniform(0, 3), blur=1.0)[0] / 256 * high
        image = image + rng.normal(0, _one(rng, 0, 0.02, 0.1) * high, shape)
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


def valid_case(seed: int, number: int, device: str | None) -> None:
    """Check one configuration, and some images in a batch, in a stream, alone and as maps."""
    compiled = np.random.default_rng([seed, number // SHARING, 2])
    rng = np.random.default_rng([seed, number])
    dtype = _one(compiled, np.uint8, np.uint8, np.uint16)
    config = random_part(DetectorConfig, compiled, rng)
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
