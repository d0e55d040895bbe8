"""Compares random configurations and small images with the oracle, and tries invalid ones.

    python tests/fuzz.py --images 100000 --configs 500 --seed 1 [--device TEXT]

Each configuration gets its share of the images in batches, every eighth of them also one by one
and as maps. Compiling takes longer than anything else, so the compiled settings are drawn once for
SHARING configurations in a row. All else, shapes and images too, is drawn for each configuration.

Case K of a seed is always the same: a failure prints the line that repeats it, and the status is 1.
The last line says how much was done; nm is the largest difference of positions, nm of a pixel.
"""

import argparse
import dataclasses
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from types import NoneType
from typing import Any
from unittest import mock

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "support"))
import tolerances
from comparison import assert_maps_equal, assert_same_bytes
from configs import all_settings, settings_of
from corner_images import board

from cmp_cl import (
    CmpClError,
    Corners,
    Detector,
    DetectorConfig,
    Fit,
    ImageError,
    RingHarmonic,
    reference,
)

BATCH = 25
SHARING = 5  # configurations in a row that compile the same
FREE = {  # settings that do not go into the text of the kernels
    *("sector_threshold", "ring_threshold", "corrosion_threshold", "correlation"),
    *("phase", "minimum", "relative", "noise", "max_shift", "cell", "octaves", "scale"),
    "full_scale",
}
ROUNDING = 1e-6  # px: of an edge point some px from the corner, and of its fit, in float32
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
    """Return how far the oracle's own positions move, (N,) px, if its edge points are rounded to
    float32. Centrelines through points that nearly coincide depend on every digit."""
    exact, rng = reference.refine.edge_points, np.random.default_rng(0)

    def rounded(*arguments: Any) -> Any:
        points = exact(*arguments)
        return dataclasses.replace(
            points, point=points.point + rng.normal(0, ROUNDING, points.point.shape)
        )

    there = reference.detect(image, config).xy
    with mock.patch.object(reference.refine, "edge_points", rounded):
        moved = [np.abs(reference.detect(image, config).xy - there) for _ in range(60)]
    return np.max(moved, axis=(0, 2))


def assert_as_expected(
    found: Corners, image: np.ndarray, config: DetectorConfig, counts: Counter[str]
) -> None:
    """Assert that the corners are the oracle's; count those where float32 may decide otherwise."""
    expected, margin = reference.detect_with_margin(image, config)
    np.testing.assert_array_equal(found.pixel, expected.pixel)
    np.testing.assert_array_equal(found.response, expected.response)
    decided = margin > tolerances.MARGIN
    assert np.isfinite(found.xy).all()
    distance = np.abs(found.xy - expected.xy).max(axis=1, initial=0)
    loose = (distance > tolerances.POSITION) | (found.method != expected.method)
    if loose[decided].any():
        moved = movement_by_rounding(image, config)
        decided &= margin > moved  # rounding may carry a check over its bound
        np.testing.assert_array_equal(found.method[decided], expected.method[decided])
        assert (distance <= tolerances.POSITION + 5 * moved)[decided].all(), (distance, moved)
        counts["loose"] += int((decided & loose).sum())
        decided &= ~loose
    counts["corners"] += len(found)
    counts["undecided"] += int((~decided).sum())
    if decided.any():
        farthest = float(np.abs(found.xy[decided] - expected.xy[decided]).max())
        counts["nm"] = max(counts["nm"], round(farthest * 1e6))


