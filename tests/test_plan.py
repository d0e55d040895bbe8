"""What a configuration leaves out is not compiled, not launched and not allocated."""

import dataclasses

import images
import numpy as np
import pyopencl as cl
import pytest
from cmp_cl.stages.refine_stages import RESULT_HEAD
from configs import rings
from detectors import detectors_on

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Detector,
    DetectorConfig,
    DeviceKind,
    EdgeLines,
    EdgeStep,
    Midlines,
    RapidCriteria,
    SpectralCriteria,
)

IMAGE = images.eight_bits()["board"]
FULL = DetectorConfig(
    detection=BinaryRings(threshold=AdaptiveMean(masks=3)),
    scale=0.63,
    refinement=EdgeStep(),
    max_corners=512,
)


@pytest.fixture(
    scope="module", params=[DeviceKind.CPU, DeviceKind.GPU], ids=lambda kind: kind.value
)
def form(request, device):
    """The device under test, taken for one of each kind."""
    return dataclasses.replace(device, kind=request.param)


@pytest.fixture(scope="module")
def detector_for(form):
    with detectors_on(form) as make:
        yield make


def plan_of(detector_for, config):
    detector = detector_for(IMAGE, config)
    assert len(detector(IMAGE)) > 0
    plan = detector._plan(config.scale)
    kernels = plan.kernels._program.kernel_names.split(";")
    launched = [launch.stage for launch in plan.launches]
    assert set(launched) <= set(kernels)
    assert set(plan.buffers) == set(plan.sizes)
    for name, buffer in plan.buffers.items():
        assert buffer.size == max(plan.sizes[name], 4), name
    every = [each.buffers.values() for each in detector._plans.values()]
    assert detector.memory == sum(buffer.size for buffers in every for buffer in buffers)
    return plan, set(launched), set(kernels)


def left_out(detector_for, config, *, files=(), launches=(), buffers=(), than=FULL):
    """Those files, kernels and buffers are there in the one configuration, not in the other."""
    plan, launched, kernels = plan_of(detector_for, config)
    full, full_launched, full_kernels = plan_of(detector_for, than)
    assert set(files) <= set(full.stages)
    assert set(launches) <= full_launched <= full_kernels
    assert set(buffers) <= set(full.arrays)
    assert not set(files) & set(plan.stages)
    assert not set(launches) & launched
    assert not set(launches) & kernels
    assert not set(buffers) & set(plan.arrays)
    assert sum(plan.sizes.values()) <= sum(full.sizes.values())


def test_the_gate(detector_for, form):
    kernels = {
        DeviceKind.CPU: ["gate_words", "percentile"],
        DeviceKind.GPU: ["noise", "sector_contrast", "percentile"],
    }
    bins = {DeviceKind.CPU: ["bins_of_bands"], DeviceKind.GPU: ["bins"]}
    left_out(
        detector_for,
        rings(FULL, contrast=None),
        files=["gate"],
        launches=kernels[form.kind],
        buffers=["contrast", "noise", *bins[form.kind], "found", "bounds"],
    )


def test_refinement(detector_for, form):
    kernels = {
        DeviceKind.CPU: ["refine_eight", "edge_step_eight"],
        DeviceKind.GPU: ["edge_lines", "edge_step"],
    }
    left_out(
        detector_for,
        FULL.replace(refinement=None),
        launches=kernels[form.kind],
        buffers=["lines"],
    )


def test_extra_masks(detector_for, form):
    kernels = {DeviceKind.CPU: [], DeviceKind.GPU: ["column_squares", "binarize_three"]}
    buffers = {DeviceKind.CPU: ["square_prefix"], DeviceKind.GPU: []}
    left_out(
        detector_for,
        rings(FULL, threshold=AdaptiveMean()),
        launches=kernels[form.kind],
        buffers=["squares", *buffers[form.kind]],
    )


def test_the_working_scale(detector_for, form):
    forms = {DeviceKind.CPU: ("scale_bands", "resample_bands")}
    file, launch = forms.get(form.kind, ("scale", "resample"))
    left_out(
        detector_for,
        rings(FULL, scale=None, threshold=AdaptiveMean()),
        files=[file],
        launches=[launch],
        buffers=["working"],
        than=rings(FULL, scale=2.0, threshold=AdaptiveMean()),
    )


def test_the_other_form_of_the_criteria(detector_for):
    rapid, _, rapid_kernels = plan_of(detector_for, rings())
    spectral, _, spectral_kernels = plan_of(
        detector_for, DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria()))
    )
    assert "spectral" not in rapid.stages
    assert not {"criteria", "criteria_words"} & set(spectral.stages)
    assert not any("spectral" in name for name in rapid_kernels)
    assert not any("rapid" in name or "words" in name for name in spectral_kernels)
    assert not {"words", "candidate_words"} & set(spectral.sizes)


def test_the_other_refinements(detector_for):
    kernels = {
        kind: plan_of(detector_for, DetectorConfig(refinement=kind()))[2]
        for kind in (EdgeLines, EdgeStep, Midlines)
    }
    assert "edge_step" not in kernels[EdgeLines]
    assert "midlines" not in kernels[EdgeLines] | kernels[EdgeStep]
    assert not {"edge_lines", "edge_step"} & kernels[Midlines]


@pytest.mark.parametrize("criteria", [RapidCriteria, SpectralCriteria])
def test_the_corrosion_criterion(detector_for, criteria):
    """Its region of 21 pixels is not looked at: the macro that reads it is not compiled."""
    options = []
    for threshold in (6, None):
        config = DetectorConfig(
            detection=BinaryRings(criteria=criteria(corrosion_threshold=threshold))
        )
        program = plan_of(detector_for, config)[0].kernels._program
        device = program.devices[0]
        build = program.get_build_info(device, cl.program_build_info.OPTIONS)
        options.append(build)
    assert "-DCORROSION=1" in options[0]
    assert "-DCORROSION=0" in options[1]


@pytest.mark.parametrize("kind", DeviceKind, ids=lambda kind: kind.value)
@pytest.mark.parametrize("refinement", [None, EdgeLines(), EdgeStep(), Midlines()])
def test_a_flat_frame_needs_no_refinement(device, kind, refinement):
    """Refinement stops at the number of corners: it writes nothing where there are none."""
    form = dataclasses.replace(device, kind=kind)
    config = DetectorConfig(refinement=refinement)
    with Detector(shape=IMAGE.shape, device=form, config=config) as detector:
        plan = detector._plan(None)
        result = plan.arrays["result"]
        before = np.full(result.size // 4, 7, np.float32)
        cl.enqueue_copy(plan.queue, result, before)
        assert len(detector(images.eight_bits()["black"])) == 0
        after = np.empty_like(before)
        cl.enqueue_copy(plan.queue, after, result)
        np.testing.assert_array_equal(after[RESULT_HEAD:], before[RESULT_HEAD:])
        assert len(detector(IMAGE)) > 0
        cl.enqueue_copy(plan.queue, after, result)
        assert (after != before)[RESULT_HEAD:].any()


@pytest.mark.parametrize("shape", [(480, 640), (1200, 1600)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_full_configuration_needs_at_most_eight_bytes_a_pixel(form, dtype, shape):
    """Beyond the image, on which three masks, the gate and EDGE_STEP work."""
    config = DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(masks=3)), refinement=EdgeStep()
    )
    with Detector(shape=shape, dtype=dtype, config=config, device=form) as detector:
        beyond = detector.memory - detector._plan(None).sizes["image"]
    assert beyond <= 8 * shape[0] * shape[1]
