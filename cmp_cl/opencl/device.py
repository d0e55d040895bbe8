"""OpenCL devices: listing them and selecting one."""

import contextlib
import dataclasses
import enum
import os
from collections.abc import Iterator

import pyopencl as cl

from cmp_cl.errors import CapacityError, DeviceError
from cmp_cl.opencl import pocl

DEVICE_VARIABLE = "CMP_CL_DEVICE"

_VENDORS_VARIABLE = "OCL_ICD_VENDORS"
_VENDORS = "/etc/OpenCL/vendors"  # where the loader of OpenCL looks for drivers
_INSTALL_HINT = (
    "pip install 'pyopencl[pocl]' installs one for the CPU (Linux, x86-64), a GPU needs its "
    "vendor's; docs/devices.md lists them"
)


class DeviceKind(enum.Enum):
    """The kind of processor that a device is."""

    CPU = "cpu"
    GPU = "gpu"
    ACCELERATOR = "accelerator"


@dataclasses.dataclass(frozen=True)
class Device:
    """An OpenCL device.

    index: "platform:device", as `select_device` takes it.
    name, platform, driver: as the implementation reports them.
    kind: the kind of processor.
    memory: global memory, bytes.
    handle: the device as pyopencl knows it.
    """

    index: str
    name: str
    platform: str
    driver: str
    kind: DeviceKind
    memory: int
    handle: cl.Device = dataclasses.field(repr=False)

    def __str__(self) -> str:
        return f"{self.name} ({self.platform})"


_started_in: int | None = None  # the process, this one or a parent, in which OpenCL was used


def is_forked() -> bool:
    """Return whether this process was forked after OpenCL had started in its parent.

    Threads do not survive a fork, and an OpenCL implementation would wait for its own forever.
    """
    return _started_in not in (None, os.getpid())


def check_process() -> None:
    """Raise DeviceError if `is_forked`."""
    if is_forked():
        raise DeviceError(
            "this process was forked after OpenCL had started in its parent, and OpenCL does not "
            "survive a fork; start processes with multiprocessing.get_context('spawn') or "
            "'forkserver'"
        )


@contextlib.contextmanager
def clear_errors(device: cl.Device, needed: int = 0) -> Iterator[None]:
    """Raise CapacityError for an error of OpenCL in this block that means too little memory,
    DeviceError for another.

    needed: the bytes that the block allocates; then every error means that.
    """
    try:
        yield
    except cl.Error as error:
        name = device.name.strip()
        if not needed and not isinstance(error, cl.MemoryError):
            raise DeviceError(f"{name} has failed: {error}; `cmp-cl devices` tries it") from error
        size = f" of {needed} bytes" if needed else ""
        raise CapacityError(
            f"{name} has not enough memory for a plan{size}, though it has "
            f"{device.global_mem_size}: {error}; close what else uses it, or use smaller images or "
            "fewer frames at a time"
        ) from error


def list_devices() -> list[Device]:
    """Return all OpenCL devices, in the order of the platforms; empty if there is none.

    Raises DeviceError in a forked child of a process that has used OpenCL.
    """
    global _started_in
    check_process()
    _started_in = os.getpid()
    with pocl.workers_on_own_cores():
        return [
            _describe(handle, f"{p}:{d}")
            for p, platform in enumerate(_platforms())
            for d, handle in enumerate(_devices(platform))
        ]


def select_device(text: Device | str | None = None) -> Device:
    """Return the device that a text names: "0:0" (platform:device), "cpu", "gpu", or a part of its
    name or of its platform's name, case ignored. If several match, it is the first in
    `list_devices`. A Device is returned as it is.

    None means the variable CMP_CL_DEVICE if it is set and not empty, else the first GPU, else the
    first CPU, else the first device.

    Raises DeviceError, which lists what there is, if nothing matches.
    """
    if isinstance(text, Device):
        return text
    devices = list_devices()
    wanted = text if text is not None else os.environ.get(DEVICE_VARIABLE) or None
    if not devices:
        raise DeviceError(f"no OpenCL device was found: {why_none()}")
    if wanted is None:
        ranks = {DeviceKind.GPU: 0, DeviceKind.CPU: 1, DeviceKind.ACCELERATOR: 2}
        return min(devices, key=lambda device: ranks[device.kind])
    matches = [device for device in devices if _matches(device, wanted.strip().lower())]
    if not wanted.strip() or not matches:
        known = "; ".join(f"{device.index} {device}" for device in devices)
        source = "" if text is not None else f" (from {DEVICE_VARIABLE})"
        raise DeviceError(f"no OpenCL device matches {wanted!r}{source}; there is: {known}")
    return matches[0]


def why_none() -> str:
    """Return why no device is found, as far as that can be seen."""
    folder = os.environ.get(_VENDORS_VARIABLE) or _VENDORS
    stuck = pocl.reason_stuck()
    return stuck or f"no driver in {folder} can be loaded and has a device; {_INSTALL_HINT}"


def describe_handle(handle: cl.Device) -> Device:
    """Return the Device of a pyopencl device."""
    for device in list_devices():
        if device.handle == handle:
            return device
    return _describe(handle, "")


def _matches(device: Device, wanted: str) -> bool:
    if wanted in (device.index, device.kind.value):
        return True
    if wanted in [kind.value for kind in DeviceKind] or ":" in wanted:
        return False
    return wanted in device.name.lower() or wanted in device.platform.lower()


def _platforms() -> list[cl.Platform]:
    try:
        return list(cl.get_platforms())
    except cl.Error:  # the loader found no implementation
        return []


def _devices(platform: cl.Platform) -> list[cl.Device]:
    try:
        return list(platform.get_devices())
    except cl.Error:  # a platform without a device
        return []


def _describe(handle: cl.Device, index: str) -> Device:
    pocl.name_processor(handle)
    kind = DeviceKind.ACCELERATOR
    if handle.type & cl.device_type.GPU:
        kind = DeviceKind.GPU
    elif handle.type & cl.device_type.CPU:
        kind = DeviceKind.CPU
    return Device(
        index=index,
        name=handle.name.strip(),
        platform=handle.platform.name.strip(),
        driver=handle.driver_version.strip(),
        kind=kind,
        memory=int(handle.global_mem_size),
        handle=handle,
    )
