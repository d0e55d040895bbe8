"""Kernels of whole work-groups, which a CPU runs with one work-item each, as cards run them."""

import images
import numpy as np
import pytest
from comparison import assert_corners_equal
from configs import rings
from corner_images import grain
from detectors import in_form

from cmp_cl import Detector, DetectorConfig, RingHarmonic
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.stages.layout import PlanBase

SCENE = images.scene(2).image[:210, :250].copy()
NOISE = np.clip(128 + 15 * grain((160, 200), 2, 1), 0, 255).astype(np.uint8)
CONFIGS = {
    "default": DetectorConfig(),
    "every maximum": DetectorConfig(detection=RingHarmonic(noise=0, relative=0)),
    "rings": rings(),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("config", CONFIGS)
def test_groups_of_many_work_items_find_what_one_finds(device, monkeypatch, config, dtype):
    monkeypatch.setattr(PlanBase, "_on_cpu", False)
    card = in_form(device, DeviceKind.GPU)
    for image in (SCENE, NOISE):
        deep = image.astype(dtype) * (1 if dtype == np.uint8 else 257)
        with Detector(shape=deep.shape, dtype=dtype, config=CONFIGS[config], device=card) as found:
            assert len(assert_corners_equal(found, deep)) > 40
