"""Named arrays in one buffer of a device."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import DTypeLike, NDArray

from cmp_cl.opencl.shared import shared_buffer, shares_memory

_ALIGNMENT = 128  # bytes: an alignment that every device accepts for a sub-buffer

Layout = Mapping[str, tuple[tuple[int, ...], DTypeLike]]


class Memory:
    """Named arrays that lie one after the other in one buffer, so that one copy moves all.

    arrays: the arrays of the host, by name. parts: the same on the device, as sub-buffers. On a
    device that shares the host's memory they are the same memory, and the copies do nothing. The
    host may touch it only while no kernel runs.
    """

    def __init__(self, queue: cl.CommandQueue, layout: Layout) -> None:
        self._queue = queue
        starts, size = {}, 0
        for name, (shape, dtype) in layout.items():
            starts[name] = size
            own = int(np.prod(shape)) * np.dtype(dtype).itemsize
            size += -(-max(own, 1) // _ALIGNMENT) * _ALIGNMENT
        self._shared = shares_memory(queue.device)
        if self._shared:
            self._buffer, self._memory = shared_buffer(queue.context, size)
        else:
            self._buffer = cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, size)
            self._memory = np.empty(size, np.uint8)
        self._memory[:] = 0
        self._layout, self._starts = layout, starts
        self.arrays = self._arrays_in(self._memory)
        self.parts: dict[str, cl.Buffer] = {
            name: self._buffer.get_sub_region(starts[name], max(values.nbytes, 1))
            for name, values in self.arrays.items()
        }

    @classmethod
    def of(cls, queue: cl.CommandQueue, **constants: NDArray[Any]) -> "Memory":
        """Return constant arrays, uploaded."""
        made = cls(queue, {name: (value.shape, value.dtype) for name, value in constants.items()})
        for name, value in constants.items():
            made.arrays[name][:] = value
        made.upload()
        return made

    def upload(self) -> None:
        """Enqueue the copy of all arrays to the device."""
        if not self._shared:
            cl.enqueue_copy(self._queue, self._buffer, self._memory, is_blocking=False)

    def download(self) -> None:
        """Enqueue the copy of all arrays from the device."""
        if not self._shared:
            cl.enqueue_copy(self._queue, self._memory, self._buffer, is_blocking=False)

    def copies(self) -> dict[str, NDArray[Any]]:
        """Return copies of the arrays of the host, by name."""
        return self._arrays_in(self._memory.copy())

    def _arrays_in(self, memory: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
        return {
            name: np.ndarray(shape, dtype, memory, self._starts[name])
            for name, (shape, dtype) in self._layout.items()
        }

    def release(self) -> None:
        """Release the device's memory."""
        self._buffer.release()
