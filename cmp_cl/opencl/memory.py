"""Named arrays that a device and the host have.

Devices that work in the host's memory, as CPUs do, offer it as fine-grained shared virtual memory
(OpenCL 2.0). There both have the same memory, and nothing is copied.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import DTypeLike, NDArray
from pyopencl.characterize import has_fine_grain_buffer_svm

from cmp_cl.opencl.device import clear_errors, is_forked

ALIGNMENT = 128  # bytes: one that every device accepts for a sub-buffer, and every type
_svm_empty: Any = cl.svm_empty  # its stub has other types than the function
_has_fine_grained: Any = has_fine_grain_buffer_svm  # it has no types

Layout = Mapping[str, tuple[tuple[int, ...], DTypeLike]]


def shares_memory(device: cl.Device) -> bool:
    """Return whether a device can work in the host's memory, without a copy."""
    fine_grained: bool = _has_fine_grained(device)
    return bool(device.host_unified_memory) and fine_grained


def copy(queue: cl.CommandQueue, to: Any, source: Any, **how: Any) -> cl.Event:
    """Enqueue a copy, as pyopencl.enqueue_copy does."""
    with clear_errors(queue.device):
        event: cl.Event = cl.enqueue_copy(queue, to, source, **how)
        return event


class Memory:
    """Named arrays, 0 at first, that lie one after the other in one buffer, so that one copy moves
    all.

    shared: whether the device works in the host's memory; then the copies do nothing. arrays: the
    arrays of the host, by name. parts: the same on the device, as sub-buffers of `buffer`. The host
    may touch shared memory only while no kernel uses it.
    """

    def __init__(self, queue: cl.CommandQueue, layout: Layout) -> None:
        self._queue, self._layout = queue, layout
        self._starts, size = {}, 0
        for name, (shape, dtype) in layout.items():
            self._starts[name] = size
            own = int(np.prod(shape)) * np.dtype(dtype).itemsize
            size += -(-max(own, 1) // ALIGNMENT) * ALIGNMENT
        self.shared = shares_memory(queue.device)
        flags: Any = cl.mem_flags.READ_WRITE
        with clear_errors(queue.device, size):
            if self.shared:
                fine = cl.svm_mem_flags.READ_WRITE | cl.svm_mem_flags.SVM_FINE_GRAIN_BUFFER
                self._memory = _svm_empty(
                    queue.context, fine, (size,), np.uint8, alignment=ALIGNMENT
                )
                self._memory[:] = 0
                flags |= cl.mem_flags.USE_HOST_PTR
                self.buffer = cl.Buffer(queue.context, flags, hostbuf=self._memory)
            else:
                self._memory = np.zeros(size, np.uint8)
                self.buffer = cl.Buffer(queue.context, flags, size)
                cl.enqueue_fill_buffer(queue, self.buffer, np.zeros(1, np.uint8), 0, size)
                queue.finish()  # some devices allocate only now
            self.arrays = self._arrays_in(self._memory)
            self.parts: dict[str, cl.Buffer] = {
                name: self.buffer.get_sub_region(self._starts[name], max(values.nbytes, 1))
                for name, values in self.arrays.items()
            }

    def __del__(self) -> None:
        """Keep the memory until no kernel uses it."""
        if not is_forked():
            self._queue.finish()

    def upload(self, *names: str) -> None:
        """Enqueue the copy of these arrays to the device, of all if none is named."""
        if self.shared:
            return
        if not names:
            copy(self._queue, self.buffer, self._memory, is_blocking=False)
        for name in names:
            copy(self._queue, self.parts[name], self.arrays[name], is_blocking=False)

    def download(self, **counts: int) -> list[cl.Event]:
        """Enqueue the copy of all arrays from the device, or of the first elements of each row of
        some. Return the events of the copies."""
        if self.shared:
            return []
        if not counts:
            return [copy(self._queue, self._memory, self.buffer, is_blocking=False)]
        return [self._download(name, count) for name, count in counts.items() if count]

    def _download(self, name: str, count: int) -> cl.Event:
        array = self.arrays[name]
        rows, pitch = array.size // array.shape[-1], array.shape[-1] * array.itemsize
        return copy(
            self._queue,
            array,
            self.parts[name],
            buffer_origin=(0, 0, 0),
            host_origin=(0, 0, 0),
            region=(count * array.itemsize, rows, 1),
            buffer_pitches=(pitch, 0),
            host_pitches=(pitch, 0),
            is_blocking=False,
        )

    def copies(self) -> dict[str, NDArray[Any]]:
        """Return copies of the arrays of the host, by name."""
        return self._arrays_in(self._memory.copy())

    def _arrays_in(self, memory: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
        return {
            name: np.ndarray(shape, dtype, memory, self._starts[name])
            for name, (shape, dtype) in self._layout.items()
        }

    def release(self) -> None:
        """Release the device's memory, once no kernel uses it."""
        if is_forked():  # it belongs to the parent process
            return
        self._queue.finish()
        for each in (*self.parts.values(), self.buffer):
            each.release()
