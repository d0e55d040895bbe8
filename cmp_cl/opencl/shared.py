"""Memory that the host and a device share, so that data need no copy.

Devices that work in the host's memory, as CPUs do, offer it as fine-grained shared virtual memory
(OpenCL 2.0). It may be touched by the host whenever no kernel that uses it runs.
"""

from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from pyopencl.characterize import has_fine_grain_buffer_svm

_ALIGNMENT = 128  # bytes, the size of the largest type of OpenCL C
_svm_empty: Any = cl.svm_empty  # its stub has other types than the function
_has_fine_grained: Any = has_fine_grain_buffer_svm  # it has no types


def shares_memory(device: cl.Device) -> bool:
    """Return whether a device can work in the host's memory, without a copy."""
    fine_grained: bool = _has_fine_grained(device)
    return bool(device.host_unified_memory) and fine_grained


def shared_buffer(context: cl.Context, size: int) -> tuple[cl.Buffer, NDArray[np.uint8]]:
    """Return a buffer of `size` bytes, and the same memory as an array of the host.

    The memory is released when both are gone, which must not happen while a kernel uses it.
    """
    flags = cl.svm_mem_flags.READ_WRITE | cl.svm_mem_flags.SVM_FINE_GRAIN_BUFFER
    memory = _svm_empty(context, flags, (size,), np.uint8, alignment=_ALIGNMENT)
    around = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
    return cl.Buffer(context, around, hostbuf=memory), memory
