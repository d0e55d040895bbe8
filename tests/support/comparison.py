"""A detector held against the oracle."""

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl import Corners, Detector, DetectorConfig, reference
from cmp_cl.corners import HarmonicMaps, Maps

FLOATS = ("spectrum_12", "spectrum_23", "correlation", "phase")

# The most by which floating-point results of a device may differ from the oracle's in float64.
# Integer stages have no tolerance: they are equal.
POSITION = 1e-3  # px, of refined positions and centroids
ANGLE = 1e-3  # rad, of the directions of boundaries
SIGMA = 1e-2  # of a standard deviation, relative
MARGIN = 1e-4  # of a check's quantity from its bound: nearer, float32 may decide otherwise
UNDECIDED = 0.01  # share of the corners that may be as near as that, beside one
CORRELATION = 1e-6  # of the spectral maps, which are float32


def assert_maps_equal(
    detector: Detector,
    image: np.ndarray,
    *,
    mask: NDArray[np.bool_] | None = None,
) -> Maps | HarmonicMaps:
    """Assert that the maps of an image are the oracle's, and return them."""
    found = detector.maps(image)
    expected = reference.maps(image, detector.config, mask)
    assert type(found) is type(expected)
    for name in (field.name for field in dataclasses.fields(expected)):
        one, other = getattr(found, name), getattr(expected, name)
        if other is None:
            assert one is None, name
            continue
        assert one is not None, name
        assert one.dtype == other.dtype, name
        if name in FLOATS:
            np.testing.assert_allclose(one, other, rtol=0, atol=CORRELATION, err_msg=name)
        else:
            np.testing.assert_array_equal(one, other, err_msg=name)
    return found


def assert_corners_equal(
    detector: Detector, image: np.ndarray, *, mask: NDArray[np.bool_] | None = None
) -> Corners:
    """Assert that the corners of an image are the oracle's within the tolerances, and return them.

    Corners with a check within the margin of its bound are few, and are not compared.
    """
    found = detector(image)
    seen = (image.tobytes(), image.dtype, detector.config, None if mask is None else mask.tobytes())
    expected, margin = _oracle(image.shape, *seen)
    np.testing.assert_array_equal(found.pixel, expected.pixel)
    np.testing.assert_array_equal(found.response, expected.response)
    decided = margin > MARGIN
    assert (~decided).sum() <= 1 + UNDECIDED * len(decided)
    np.testing.assert_array_equal(found.method[decided], expected.method[decided])
    np.testing.assert_array_equal(found.refusal[decided], expected.refusal[decided])
    np.testing.assert_array_equal(found.doubtful[decided], expected.doubtful[decided])
    np.testing.assert_allclose(found.xy[decided], expected.xy[decided], rtol=0, atol=POSITION)
    np.testing.assert_allclose(found.sigma[decided], expected.sigma[decided], rtol=SIGMA, atol=0)
    apart = np.remainder(found.edges - expected.edges + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_array_equal(np.isnan(found.edges[decided]), np.isnan(expected.edges[decided]))
    assert not (np.abs(apart[decided]) > ANGLE).any()
    return found


@functools.lru_cache(500)
def _oracle(
    shape: tuple[int, int], pixels: bytes, dtype: Any, config: DetectorConfig, mask: bytes | None
) -> tuple[Corners, NDArray[np.float64]]:
    """Return the oracle's corners and their margins, once for both forms of the kernels."""
    area = None if mask is None else np.frombuffer(mask, np.bool_).reshape(shape)
    image = np.frombuffer(pixels, dtype).reshape(shape)
    return reference.detect_with_margin(image, config, area)


def assert_same_bytes(one: Corners, other: Corners) -> None:
    """Assert that two results are identical, NaN included."""
    for field in dataclasses.fields(Corners):
        values, others = getattr(one, field.name), getattr(other, field.name)
        if isinstance(values, np.ndarray):
            assert values.dtype == others.dtype
            assert values.shape == others.shape, field.name
            assert values.tobytes() == others.tobytes(), field.name
        else:
            np.testing.assert_equal(values, others)
