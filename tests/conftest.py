"""Which devices the tests run on, and detectors that tests share.

`pytest --device TEXT` (repeatable) or the variable CMP_CL_DEVICE chooses, by the texts that
`select_device` takes; without either it is the default device. A device that is not there
fails every test that needs one.
"""

import contextlib
import os
from collections.abc import Iterator

import pytest
from detectors import FORMS, MakeDetector, detectors_on, in_form, in_other_form

from cmp_cl import Device, select_device
from cmp_cl.opencl import program
from cmp_cl.opencl.device import DEVICE_VARIABLE, DeviceKind

BOTH_FORMS = "lattice", "motion"  # folders; detection has tests of its own for each form
EXHAUSTIVE = pytest.mark.exhaustive


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--device",
        action="append",
        default=[],
        metavar="TEXT",
        help="OpenCL device to test on, as cmp_cl.select_device takes it; repeatable",
    )


def pytest_configure(config: pytest.Config) -> None:
    # Each process of -n has a core; more threads of NumPy's would only wait for one another.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    texts = config.getoption("device")
    if texts:  # for tests that use the default device
        os.environ[DEVICE_VARIABLE] = texts[0]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" not in metafunc.fixturenames:
        return
    cases = []
    for text in metafunc.config.getoption("device") or [None]:
        name = text or "default"
        cases.append(pytest.param((text, False), id=name))
        if metafunc.definition.path.parent.name in BOTH_FORMS:
            other = pytest.param((text, True), id=f"{name} in its other form", marks=EXHAUSTIVE)
            cases.append(other)
    metafunc.parametrize("device", cases, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """Return the device under test, in BOTH_FORMS also in the form that is not its own."""
    text, other = request.param
    device = select_device(text)
    return in_other_form(device) if other else device


@pytest.fixture(scope="session")
def detector_for(device: Device) -> Iterator[MakeDetector]:
    """Yield detector_for(image, config, mask): a detector for images like it, made only once."""
    with detectors_on(device) as make:
        yield make


@pytest.fixture
def own_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each detector load or compile its programs itself, as the first one of a process does."""
    monkeypatch.setattr(program, "_shared", program._shared.__wrapped__)


@pytest.fixture(params=FORMS, ids=lambda form: form.value)
def form(request: pytest.FixtureRequest) -> DeviceKind:
    """Return each form of the kernels in turn."""
    return request.param


@pytest.fixture
def device_in_form(device: Device, form: DeviceKind) -> Device:
    """Return the device under test, on which the kernels have that form."""
    return in_form(device, form)


@pytest.fixture(scope="session")
def detectors_by_form(device: Device) -> Iterator[dict[DeviceKind, MakeDetector]]:
    """Yield what makes detectors, as `detector_for`, for each form."""
    with contextlib.ExitStack() as stack:
        yield {form: stack.enter_context(detectors_on(in_form(device, form))) for form in FORMS}


@pytest.fixture
def detector_in_form(
    detectors_by_form: dict[DeviceKind, MakeDetector], form: DeviceKind
) -> MakeDetector:
    """Return detector_in_form(image, config, mask): as `detector_for`, in each form in turn."""
    return detectors_by_form[form]
