"""Kernels bound to their arguments by name, ready to be launched over their work-items."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.program import Kernels

GROUP = 64  # work-items in a group of a kernel over a list


class Launch(NamedTuple):
    """A kernel with its arguments, which must outlive it, and the work-items it runs over."""

    stage: str
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...] | None
    arguments: dict[str, Any]

    def start(self, queue: cl.CommandQueue) -> tuple[str, cl.Event]:
        """Enqueue it; return its stage and the event of its end."""
        return self.stage, cl.enqueue_nd_range_kernel(queue, self.kernel, self.items, self.group)


class Binder:
    """Binds the kernels of a plan. queue: where they will run; kernels: the compiled ones."""

    kernels: Kernels

    def __init__(self, queue: cl.CommandQueue, device: Device) -> None:
        self.queue = queue
        self.device = device

    def constant(self, table: NDArray[Any]) -> cl.Buffer:
        """Return a constant table as a buffer on the device."""
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.queue.context, flags, hostbuf=np.ascontiguousarray(table))

    def stage(
        self, name: str, items: tuple[int, ...], group: tuple[int, ...] | None, **arguments: Any
    ) -> Launch:
        """Bind a kernel over work-items in groups; None lets the device choose the group.

        arguments: by name, in the order of the kernel's.
        """
        kernel = self.kernels.bind(name, *arguments.values())
        return Launch(name, kernel, items, group, arguments)

    def few(self, name: str, items: int, planes: int, **arguments: Any) -> Launch:
        """Bind a kernel with few work-items, such as one per row.

        On a CPU a work-group has one work-item, because PoCL compiles a kernel anew for every size
        of work-group.
        """
        group = (1, 1) if self.device.kind is DeviceKind.CPU else None
        return self.stage(name, (items, planes), group, **arguments)


def bound(
    kernels: Kernels,
    parts: Mapping[str, cl.Buffer],
    name: str,
    items: tuple[int, ...],
    group: tuple[int, ...] | None,
    arguments: Iterable[Any],
) -> Launch:
    """Bind a kernel to its arguments in their order: numbers, and names of parts of a memory."""
    given = [parts[each] if isinstance(each, str) else each for each in arguments]
    return Launch(name, kernels.bind(name, *given), items, group, {})


def sum_times(
    events: Iterable[tuple[str, cl.Event]], before: Mapping[str, float]
) -> dict[str, float]:
    """Wait for the launches; return the milliseconds of each stage, added to those before."""
    spent = dict(before)
    for stage, event in events:
        event.wait()
        ms = (event.profile.end - event.profile.start) * 1e-6
        spent[stage] = spent.get(stage, 0.0) + ms
    return spent


def multiple(value: int, of: int) -> int:
    """Return the least positive multiple of `of` that is not below the value."""
    return max(-(-value // of), 1) * of
