"""The features that every OpenCL 1.2 device has are enough, and each form runs on all of them.

The tests are few enough for a slow device, and for a simulator that checks each memory access. On
the default device tests/kernels has both forms too, of other configurations and images.
"""

import re
from pathlib import Path

import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from configs import CONFIGS, rings
from detectors import in_form

from cmp_cl import AdaptiveMean, Detector, DetectorConfig, SpectralCriteria
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.opencl.program import kernel_folder
from cmp_cl.stages.layout import PlanBase

VECTORS = sorted((Path(__file__).resolve().parent / "data").glob("*.npz"))
QUICK = [path for path in VECTORS if path.stem in ("ties-paper", "harmonic-noise")]
FRAME = images.scene().image[20:53, 30:71].copy()  # 33 x 41
FEW = np.where(np.arange(41) < 16, FRAME, 128).astype(np.uint8)
DEEP = FRAME.astype(np.uint16) * 16 + 7
OF_12_BITS = {
    "12 bits": DetectorConfig(),
    "12 bits, offset": rings(threshold=AdaptiveMean(window=255, offset=3)),
    "12 bits, spectral": rings(criteria=SpectralCriteria()),
}
CASES = {name: (config, [FRAME, FEW]) for name, config in CONFIGS.items()}
for name, config in OF_12_BITS.items():
    CASES[name] = config.replace(full_scale=4095), [DEEP, DEEP[::-1].copy()]


@pytest.fixture
def other_form(device, form):
    """Return the device under test in the form that is not its own; a simulator has both."""
    if form is device.kind and "Oclgrind" not in device.platform:
        pytest.skip("most tests run in this form")
    return in_form(device, form)


def check(device, config, frames):
    """Assert that frames give the oracle's corners, alone, in a batch and in a stream; return the
    numbers of corners."""
    with Detector(
        shape=frames[0].shape, dtype=frames[0].dtype, config=config, device=device
    ) as detector:
        alone = [assert_corners_equal(detector, frame) for frame in frames]
        for results in (detector.batch(frames), list(detector.stream(frames))):
            for one, other in zip(results, alone, strict=True):
                assert_same_bytes(one, other)
        assert_maps_equal(detector, frames[0])
    return [len(corners) for corners in alone]


@pytest.mark.parametrize("name", CASES)
def test_every_kernel_equals_the_oracle_in_every_form(other_form, name):
    assert check(other_form, *CASES[name])[0] > 0


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CASES)
def test_groups_of_many_work_items_find_what_one_finds(device, monkeypatch, name):
    """A CPU runs the kernels of whole work-groups with one work-item each, cards with many."""
    monkeypatch.setattr(PlanBase, "_on_cpu", False)
    config, (frame, *_) = CASES[name]
    pair = images.scene(2).image, images.texture((96, 128))
    frames = [image.astype(frame.dtype) * (1 if frame.dtype == np.uint8 else 16) for image in pair]
    assert min(check(in_form(device, DeviceKind.GPU), config, frames)) > 0


@pytest.mark.parametrize("path", some(VECTORS, QUICK), ids=lambda path: path.stem)
def test_stored_images_give_the_oracles_whole_numbers_on_every_device(device, path):
    """The oracle equals the maps and corners that are stored with them, see tests/reference."""
    with np.load(path) as file:
        image, full_scale = file["image"], int(file["full_scale"])
    for config in (DetectorConfig(), rings(), DetectorConfig.paper(30)):
        check(device, config.replace(full_scale=full_scale), [image])


def test_kernels_use_nothing_optional():
    """No doubles, halves, images, printf, sub-groups or extensions.

    `#pragma unroll` is allowed: a compiler that does not know it ignores it (C99, 6.10.6). Points
    in space are doubles in a part that only devices that have them compile.
    """
    optional = r"\b(image\dd\w*|printf|sub_group\w*|half|double\d*)\b"
    optional += r"|#\s*pragma(?! unroll$| OPENCL FP_CONTRACT OFF$)"
    files = sorted(kernel_folder().rglob("*.cl*"))
    assert len(files) > 20
    for path in files:
        text = re.sub(r"/\*.*?\*/|//[^\n]*", "", path.read_text("utf-8"), flags=re.DOTALL)
        text = re.sub(r"#if DOUBLE\n.*?#else\n", "", text, flags=re.DOTALL)
        assert re.findall(optional, text, re.MULTILINE) == [], path.name
