"""The layout of frames on a device, and the launches over its pixels and corners."""

from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import BinaryRings, DetectorConfig, EdgeLines, EdgeStep
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Launch, bound, constant, multiple
from cmp_cl.opencl.memory import Memory
from cmp_cl.opencl.program import Kernels
from cmp_cl.stages.types import types_of

LEAST_PAD = 16  # columns on either side of the pixels, for rings, discs and tents
LANES = 8  # corners of a vector in the form for CPUs
LIST_COLUMNS = 6  # x, y, response, and the sum and the moments of the responses around it
CORNER_COLUMNS = LIST_COLUMNS + 1  # and the octave
LEAST_OCTAVE = 48  # px, the shorter side of a halved frame
MOST_OCTAVES = 3
LISTS = 2 + MOST_OCTAVES  # of which a frame has counts, whatever its rule; its kinds come first
MOST_COLUMNS = 1 << 16  # of a frame in the form for CPUs, which keeps 16 bits of a column
OCTAVE_ALIGNMENT = 128  # elements, of the start of an octave in the buffer of the frames


class PlanBase:
    """The layout of frames on a device, and methods that bind the stages to it.

    queue: where they run; kernels: the compiled ones. for_cpu: whether these have the form for
    CPUs. In the portable form a work-item handles a pixel or a corner; in that for CPUs a band of
    rows, so that its data stay in the cache, or eight corners or pixels, which fill a vector.
    kernels/cpu holds it for the stages in which it makes a whole frame at least 1.3 times as fast.
    The results are the same.
    shape: (H, W) of a frame. pad: columns of padding on either side; step: elements of a row.
    octaves: number of halved frames, which lie behind the frames in "image".
    frames: number of frames; kinds: number of lists of maxima or candidates per frame, with
    `list_capacity` entries each; corner_capacity: entries of the list of a frame's corners. bands:
    bands of rows that a frame is divided into in the form for CPUs. memory: by name, an array each;
    arrays: their buffers and parts of them, by name.
    """

    kernels: Kernels
    arrays: dict[str, cl.Buffer]

    def __init__(
        self,
        queue: cl.CommandQueue,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        config: DetectorConfig,
        frames: int,
        *,
        portable: bool = False,
    ) -> None:
        self.queue = queue
        self.device = device
        on_cpu = device.kind is DeviceKind.CPU
        self.for_cpu = on_cpu and not portable and shape[1] <= MOST_COLUMNS
        self.shape = shape
        self.dtype = dtype
        self.types = types_of(dtype, config)
        self.config = config
        self.rule = config.detection
        self.frames = frames
        pixels = shape[0] * shape[1]
        self.octaves = 0
        if isinstance(self.rule, BinaryRings):
            self.kinds = 1
            self.pad = multiple(max(LEAST_PAD, self.rule.threshold.window // 2), LEAST_PAD)
            self.list_capacity = multiple(pixels // 20 + 1, GROUP)  # the lists grow
        else:
            shorter = min(shape) // LEAST_OCTAVE
            self.octaves = min(self.rule.octaves, max(shorter, 1).bit_length() - 1)
            self.kinds = 1 + self.rule.fine + MOST_OCTAVES
            self.pad = LEAST_PAD
            # One maximum in 128 pixels is one in a cell of 11 px; the lists grow. Each band fills
            # up its last entries.
            self.list_capacity = multiple(pixels // 128, GROUP) + GROUP * (1 + self.bands)
        self.step = multiple(shape[1] + 2 * self.pad, GROUP)
        # One corner in 96 pixels is one in a cell of 10 px; the list grows too.
        self.corner_capacity = multiple(min(config.max_corners, pixels // 96 + 256), GROUP)
        self.memory: dict[str, Memory] = {}

    def size_of(self, octave: int) -> dict[str, Any]:
        """Return rows, columns and step of an octave, by argument."""
        rows, columns = (length >> octave for length in self.shape)
        step = multiple(columns + 2 * self.pad, GROUP) if octave else self.step
        return {"rows": np.uint32(rows), "columns": np.uint32(columns), "step": np.uint32(step)}

    def image_of(self, octave: int) -> cl.Buffer:
        """Return the image of an octave; in the end S3 of a halved frame, in which its corners are
        refined."""
        if not octave:
            return self.arrays["image"]
        start, end = (self.dtype.itemsize * at for at in self.octave_starts[octave : octave + 2])
        return self.memory["image"].buffer.get_sub_region(start, end - start)

    @property
    def octave_starts(self) -> list[int]:
        """Return the first element of each octave in the buffer of the frames, and the end."""
        starts = [0]
        for octave in range(self.octaves + 1):
            size = {name: int(length) for name, length in self.size_of(octave).items()}
            elements = (self.frames * size["rows"] + 2) * size["step"]
            starts.append(starts[-1] + multiple(elements, OCTAVE_ALIGNMENT))
        return starts

    @property
    def bands(self) -> int:
        """Return the number of bands: on a CPU one per unit, of 32 rows or more; else one."""
        if not self.for_cpu:
            return 1
        units = self.device.handle.max_compute_units
        return max(min(units, self.shape[0] // 32), 1)

    @property
    def lanes(self) -> int:
        """Return the number of corners that a work-item of refinement processes at a time."""
        eight = isinstance(self.config.refinement, EdgeLines | EdgeStep)
        return LANES if self.for_cpu and eight else 1

    def constant(self, table: NDArray[Any]) -> cl.Buffer:
        """Return a constant table as a buffer on the device."""
        return constant(self.queue.context, table)

    def stage(
        self,
        name: str,
        items: tuple[int, ...],
        group: tuple[int, ...] | None,
        octave: int = 0,
        /,
        **arguments: Any,
    ) -> Launch:
        """Bind a kernel over work-items in groups, see `bound`, to arguments by name.

        Others are the arrays, the image of an octave and its size, and where the lists are: with
        the capacity of each, and the corners of a frame, with theirs, in the list of all frames.
        """
        parts = {
            **self.arrays,
            "image": self.image_of(octave),
            **self.size_of(octave),
            "capacity": np.uint32(self.list_capacity),
            "corner_capacity": np.uint32(self.corner_capacity),
            "count_offset": np.uint32(self.frames * LISTS),
            "length": np.uint32(self.frames * self.corner_capacity),
            **arguments,
        }
        return bound(self.kernels, parts, name, items, group)

    def few(self, name: str, items: int, planes: int, **arguments: Any) -> Launch:
        """Bind a kernel with few work-items, such as one per row.

        On a CPU, in either form, a work-group has one work-item, because PoCL compiles a kernel
        anew for every size of work-group.
        """
        group = (1, 1) if self._on_cpu else None
        return self.stage(name, (items, planes), group, **arguments)

    def dense(
        self, name: str, height: int | None = None, octave: int = 0, /, **arguments: Any
    ) -> Launch:
        """Bind a kernel with one work-item per element of a row of an octave, of a slab of that
        height."""
        size = self.size_of(octave)
        items = (int(size["step"]), height or int(size["rows"]), self.frames)
        return self.stage(name, items, (GROUP if octave else self.width, 1, 1), octave, **arguments)

    def of_groups(self, name: str, groups: int, items: int, **arguments: Any) -> Launch:
        """Bind a kernel of whole work-groups for each frame, with so many work-items; on a CPU,
        with one each."""
        size = 1 if self._on_cpu else items
        return self.stage(name, (size, groups, self.frames), (size, 1, 1), **arguments)

    def of_corners(self, name: str, **arguments: Any) -> Launch:
        """Bind a kernel with one work-item per entry of the list of corners."""
        arguments["capacity"] = np.uint32(self.corner_capacity)
        return self.stage(name, (self.corner_capacity, self.frames), (GROUP, 1), **arguments)

    @property
    def _on_cpu(self) -> bool:
        """Return whether the device is a CPU, whichever form its kernels have."""
        return bool(self.device.handle.type & cl.device_type.CPU)

    @property
    def width(self) -> int:
        """Work-items of a group of a dense kernel: a share of the row, padding included.

        On a CPU the grey-level rule has them for maps alone, and they are compiled for one group.
        """
        if self._on_cpu and not isinstance(self.rule, BinaryRings):
            return GROUP
        most = min(self.device.handle.max_work_group_size, 1024 if self._on_cpu else 128)
        units = self.step // GROUP
        return max(
            GROUP * n
            for n in range(1, units + 1)
            if units % n == 0 and GROUP * n <= max(most, GROUP)
        )
