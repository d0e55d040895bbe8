"""kernels/noise.cl, and the noise that kernels/cpu/harmonic.cl sums up, equal the oracle."""

import numpy as np
import pyopencl as cl
import pytest
from configs import rings

from cmp_cl import DetectorConfig
from cmp_cl.reference.paper import gate

COLUMNS = [1, 2, 3, 4, 5, 6, 7, 8, 9, 31, 33, 64]


def summed(detector, image):
    """Return the noise of the last frame, summed over the bands."""
    detector(image)
    plan = detector._plans.lend()
    sums = np.empty(plan.sizes["noise"] // 8, np.uint64)
    cl.enqueue_copy(plan.queue, sums, plan.arrays["noise"])
    return int(sums.sum())


@pytest.mark.parametrize("config", [DetectorConfig(), rings()], ids=["harmonic", "rings"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
@pytest.mark.parametrize(
    "columns",
    [n if n in (2, 3, 31) else pytest.param(n, marks=pytest.mark.exhaustive) for n in COLUMNS],
)
def test_the_noise_is_the_oracles_for_every_width(detector_in_form, dtype, columns, config):
    image = np.random.default_rng(6).integers(0, np.iinfo(dtype).max + 1, (19, columns), dtype)
    assert summed(detector_in_form(image, config), image) == gate.noise_amplitude(image)[0]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
def test_the_largest_noise_does_not_overflow(detector_in_form, dtype):
    """Black and white pixels in turn: eight full scales at every inner pixel."""
    most = np.iinfo(dtype).max
    image = (np.indices((70, 300)).sum(0) % 2 * most).astype(dtype)
    assert summed(detector_in_form(image), image) == 8 * most * 68 * 298
    assert gate.noise_amplitude(image)[0] == 8 * most * 68 * 298
