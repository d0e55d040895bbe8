"""The form of the kernels: portable, one work-item per pixel or corner, or the one for CPUs.

Both have the same results. A stage that has a form for CPUs keeps it in kernels/cpu, because it
makes a whole frame at least 1.3 times as fast there.
"""

import enum

from cmp_cl.opencl.device import Device, DeviceKind


class Form(enum.Enum):
    """Which kernels of a stage run."""

    PORTABLE = "portable"
    CPU = "cpu"


def form_for(device: Device) -> Form:
    """Return the form that is fastest on a device."""
    return Form.CPU if device.kind is DeviceKind.CPU else Form.PORTABLE
