"""What the stages of a plan build on: how frames lie on a device, kernels with arguments."""

from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import AdaptiveMean, DetectorConfig
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.program import Kernels
from cmp_cl.stages.resampling import working_shape

GROUP = 64  # work-items of a group over a list
REACH = 16  # columns on either side of the pixels, at least: what rings and tents need


class Launch(NamedTuple):
    """A kernel with its arguments, which must outlive it, and the work-items it runs over."""

    stage: str
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...] | None
    arguments: tuple[Any, ...]


class PlanBase:
    """How frames lie on a device, and how stages for them are bound.

    shape: (H, W) of a frame; working: the same at the working scale. pad: columns on either
    side of the pixels; step, full_step: elements of a row at the working and at full scale.
    frames, masks: how many there are. candidate_room, corner_room: entries of the lists.
    buffers: the memory; arrays: these and the parts of them, by name. image, response: what the
    stages start from and what suppression looks at.
    """

    kernels: Kernels
    arrays: dict[str, cl.Buffer]
    image: cl.Buffer
    response: cl.Buffer

    def __init__(
        self,
        queue: cl.CommandQueue,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        config: DetectorConfig,
        scale: float | None,
        frames: int,
    ) -> None:
        self.queue = queue
        self.device = device
        self.shape = shape
        self.dtype = dtype
        self.config = config
        self.scale = None if scale == 1 else scale
        self.frames = frames
        self.masks = config.threshold.masks
        self.working = shape if self.scale is None else working_shape(shape, self.scale)
        self.pad = multiple(max(REACH, config.threshold.window // 2), REACH)
        self.step = multiple(self.working[1] + 2 * self.pad, GROUP)
        self.full_step = multiple(shape[1] + 2 * self.pad, GROUP)
        pixels = self.working[0] * self.working[1]
        self.candidate_room = multiple(pixels // 14 + 1, GROUP)
        self.corner_room = multiple(min(config.max_corners, pixels // 96 + 256), GROUP)
        self.buffers: dict[str, cl.Buffer] = {}

    def constant(self, table: NDArray[Any]) -> cl.Buffer:
        """The table on the device."""
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.queue.context, flags, hostbuf=np.ascontiguousarray(table))

    def stage(
        self, name: str, items: tuple[int, ...], group: tuple[int, ...] | None, *arguments: Any
    ) -> Launch:
        """A kernel over work-items in groups, None for any."""
        return Launch(name, self.kernels.bind(name, *arguments), items, group, arguments)

    @property
    def width(self) -> int:
        """Work-items of a group of a dense kernel: a share of the row, pads included."""
        most = min(self.device.handle.max_work_group_size, 1024)
        if self.device.kind is not DeviceKind.CPU:
            most = min(most, 128)
        units = self.step // GROUP
        return max(
            GROUP * n
            for n in range(1, units + 1)
            if units % n == 0 and GROUP * n <= max(most, GROUP)
        )

    def rows(self, name: str, rows: int, planes: int, *arguments: Any) -> Launch:
        """A kernel with one work-item per row, or per something else of which there are few."""
        group = (1, 1) if self.device.kind is DeviceKind.CPU else None
        return self.stage(name, (rows, planes), group, *arguments)


def multiple(value: int, of: int) -> int:
    """The least multiple that is not below the value, and not 0."""
    return max(-(-value // of), 1) * of


def level_type(threshold: AdaptiveMean, dtype: np.dtype[Any]) -> tuple[type[np.integer[Any]], int]:
    """LEVEL of the kernels, which holds (I + C) n, and C: no mean of bytes is above 255."""
    if dtype != np.uint16:
        return np.int32, min(threshold.offset, 255)
    return (np.uint64 if threshold.offset else np.uint32), threshold.offset
