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


POCL = made_up("0:0", "cpu-3:0, not a GPU", "Portable Computing Language", DeviceKind.CPU)
FIRST = made_up("1:0", "NVIDIA A100", "NVIDIA CUDA", DeviceKind.GPU)
SECOND = made_up("1:1", "NVIDIA T4", "NVIDIA CUDA", DeviceKind.GPU)
OTHER = made_up("2:0", "FPGA board", "Boards", DeviceKind.ACCELERATOR)


@pytest.fixture
def lab(monkeypatch):
    """Pretend that three platforms have four devices, and that no variable chooses one."""
    monkeypatch.setattr(module, "list_devices", lambda: [POCL, FIRST, SECOND, OTHER])
    monkeypatch.delenv("CMP_CL_DEVICE", raising=False)
    return monkeypatch


def test_a_cache_that_pocl_cannot_write_is_named_where_no_device_is_found(monkeypatch, tmp_path):
    monkeypatch.setattr("cmp_cl.opencl.device._platforms", list)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "under"))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match=r"write to its cache .*under.*; POCL_CACHE_DIR"):
        select_device()


def test_devices_have_the_indices_of_platform_and_device_and_describe_themselves(device):
    devices = list_devices()
    assert device in devices
    assert len({each.index for each in devices}) == len(devices)
    for each in devices:
        platform, number = map(int, each.index.split(":"))
        assert cl.get_platforms()[platform].get_devices()[number] == each.handle
        assert module.describe_handle(each.handle) == select_device(each.index) == each
        assert str(each) == f"{each.name} ({each.platform})"
        assert each.memory > 2**20


@pytest.mark.parametrize(
    ("text", "variable", "expected"),
    [
        ("0:0", "", POCL),
        ("1:1", "gpu", SECOND),
        ("GPU", "cpu", FIRST),
        ("accelerator", "", OTHER),
        ("t4", "", SECOND),
        (" Portable ", "", POCL),
        (None, "t4", SECOND),
        (None, "", FIRST),
    ],
)
def test_the_requested_device_is_selected_else_the_variables_else_a_gpu(
    lab, text, variable, expected
):
    lab.setenv("CMP_CL_DEVICE", variable)
    assert select_device(text) == expected


def test_without_a_gpu_the_first_cpu_is_the_default(lab):
    for devices in ([OTHER, POCL], [POCL]):
        lab.setattr(module, "list_devices", lambda devices=devices: devices)
        assert select_device() == POCL


@pytest.mark.parametrize("text", ["intel", "3:0", "1:2", "", "  ", "0:0:0", ":"])
def test_a_device_that_is_not_there_is_an_error_that_lists_the_devices(lab, text):
    with pytest.raises(DeviceError, match="no OpenCL device matches") as error:
        select_device(text)
    for known in (POCL, FIRST, SECOND, OTHER):
        assert f"{known.index} {known}" in str(error.value)
    lab.setenv("CMP_CL_DEVICE", "intel")
    with pytest.raises(DeviceError, match="from CMP_CL_DEVICE"):
        select_device()


# --- PoCL's workers -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "cores", "seen"),
    [
        ({}, {0, 1, 2, 3}, "1"),
        ({}, {2, 3}, None),  # a process with some of the cores shares them
        ({"POCL_AFFINITY": "0"}, {0, 1, 2, 3}, "0"),
        ({"POCL_MAX_PTHREAD_COUNT": "2"}, {0, 1, 2, 3}, None),
    ],
)
def test_workers_keep_to_cores_of_their_own_unless_the_user_says_otherwise(
    monkeypatch, given, cores, seen
):
    asked = []
    for name in ("POCL_AFFINITY", "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: cores, raising=False)
    platforms = lambda: asked.append(os.environ.get("POCL_AFFINITY")) or []  # noqa: E731
    monkeypatch.setattr(cl, "get_platforms", platforms)
    assert list_devices() == []
    assert asked == [seen]
    assert os.environ.get("POCL_AFFINITY") == given.get("POCL_AFFINITY")
