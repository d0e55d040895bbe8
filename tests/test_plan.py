"""Stages that a configuration leaves out are not compiled, not launched and not allocated."""

import itertools

import images
import numpy as np
import pyopencl as cl
import pytest
from configs import rings

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Detector,
    DetectorConfig,
    Device,
    EdgeLines,
    EdgeStep,
    Fit,
    Midlines,
    RingHarmonic,
    SpectralCriteria,
)
from cmp_cl.stages.form import Form
from cmp_cl.stages.plan import Plan
from cmp_cl.stages.refine import RESULT_HEAD

IMAGE = images.eight_bits()["board"]
FULL = DetectorConfig(
    detection=BinaryRings(),
    scale=0.63,
    refinement=EdgeStep(),
    max_corners=512,
)
HARMONIC = DetectorConfig(refinement=EdgeStep())


@pytest.fixture(scope="module")
def detector_for(detector_in_form):
    return detector_in_form


def plan_of(detector_for, config):
    detector = detector_for(IMAGE, config)
    assert len(detector(IMAGE)) > 0
    plan = detector._plans.lend()
    kernels = plan.kernels.names
    launched = [launch.stage for launch in plan.launches]
    assert set(launched) <= kernels
    assert set(plan.buffers) == set(plan.sizes)
    for name, buffer in plan.buffers.items():
        assert buffer.size == max(plan.sizes[name], 4), name
    every = [each.buffers.values() for each in detector._plans]
    assert detector.memory == sum(buffer.size for buffers in every for buffer in buffers)
    return plan, set(launched), kernels


