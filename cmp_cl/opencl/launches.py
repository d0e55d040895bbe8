"""Kernels bound to their arguments, ready to be launched over their work-items."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.opencl.device import clear_errors
from cmp_cl.opencl.program import Kernels

GROUP = 64  # work-items in a group of a kernel over a list


class Launch(NamedTuple):
    """A kernel, the work-items it runs over, and its arguments, which must outlive it."""

    stage: str
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...] | None
    arguments: list[Any]


def bound(
    kernels: Kernels,
    parts: Mapping[str, Any],
    name: str,
    items: tuple[int, ...],
    group: tuple[int, ...] | None,
) -> Launch:
    """Bind a kernel to the parts, numbers and buffers, that have the names of its arguments.

    An argument that a macro leaves out is no part. items, group: the work-items, and those of a
    group; None lets the device choose it.
    """
    given = [parts[each] for each in kernels.arguments[name] if each in parts]
    return Launch(name, kernels.bind(name, *given), items, group, given)


def enqueue(
    queue: cl.CommandQueue, launches: Iterable[Launch], after: Sequence[cl.Event] = ()
) -> list[tuple[str, cl.Event]]:
    """Enqueue launches in order, after some events; return the stage of each and the event of its
    end."""
    events = []
    with clear_errors(queue.device):
        for stage, kernel, items, group, _ in launches:
            event = cl.enqueue_nd_range_kernel(queue, kernel, items, group, wait_for=after)
            events.append((stage, event))
            after = ()
    return events


def constant(context: cl.Context, table: NDArray[Any]) -> cl.Buffer:
    """Return a constant table as a buffer on the device."""
    flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
    with clear_errors(context.devices[0], table.nbytes):
        return cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(table))


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
