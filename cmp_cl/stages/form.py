"""The two forms of the kernels: the portable one, and the one for CPUs.

The portable form has one work-item per pixel or corner. In the form for CPUs a work-item handles a
band of rows, so that its data stay in the cache, or eight corners or pixels, which fill a vector.
kernels/cpu holds it for the stages in which it makes a whole frame at least 1.3 times as fast. The
results are the same.
"""

import enum

from cmp_cl.opencl.device import Device, DeviceKind


class Form(enum.Enum):
    """The form of a stage's kernels."""

    PORTABLE = "portable"
    CPU = "cpu"


def form_for(device: Device) -> Form:
    """Return the form that is fastest on a device."""
    return Form.CPU if device.kind is DeviceKind.CPU else Form.PORTABLE
