"""The plans of a detector: buffers and bound kernels for frames of one shape.

A plan serves one shape, one pixel type and one number of frames. It allocates once. A frame then
costs its upload, its launches and the download of its corners.
"""

import functools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.config import BinaryRings, DetectorConfig
from cmp_cl.errors import CapacityError
from cmp_cl.image import GreyImage
from cmp_cl.opencl.device import Device, clear_errors
from cmp_cl.opencl.launches import GROUP, Launch, enqueue, multiple
from cmp_cl.opencl.memory import ALIGNMENT, Memory, copy
from cmp_cl.opencl.program import Kernels, Programs
from cmp_cl.stages import harmonic, noise, refine
from cmp_cl.stages.layout import CORNER_COLUMNS, LANES, LISTS, MOST_OCTAVES, PlanBase
from cmp_cl.stages.paper import rings
from cmp_cl.stages.refine import READ_FIELDS, RESULT_HEAD
from cmp_cl.stages.types import defines_of


class Overflow(Exception):
    """A list was too short. The fields are the largest counts of its entries and of corners."""

    def __init__(self, listed: int, corners: int) -> None:
        super().__init__(f"{listed} entries of a list, {corners} corners")
        self.listed = listed
        self.corners = corners


class Plan(PlanBase):
    """Buffers and bound kernels for `frames` frames of one shape.

    mask: (H, W) bool, where candidates may be centred, or None.
    frames: number of frames at a time. portable: whether kernels have the
    portable form on a CPU too.
    """

    _last: cl.Event | None = None  # of a launch or of a copy, until the host has waited for it

    def __init__(
        self,
        *,
        queue: cl.CommandQueue,
        programs: Programs,
        device: Device,
        shape: tuple[int, int],
        dtype: np.dtype[Any],
        config: DetectorConfig,
        mask: NDArray[np.bool_] | None,
        frames: int,
        portable: bool = False,
    ) -> None:
        super().__init__(queue, device, shape, dtype, config, frames, portable=portable)
        self.events: list[tuple[str, cl.Event]] = []
        self.uploads: list[cl.Event] = []  # unfinished, in another queue
        self._mask = mask
        self._programs = programs
        self.detection: ModuleType = rings if isinstance(self.rule, BinaryRings) else harmonic
        self.kernels = self._build()
        self._allocate()
        self._bind()

    # What is compiled

    def _build(self) -> Kernels:
        defines: dict[str, str | int] = {
            "PAD": self.pad,
            "GROUP": GROUP,
            "NMS_RADIUS": self.config.nms_radius,
            "OCTAVES": MOST_OCTAVES,
            "NOISE_BAND": noise.NOISE_BAND,
            **defines_of(self.types),
            **self.detection.defines(self),
            **refine.defines(self),
        }
        macros = rings.macros(self) if isinstance(self.rule, BinaryRings) else {}
        return self._programs.kernels(self.stages, defines, macros)

    @property
    def stages(self) -> list[str]:
        """Return the kernel files that the configuration needs, in the order of the stages."""
        return [*self.detection.files(self), *refine.files(self)]

    # What is allocated

    @property
    def sizes(self) -> dict[str, int]:
        """Return the bytes of every buffer, by name."""
        layouts = self.detection.scratch(self)
        parts = [[multiple(size, ALIGNMENT) for size in each.values()] for each in layouts]
        sizes = {
            "image": self.octave_starts[-1] * self.dtype.itemsize,
            **self.detection.sizes(self),
            "scratch": max((sum(sizes) for sizes in parts), default=0),
            "corners": 4 * CORNER_COLUMNS * self.frames * self.corner_capacity,
            "result": self.frames * refine.result_size(self),
            "counts": 4 * self.frames * (LISTS + 1),  # entries of the lists, corners
            **refine.sizes(self),
        }
        return {name: size for name, size in sizes.items() if size}

    def _allocate(self) -> None:
        needed = sum(self.sizes.values())
        if needed > self.device.memory:
            raise CapacityError(
                f"the plan needs {needed} bytes, {self.device} has {self.device.memory}; "
                "use smaller images, fewer frames at a time or a mask of the active area"
            )
        for name, size in self.sizes.items():
            if name not in self.memory:
                rows = self.frames if name == "result" else 1
                layout = {name: ((rows, max(size // rows, 4)), np.uint8)}
                self.memory[name] = Memory(self.queue, layout)
        self.arrays = {name: each.buffer for name, each in self.memory.items()}
        self.arrays |= self._parts_of_work()
        self._upload_area()

    @property
    def bytes(self) -> int:
        """Return the bytes allocated on the device."""
        return sum(each.buffer.size for each in self.memory.values())

    @property
    def shared(self) -> bool:
        """Return whether the device works in the host's memory."""
        return self.memory["image"].shared

    def _parts_of_work(self) -> dict[str, cl.Buffer]:
        """Return the temporary arrays. Those of a layout lie one after the other in the buffer
        "scratch", which every layout uses from its start."""
        parts = {}
        for layout in self.detection.scratch(self):
            start = 0
            for name, size in layout.items():
                parts[name] = self.memory["scratch"].buffer.get_sub_region(start, size)
                start += multiple(size, ALIGNMENT)
        return parts

    def _upload_area(self) -> None:
        allowed = np.ones(self.shape, np.bool_) if self._mask is None else self._mask
        after = self.step - self.pad - self.shape[1]
        padded = np.pad(allowed, ((0, 0), (self.pad, after)))
        area = self.memory["area"]
        area.arrays["area"][0] = np.packbits(padded, bitorder="little")
        area.upload()

    def release(self, *kept: str) -> None:
        """Release the device's memory, except for the buffers of the given names."""
        for name in self.memory.keys() - kept:
            self.memory.pop(name).release()

    # What is launched

    def _bind(self) -> None:
        self.launches = [*self.detection.launches(self), *refine.launches(self)]
        self._likely = self.corner_capacity  # corners of a frame, at most

    # What happens in a frame

    def upload(self, queue: cl.CommandQueue, frames: Sequence[GreyImage]) -> None:
        """Copy the frames to the device; in another queue they do not change before the `uploads`
        are done."""
        if self.shared:
            self._write(frames)
            return
        size = self.dtype.itemsize
        for n, frame in enumerate(frames):
            pitch = _pitch(frame)
            host = _flat(frame)
            upload = copy(
                queue,
                self.arrays["image"],
                host,
                buffer_origin=(self.pad * size, n * self.shape[0] + 1, 0),
                host_origin=(0, 0, 0),
                region=(self.shape[1] * size, self.shape[0], 1),
                buffer_pitches=(self.step * size, 0),
                host_pitches=(pitch, 0),
                is_blocking=False,
            )
            if queue is not self.queue:
                self.uploads.append(upload)
        queue.flush()

    def wait_for_uploads(self) -> None:
        """Wait until the frames may change."""
        if self.uploads:
            with clear_errors(self.queue.device):
                cl.wait_for_events(self.uploads)

    def _write(self, frames: Sequence[GreyImage]) -> None:
        """Copy the frames into the memory that the device shares."""
        self._wait()  # for an earlier frame that may still run
        rows, columns = self.shape
        elements = self.memory["image"].arrays["image"][0].view(self.dtype)
        lines = elements[: (self.frames * rows + 2) * self.step].reshape(-1, self.step)
        for n, frame in enumerate(frames):
            lines[1 + n * rows : 1 + (n + 1) * rows, self.pad : self.pad + columns] = frame

    def launch(self, stages: Sequence[Launch], *, read: bool = True) -> None:
        """Enqueue the stages in order, after the upload; read: the download of the result too."""
        self.events += enqueue(self.queue, stages, self.uploads)
        self._last = self.events[-1][1]
        if read:
            self.download()
        self.queue.flush()

    def download(self) -> None:
        """Enqueue the download of the result, with as many corners as there will likely be."""
        for copied in self.memory["result"].download(result=self._bytes(self._likely)):
            self._last = copied

    def list_in(self, memory: Memory) -> None:
        """Enqueue the copy of the first numbers of each result to the array "listed", if there is
        one, on the device; see `read`."""
        if "listed" not in memory.parts:
            return
        own, listed = self.memory["result"].arrays["result"], memory.arrays["listed"]
        for frame in range(self.frames):  # PoCL 3.0 crashes at a copy of all as a rectangle
            copy(
                self.queue,
                memory.parts["listed"],
                self.arrays["result"],
                src_offset=frame * own.strides[0],
                dst_offset=frame * listed.strides[0],
                byte_count=min(own.strides[0], listed.strides[0]),
            )

    def numbers_to_list(self, corners: int) -> int:
        """Return how many numbers of a result hold so many corners; 0 in shared memory, from which
        nothing is copied."""
        return 0 if self.shared else self._bytes(corners) // 4

    def _bytes(self, corners: int) -> int:
        """Return the bytes of the result of a frame that hold so many corners."""
        return 4 * (RESULT_HEAD + READ_FIELDS * multiple(corners, LANES))

    def _wait(self) -> None:
        """Wait until no kernel runs."""
        if self._last is not None:
            with clear_errors(self.queue.device):
                self._last.wait()
            self._last = None

    def read(self, listed: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return the result of each frame as kernels/result.clh lays it out, (frames, numbers),
        once the launches are done; raises Overflow.

        listed: the first numbers of each, if the host has them already.
        """
        self._wait()
        self.uploads.clear()
        result = self.memory["result"].arrays["result"]
        begun = result if listed is None else listed.view(np.uint8)
        heads = begun[:, : 4 * (1 + LISTS)].view(np.uint32).tolist()
        most, longest = max(head[0] for head in heads), max(max(head[1:]) for head in heads)
        if longest > self.list_capacity or most > self.corner_capacity:
            raise Overflow(longest, most)
        if listed is not None and self._bytes(most) <= listed[0].nbytes:
            return listed
        if listed is not None or most > self._likely:
            self._likely = most
            self.download()
            self._wait()
        self._likely = min(most * 9 // 8, self.corner_capacity)  # the next frame has about as many
        return result[:, : self._bytes(most)].copy().view(np.float32)

    def grow(self, overflow: Overflow) -> None:
        """Enlarge the lists that overflowed, with a quarter to spare; the frames stay."""
        if overflow.listed > self.list_capacity:
            self.list_capacity = multiple(overflow.listed * 5 // 4, GROUP)
        if overflow.corners > self.corner_capacity:
            self.corner_capacity = multiple(overflow.corners * 5 // 4, GROUP)
        self.release("image")
        self._allocate()
        self._bind()


class Plans:
    """Makes, lends and releases the plans of a detector.

    A plan that a stream keeps is not lent. Two plans for as many frames stay, which a stream uses
    in turn; more of them go when no stream keeps them, because it ended or was abandoned. Plans for
    batches go when a batch of another size comes.

    shared: the arguments that all plans have in common.
    """

    def __init__(self, **shared: Any) -> None:
        self.make = functools.partial(Plan, **shared)
        self._alike: defaultdict[int, list[Plan]] = defaultdict(list)
        self._kept: set[Plan] = set()
        self.keep = self._kept.add  # for a stream, until its result is read
        self.take_back = self._kept.discard

    def __iter__(self) -> Iterator[Plan]:
        return iter([plan for alike in self._alike.values() for plan in alike])

    def lend(self, frames: int = 1) -> Plan:
        """Return a plan that no stream keeps; make one if there is none."""
        alike = self._alike[frames]
        for plan in alike:
            if plan not in self._kept:
                for spare in set(alike[2:]) - self._kept - {plan}:
                    self.drop(spare)
                return plan
        for plan in self:
            if plan.frames != frames and 1 not in (plan.frames, frames):  # another size of batch
                self.drop(plan)
        alike.append(self.make(frames=frames))
        return alike[-1]

    def drop(self, plan: Plan) -> None:
        """Release the plan, and forget it if it was lent."""
        alike = self._alike[plan.frames]
        alike[:] = [other for other in alike if other is not plan]
        plan.release()


def _pitch(frame: GreyImage) -> int:
    """Return the bytes from a row to the next."""
    return frame.strides[0] if frame.shape[0] > 1 else frame.shape[1] * frame.itemsize


def _flat(frame: GreyImage) -> NDArray[Any]:
    """Return the memory from the first to the last pixel, with the gaps between rows."""
    if frame.flags.c_contiguous:
        return frame
    size = frame.itemsize
    count = (frame.shape[0] - 1) * _pitch(frame) // size + frame.shape[1]
    return np.lib.stride_tricks.as_strided(frame, (count,), (size,), writeable=False)
