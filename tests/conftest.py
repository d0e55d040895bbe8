"""Which devices the tests run on, and detectors that tests share.

`pytest --device TEXT` (repeatable) or the variable CMP_CL_DEVICE chooses, by the texts that
`select_device` takes; without either it is the default device. A device that is not there
fails every test that needs one.
"""

import os
from collections.abc import Iterator

import pytest
from detectors import MakeDetector, detectors_on

from cmp_cl import Device, select_device
from cmp_cl.opencl.device import DEVICE_VARIABLE


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--device",
        action="append",
        default=[],
        metavar="TEXT",
        help="OpenCL device to test on, as cmp_cl.select_device takes it; repeatable",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: takes more than ten seconds")
    texts = config.getoption("device")
    if texts:  # for what is tested through the default device
        os.environ[DEVICE_VARIABLE] = texts[0]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "device" in metafunc.fixturenames:
        texts = metafunc.config.getoption("device") or [None]
        ids = [text or "default" for text in texts]
        metafunc.parametrize("device", texts, ids=ids, indirect=True, scope="session")


@pytest.fixture(scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """The device under test."""
    return select_device(request.param)


@pytest.fixture(scope="session")
def detector_for(device: Device) -> Iterator[MakeDetector]:
    """detector_for(image, config, mask): a detector for images like it, made only once."""
    with detectors_on(device) as make:
        yield make
