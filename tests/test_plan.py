"""Stages that a configuration leaves out are not compiled, not launched and not allocated."""

import images
import numpy as np
import pytest
from configs import rings

from cmp_cl import (
    BinaryRings,
    Detector,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Midlines,
    SpectralCriteria,
)
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.opencl.memory import ALIGNMENT

IMAGE = images.eight_bits()["board"]
FULL = DetectorConfig(detection=BinaryRings(), refinement=EdgeStep(), max_corners=512)
HARMONIC = DetectorConfig(refinement=EdgeStep())


def plan_of(detector_in_form, config):
    detector = detector_in_form(IMAGE, config)
    assert len(detector(IMAGE)) > 0
    plan = detector._plans.lend()
    kernels = plan.kernels.names
    launched = [launch.stage for launch in plan.launches]
    assert set(launched) <= kernels
    assert set(plan.memory) == set(plan.sizes)
    for name, memory in plan.memory.items():
        assert 0 <= memory.buffer.size - plan.sizes[name] < ALIGNMENT, name
    return plan, set(launched), kernels


SPECTRAL = DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria()))
GATE = ("sector_contrast", "percentile", "pass_gate")
STEP = {DeviceKind.CPU: "edge_step_eight", DeviceKind.GPU: "edge_step"}
LINES = {DeviceKind.CPU: "edge_lines_eight", DeviceKind.GPU: "edge_lines"}
LEFT_OUT = {  # a configuration, one that has more, and its kernels and buffers
    "the gate": (
        rings(FULL, contrast=None),
        FULL,
        ("noise", *GATE),
        ("contrast", "noise", "bounds", "passed"),
    ),
    "a refinement": (FULL.replace(refinement=None), FULL, (STEP,), ()),
    "the other refinement": (DetectorConfig(refinement=EdgeLines()), HARMONIC, (STEP,), ()),
    "lines for the step": (HARMONIC, DetectorConfig(refinement=EdgeLines()), (LINES,), ()),
    "the rapid criteria": (SPECTRAL, rings(), ("rapid_criteria",), ()),
    "the binary rule": (HARMONIC, FULL, ("binarize", *GATE), ("binary", "candidates", "bounds")),
    "the grey rule": (FULL, HARMONIC, (), ("lists",)),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_a_configuration_does_not_need_is_left_out(detector_in_form, form, name):
    config, than, launches, buffers = LEFT_OUT[name]
    launches = {each[form] if isinstance(each, dict) else each for each in launches}
    plan, launched, kernels = plan_of(detector_in_form, config)
    full, full_launched, full_kernels = plan_of(detector_in_form, than)
    assert launches <= full_launched <= full_kernels
    assert set(buffers) <= set(full.arrays)
    assert not launches & (launched | kernels)
    assert not set(buffers) & set(plan.arrays)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])
@pytest.mark.parametrize(
    "config",
    [DetectorConfig(), rings(), rings(criteria=SpectralCriteria(), refinement=Midlines())],
    ids=["harmonic", "rings", "spectral"],
)
def test_a_detector_needs_at_most_nine_bytes_a_pixel_besides_the_image(
    device_in_form, config, dtype
):
    shape = (480, 640)
    with Detector(shape=shape, dtype=dtype, config=config, device=device_in_form) as detector:
        besides = detector.memory - detector._plans.lend().sizes["image"]
        assert besides <= 9 * shape[0] * shape[1]
