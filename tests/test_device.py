"""The list of devices, and the choice of one."""

import os

import pyopencl as cl
import pytest

from cmp_cl import Device, list_devices, select_device
from cmp_cl.errors import DeviceError
from cmp_cl.opencl import device as module
from cmp_cl.opencl.device import DeviceKind


def made_up(index: str, name: str, platform: str, kind: DeviceKind) -> Device:
    return Device(
        index=index, name=name, platform=platform, driver="1", kind=kind, memory=1, handle=None
    )


POCL = made_up("0:0", "cpu-haswell", "Portable Computing Language", DeviceKind.CPU)
FIRST = made_up("1:0", "NVIDIA A100", "NVIDIA CUDA", DeviceKind.GPU)
SECOND = made_up("1:1", "NVIDIA T4", "NVIDIA CUDA", DeviceKind.GPU)
OTHER = made_up("2:0", "FPGA board", "Boards", DeviceKind.ACCELERATOR)


@pytest.fixture
def lab(monkeypatch):
    """Pretend that three platforms have four devices, and that no variable chooses one."""
    monkeypatch.setattr(module, "list_devices", lambda: [POCL, FIRST, SECOND, OTHER])
    monkeypatch.delenv("CMP_CL_DEVICE", raising=False)
    return monkeypatch


@pytest.mark.parametrize("count", ["-1", " -3 ", "100000"])
def test_a_number_of_workers_that_would_end_the_process_is_refused(monkeypatch, count):
    monkeypatch.setenv("POCL_MAX_PTHREAD_COUNT", count)
    with pytest.raises(DeviceError, match="POCL_MAX_PTHREAD_COUNT is"):
        list_devices()


def test_a_cache_that_pocl_cannot_write_is_named_where_no_device_is_found(monkeypatch, tmp_path):
    monkeypatch.setattr("cmp_cl.opencl.device._platforms", list)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "under"))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match=r"PoCL cannot write to its cache .*under"):
        select_device()


def test_the_device_under_test_describes_itself(device):
    assert device in list_devices()
    assert isinstance(device.handle, cl.Device)
    assert device.memory > 2**20
    assert str(device) == f"{device.name} ({device.platform})"
    assert select_device(device.index) == device
    assert module.describe_handle(device.handle) == device
    assert isinstance(device.kind, DeviceKind)
    assert device.driver


def test_indices_are_platform_and_device():
    devices = list_devices()
    assert len({device.index for device in devices}) == len(devices) > 0
    for device in devices:
        platform, number = map(int, device.index.split(":"))
        assert cl.get_platforms()[platform].get_devices()[number] == device.handle


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:0", POCL),
        ("1:1", SECOND),
        ("cpu", POCL),
        ("GPU", FIRST),
        ("accelerator", OTHER),
        ("nvidia", FIRST),
        ("t4", SECOND),
        (" Portable ", POCL),
        ("boards", OTHER),
    ],
)
def test_the_requested_device_is_selected(lab, text, expected):
    assert select_device(text) == expected


@pytest.mark.parametrize("text", ["intel", "3:0", "1:2", "", "  ", "0:0:0", ":"])
def test_a_device_that_is_not_there_is_an_error_that_lists_the_devices(lab, text):
    with pytest.raises(DeviceError, match="no OpenCL device matches") as error:
        select_device(text)
    for known in (POCL, FIRST, SECOND, OTHER):
        assert f"{known.index} {known}" in str(error.value)


def test_without_a_text_the_variable_decides(lab):
    lab.setenv("CMP_CL_DEVICE", "t4")
    assert select_device() == SECOND
    assert select_device("cpu") == POCL
    lab.setenv("CMP_CL_DEVICE", "intel")
    with pytest.raises(DeviceError, match="from CMP_CL_DEVICE"):
        select_device()
    lab.setenv("CMP_CL_DEVICE", "")
    assert select_device() == FIRST


def test_without_either_a_gpu_comes_before_a_cpu(lab):
    assert select_device() == FIRST
    lab.setattr(module, "list_devices", lambda: [OTHER, POCL])
    assert select_device() == POCL
    lab.setattr(module, "list_devices", lambda: [OTHER])
    assert select_device() == OTHER


def test_no_device_says_what_to_install(lab, tmp_path):
    lab.setattr(module, "list_devices", lambda: [])
    lab.setenv("OCL_ICD_VENDORS", str(tmp_path))
    for text in (None, "cpu"):
        with pytest.raises(DeviceError, match=r"pip install 'pyopencl\[pocl\]'"):
            select_device(text)


def test_no_platform_is_no_device(monkeypatch):
    def no_platform():
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", no_platform)
    assert list_devices() == []
    with pytest.raises(DeviceError, match="no OpenCL device found"):
        select_device()


# --- PoCL's workers -------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch):
    """Return POCL_AFFINITY as PoCL sees it when the platforms are asked for, on four cores."""
    for name in ("POCL_AFFINITY", "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3}, raising=False)
    seen = []

    def no_platforms():
        seen.append(os.environ.get("POCL_AFFINITY"))
        return []

    monkeypatch.setattr(cl, "get_platforms", no_platforms)
    return seen


def test_workers_keep_to_cores_of_their_own(asked):
    assert list_devices() == []
    assert asked == ["1"]
    assert "POCL_AFFINITY" not in os.environ


@pytest.mark.parametrize("name", ["POCL_AFFINITY", "POCL_MAX_PTHREAD_COUNT"])
def test_the_users_own_setting_of_workers_is_kept(asked, monkeypatch, name):
    monkeypatch.setenv(name, "0")
    assert list_devices() == []
    assert asked == [os.environ.get("POCL_AFFINITY")]
    assert os.environ[name] == "0"