SCALED = rings(FULL, scale=2.0)
SPECTRAL = DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria()))
GATE = ("sector_contrast", "percentile", "pass_gate")
STEP = {Form.CPU: "edge_step_eight", Form.PORTABLE: "edge_step"}
LINES = {Form.CPU: "edge_lines_eight", Form.PORTABLE: "edge_lines"}
LEFT_OUT = {  # a configuration, one that has more, and its kernels and buffers
    "the gate": (
        rings(FULL, contrast=None),
        FULL,
        ("noise", *GATE),
        ("contrast", "noise", "bins", "found", "bounds", "passed"),
    ),
    "the working scale": (FULL.replace(scale=None), SCALED, ("resample",), ("working",)),
    "a refinement": (FULL.replace(refinement=None), FULL, (STEP,), ()),
    "the other refinement": (DetectorConfig(refinement=EdgeLines()), HARMONIC, (STEP,), ()),
    "lines for the step": (HARMONIC, DetectorConfig(refinement=EdgeLines()), (LINES,), ()),
    "the rapid criteria": (SPECTRAL, rings(), ("rapid_criteria",), ()),
    "the binary rule": (HARMONIC, FULL, ("binarize", *GATE), ("binary", "candidates", "bins")),
    "the grey rule": (FULL, HARMONIC, (), ("lists",)),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_a_configuration_does_not_need_is_left_out(detector_for, form, name):
    config, than, launches, buffers = LEFT_OUT[name]
    launches = {each[form] if isinstance(each, dict) else each for each in launches}
    plan, launched, kernels = plan_of(detector_for, config)
    full, full_launched, full_kernels = plan_of(detector_for, than)
    assert launches <= full_launched <= full_kernels
    assert set(buffers) <= set(full.arrays)
    assert not launches & (launched | kernels)
    assert not set(buffers) & set(plan.arrays)


@pytest.mark.parametrize("refinement", [None, EdgeLines(), EdgeStep(), Midlines()])
def test_refinement_writes_nothing_for_a_frame_without_corners(device_in_form, refinement):
    """Refinement stops at the number of corners."""
    config = DetectorConfig(refinement=refinement)
    with Detector(shape=IMAGE.shape, device=device_in_form, config=config) as detector:
        plan = detector._plans.lend()
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


# --- arguments and memory, in every configuration --------------------------------------------

DETECTIONS = {
    "harmonic": RingHarmonic(),
    "wide cells": RingHarmonic(fine=False),
    "rings": BinaryRings(),
    "rings without the gate": BinaryRings(contrast=None),
    "wide window": BinaryRings(threshold=AdaptiveMean(window=255)),
    "spectral": BinaryRings(criteria=SpectralCriteria()),
}
REFINEMENTS = {
    "centroids": None,
    "lines": EdgeLines(),
    "step": EdgeStep(),
    "midlines": Midlines(),
    "quadratic": Midlines(fit=Fit.QUADRATIC),
}
CONFIGS = {
    **{
        name: DetectorConfig(detection=detection, refinement=EdgeStep())
        for name, detection in DETECTIONS.items()
    },
    **{name: DetectorConfig(refinement=each) for name, each in REFINEMENTS.items()},
    "scaled lines": DetectorConfig(detection=RingHarmonic(octaves=0), scale=0.5),
    "scaled step": DetectorConfig(
        detection=RingHarmonic(octaves=0), scale=0.5, refinement=EdgeStep()
    ),
    "scaled midlines": DetectorConfig(
        detection=RingHarmonic(octaves=0), scale=0.5, refinement=Midlines()
    ),
    "scaled centroids": DetectorConfig(
        detection=RingHarmonic(octaves=0), scale=0.5, refinement=None
    ),
    "suppression in 15 px": DetectorConfig(nms_radius=15),
}
QUICK = ("harmonic", "rings", "midlines", "scaled step")
configurations = pytest.mark.parametrize(
    "config",
    [
        pytest.param(config, id=name, marks=() if name in QUICK else pytest.mark.exhaustive)
        for name, config in CONFIGS.items()
    ],
)
pixels = pytest.mark.parametrize("dtype", [np.uint8, np.uint16], ids=["8 bits", "16 bits"])


BUILT_IN = "_cl_"  # PoCL puts it before an argument that is named like a built-in function


def names_of(kernel):
    """The names of a kernel's arguments; skips where OpenCL does not keep them."""
    try:
        names = [kernel.get_arg_info(n, cl.kernel_arg_info.NAME) for n in range(kernel.num_args)]
    except cl.RuntimeError as error:
        if error.code != cl.status_code.KERNEL_ARG_INFO_NOT_AVAILABLE:
            raise
        pytest.skip("this OpenCL implementation keeps no names of arguments")
    return [name.removeprefix(BUILT_IN) for name in names]


@pixels
@configurations
def test_every_argument_has_the_name_that_its_kernel_gives_it(device_in_form, config, dtype):
    with Detector(shape=IMAGE.shape, dtype=dtype, config=config, device=device_in_form) as detector:
        for launch in detector._plans.lend().launches:
            assert list(launch.arguments) == names_of(launch.kernel), launch.stage


class Unbuilt(Plan):
    """A plan that compiles and allocates nothing: only its sizes are used."""

    def _build(self):
        return None

    def _allocate(self):
        pass

    def _bind(self):
        pass


@pytest.mark.parametrize("shape", [(480, 640), (1200, 1600)], ids=str)
def test_buffers_need_at_most_eight_bytes_a_pixel_besides_the_image(device_in_form, shape):
    for (name, config), dtype in itertools.product(CONFIGS.items(), (np.uint8, np.uint16)):
        sizes = sizes_of(device_in_form, config, dtype, shape)
        besides = sum(sizes.values()) - sizes["image"]
        octaves = getattr(config.detection, "octaves", 0)  # a third of the pixels more
        most = 9 if octaves else 8
        assert besides <= most * shape[0] * shape[1], (name, dtype, sizes)


def sizes_of(device: Device, config: DetectorConfig, dtype: type, shape: tuple[int, int]):
    """Return the size of every buffer of a detector, bytes, without allocating any."""
    plan = Unbuilt(
        queue=None,
        programs=None,
        device=device,
        shape=shape,
        dtype=np.dtype(dtype),
        config=config,
        mask=None,
        frames=1,
    )
    return plan.sizes