def valid_case(
    seed: int, number: int, images: int, device: str | None, counts: Counter[str]
) -> None:
    """Check one configuration and its images."""
    compiled = np.random.default_rng([seed, number // SHARING, 2])
    rng = np.random.default_rng([seed, number])
    dtype = _one(compiled, np.uint8, np.uint8, np.uint16)
    config = random_part(DetectorConfig, compiled, rng)
    shape = tuple(int(n) for n in rng.integers(1, 72, 2))
    mask = rng.random(shape) < 0.8 if rng.random() < 0.2 else None
    with Detector(shape=shape, dtype=dtype, config=config, device=device, mask=mask) as detector:
        for batch in range(-(-images // BATCH)):
            frames = [
                random_image(rng, shape, dtype) for _ in range(min(BATCH, images - batch * BATCH))
            ]
            results = detector.batch(frames)
            for frame, found in zip(frames, results, strict=True):
                if mask is None:
                    assert_as_expected(found, frame, config, counts)
            counts["images"] += len(frames)
            if batch % 8 == 0:
                for frame, found in zip(frames, detector.stream(frames), strict=True):
                    assert_same_bytes(detector(frame), found)
                assert_maps_equal(detector, frames[0], mask=mask)
        again = list(detector.stream(frames))
        for one, other in zip(again, results, strict=True):
            assert_same_bytes(one, other)


def invalid_case(seed: int, number: int, device: str | None) -> bool:
    """Try a value for a field; if it is valid, try an image that no detector takes: with a detector
    of fixed shape and dtype, or with one made for that image. Return whether either was refused by
    an error of cmp_cl."""
    rng = np.random.default_rng([seed, number, 1])
    values: list[Any] = [None, -1, 0, 2, 1e9, -1e9, float("nan"), float("inf"), "3", b"", [], {}]
    values += [True, object(), 2**70, (1.0,), np.float32(0.5), np.int64(7), 1.5, 256, ()]
    part, field, *_ = _one(rng, *all_settings())
    arguments = {field: _one(rng, *values)}
    try:
        part(**arguments)
    except CmpClError:
        return True
    frame: Any = _one(
        rng,
        *(None, 3, "image.png", [[1, 2]], np.zeros(5, np.uint8), np.zeros((2, 2, 3), np.uint8)),
        *(np.zeros((8, 8), np.float64), np.zeros((8, 8), bool), np.zeros((8, 8), np.int16)),
        np.zeros((8, 8), np.uint8)[::-1],
        np.zeros((8, 16), np.uint8)[:, ::2],
        np.full((8, 8), "a", object),
    )
    own = isinstance(frame, np.ndarray) and rng.random() < 0.5
    shape, dtype = (frame.shape, frame.dtype) if own else ((8, 8), np.uint8)
    try:
        with Detector(shape=shape, dtype=dtype, device=device) as detector:
            detector(frame)
    except ImageError:
        return True
    return False


def one_case(number: int, seed: int, images: int, device: str | None, counts: Counter[str]) -> None:
    """Check a valid configuration with its images, and twenty invalid cases; print the failures."""
    again = f"again: --seed {seed} --first {number} --configs 1 --images {images}"
    try:
        valid_case(seed, number, images, device, counts)
        for k in range(20):
            refused = invalid_case(seed, 20 * number + k, device)
            counts["refused" if refused else "failed"] += 1
            if not refused:
                print(f"NOT REFUSED; {again}", flush=True)
    except Exception:
        traceback.print_exc()
        print(f"FAILED; {again}", flush=True)
        counts["failed"] += 1


def main(arguments: list[str] | None = None) -> int:
    """Run the cases; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=100_000, help="in all")
    parser.add_argument("--configs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device")
    parser.add_argument("--first", type=int, default=0, help="number of the first configuration")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after that")
    options = parser.parse_args(arguments)
    share = -(-options.images // options.configs)
    begin = time.monotonic()
    counts: Counter[str] = Counter()
    for done in range(1, options.configs + 1):
        number = options.first + done - 1
        one_case(number, options.seed, share, options.device, counts)
        spent = time.monotonic() - begin
        over = spent > options.seconds or done == options.configs
        if over or done % 10 == 0:
            print(f"seed {options.seed}: {done} configurations, {dict(counts)}, {spent:.0f} s")
        if over:
            break
    return int(counts["failed"] > 0)


if __name__ == "__main__":
    sys.exit(main())
