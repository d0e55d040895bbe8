"""kernels/scale_bands.cl: what scale.cl gives, both equal to the oracle."""

import dataclasses

import numpy as np
import pyopencl as cl
import pytest

from cmp_cl import BinaryRings, Detector, DetectorConfig, DeviceKind
from cmp_cl.reference import scale as oracle


@pytest.mark.parametrize(
    ("kind", "form"), [(DeviceKind.CPU, "resample_bands"), (DeviceKind.GPU, "resample")]
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_both_forms_in_a_batch(device, kind, form, dtype):
    """White and noise: the largest sums, and every rounding; each frame is scaled by itself."""
    largest = np.iinfo(dtype).max
    stack = np.random.default_rng(3).integers(0, largest + 1, (3, 67, 93)).astype(dtype)
    stack[1] = largest
    other = dataclasses.replace(device, kind=kind)
    for factor in (0.07, 0.3, 0.5, 0.836, 1.3, 4.0):
        config = DetectorConfig(detection=BinaryRings(), scale=factor)
        with Detector(shape=(67, 93), dtype=dtype, config=config, device=other) as detector:
            detector.batch(stack)
            plan = detector._plan(factor, frames=3)
            assert plan.launches[0].stage == form
            pixels = np.empty((3 * plan.working[0] + 2, plan.step), dtype)
            cl.enqueue_copy(plan.queue, pixels, plan.buffers["working"])
        rows = pixels[1:-1, plan.pad : plan.pad + plan.working[1]]
        for image, found in zip(stack, rows.reshape(3, *plan.working), strict=True):
            np.testing.assert_array_equal(found, oracle.to_working(image, factor))
