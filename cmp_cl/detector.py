"""Detector: from frames to corners, on one OpenCL device."""

import functools
import threading
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners, HarmonicMaps, Maps
from cmp_cl.errors import (
    CapacityError,
    ConfigError,
    DeviceError,
    ImageError,
    check_kind,
    check_shape,
    errors_last,
)
from cmp_cl.grid.build import asked_of, grid_of
from cmp_cl.grid.grid import Grid
from cmp_cl.image import AnyImage, GreyImage, check_dtype, check_image, check_mask
from cmp_cl.lattice.boards import boards
from cmp_cl.lattice.plan import LatticePlan
from cmp_cl.opencl.device import Device, check_process, describe_handle, is_forked, select_device
from cmp_cl.opencl.launches import sum_times
from cmp_cl.opencl.program import Programs, programs_of
from cmp_cl.stages.plan import Overflow, Plan, Plans
from cmp_cl.stages.refine import Found


class Detector(Closing):
    """Finds the corners in frames of one shape and pixel type.

    Use it in a with statement, or call `close`. Buffers and kernels are made once, so that a frame
    allocates nothing on the device. One thread at a time may use it; a second one waits.
    Detectors of one process and device share a context and its compiled kernels.

    shape: (H, W) of every frame. dtype: uint8 or uint16.
    config: the settings; None means DetectorConfig().
    device: a Device, a text for `select_device`, or None for the default device.
    queue: an in-order pyopencl queue to use instead of one of its own; then `device` must be None.
    mask: (H, W) bool, where corners may be centred; pixels outside are still sampled.
    profile: record the times of the stages of the last frame, see `times`.

    Raises ImageError (shape, dtype, mask), ConfigError, DeviceError, KernelBuildError and
    CapacityError.
    """

    def __init__(
        self,
        *,
        shape: tuple[int, int],
        dtype: Any = np.uint8,
        config: DetectorConfig | None = None,
        device: Device | str | None = None,
        queue: cl.CommandQueue | None = None,
        mask: NDArray[np.bool_] | None = None,
        profile: bool = False,
    ) -> None:
        check_shape(shape, ImageError)
        self.shape = int(shape[0]), int(shape[1])
        self.dtype = check_dtype(dtype)
        self.config = DetectorConfig() if config is None else config
        check_kind("config", self.config, DetectorConfig, ConfigError)
        mask = None if mask is None else check_mask(mask, self.shape)
        if queue is not None and not isinstance(queue, cl.CommandQueue):
            raise DeviceError(f"queue must be a pyopencl.CommandQueue, not {queue!r}")
        if queue is not None and device is not None:
            raise DeviceError("give a device or a queue, not both")
        disordered = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
        if queue is not None and queue.properties & disordered:
            raise DeviceError("queue must run its commands in order, one after the other")
        self.device = describe_handle(queue.device) if queue else select_device(device)
        self._programs = (
            programs_of(self.device.handle) if queue is None else Programs(queue.context)
        )
        context = self._programs.context
        flags: Any = cl.command_queue_properties.PROFILING_ENABLE if profile else 0
        self.queue = queue or cl.CommandQueue(context, properties=flags)
        # Of streams, so that uploads run beside the kernels.
        self._transfers = cl.CommandQueue(context)
        self._lock = threading.RLock()
        self._plans = Plans(
            queue=self.queue,
            programs=self._programs,
            device=self.device,
            shape=self.shape,
            dtype=self.dtype,
            config=self.config,
            mask=mask,
        )
        self._lattice: LatticePlan | None = None  # of the plan that was used last
        self._last: Plan | None = None  # that has found corners
        self._closed = False
        self.regrown = 0  # how often a list was too short and a frame was processed again
        self._plans.lend()

    def close(self) -> None:
        """Release the device's memory; the detector cannot be used afterwards."""
        if is_forked():  # the memory belongs to the parent process
            return
        with self._lock:
            self._lattice = self._last = None
            for plan in self._plans:
                self._plans.drop(plan)
            self._closed = True

    @property
    def memory(self) -> int:
        """Return the bytes allocated on the device."""
        lattice = 0 if self._lattice is None else self._lattice.bytes
        return lattice + sum(plan.bytes for plan in self._plans)

    @property
    def times(self) -> dict[str, float]:
        """Return the milliseconds of each stage of the last frame; empty without profile=True."""
        timed = self.queue.properties & cl.command_queue_properties.PROFILING_ENABLE
        return sum_times(self._last.events if self._last and timed else (), {})

    def __call__(self, frame: AnyImage) -> Corners:
        """Find the corners of one frame, (H, W), of the shape and dtype of this detector.

        Raises ImageError if the frame does not fit, CapacityError if the device is full,
        DeviceError if the detector is closed or of another process.
        """
        return self.batch([frame])[0]

    def stream(self, frames: Iterable[AnyImage]) -> Iterator[Corners]:
        """Yield the corners of each frame, in order.

        The next frame is uploaded while the kernels of this one run. A frame may be overwritten as
        soon as the next one is requested. Calls and other streams may be interleaved. Raises the
        errors of a call, at the frame that causes them.
        """
        waiting: Plan | None = None
        try:
            each = (self.begin([frame]) for frame in frames)
            for begun in errors_last(each):
                ready, waiting = waiting, begun if isinstance(begun, Plan) else None
                done = [] if ready is None else self.finish(ready)[0].corners
                if waiting is not None:
                    waiting.wait_for_uploads()
                yield from done
                if isinstance(begun, Exception):
                    raise begun
            if waiting is not None:
                ready, waiting = waiting, None
                yield from self.finish(ready)[0].corners
        finally:
            if waiting is not None:
                self._plans.take_back(waiting)

    @property
    def layout(self) -> Plan:
        """Return the plan that has the layout of its frames on the device."""
        return self._plans.lend()

    def begin(self, frames: Sequence[AnyImage], *, read: bool = True) -> Plan:
        """Upload frames and enqueue their kernels, without waiting; return the plan that has them.

        Launches that are enqueued in `queue` next find the corners of the frames on the device, see
        kernels/result.clh. `finish` or `take_back` must follow. The frames do not change before the
        `uploads` of the plan are done. read: download the result too; else the plan's `download`
        must follow, or `finish` with what is listed. Raises the errors of a call.
        """
        images = [self._checked(frame) for frame in frames]
        with self._lock:
            self._check_alive()
            plan = self._plans.lend(len(images))
            self._start(plan, images, self._transfers, read=read)
            self._plans.keep(plan)
            return plan

    def take_back(self, plan: Plan) -> None:
        """Take back a plan that `begin` returned, without a result."""
        with self._lock:
            self._plans.take_back(plan)

    def finish(self, plan: Plan, listed: NDArray[np.float32] | None = None) -> tuple[Found, bool]:
        """Return what is found in the frames of the plan that `begin` returned, and whether
        launches enqueued behind it have found the same: not if a list was too short.

        listed: (V, N) float32, the first numbers of each result, if the host has them already."""
        with self._lock:
            self._check_alive()
            before = self.regrown
            found = self._found(plan, listed)
            return found, self.regrown == before

    def batch(self, stack: NDArray[Any] | Sequence[AnyImage]) -> list[Corners]:
        """Find the corners of each frame of a stack, with one launch per stage for all of them.

        stack: (B, H, W), or a sequence of frames. The results share one block of memory: copy a
        result to keep it without the others. Raises the errors of a call.
        """
        frames = [self._checked(frame) for frame in stack]
        if not frames:
            return []
        with self._lock:
            self._check_alive()
            plan = self._plans.lend(len(frames))
            self._start(plan, frames, self.queue)
            return self._found(plan).corners

    def maps(self, frame: AnyImage) -> Maps | HarmonicMaps:
        """Return every intermediate image of a frame. Raises the errors of a call."""
        from cmp_cl.stages.maps import read_maps

        image = self._checked(frame)
        with self._lock:
            self._check_alive()
            plan = self._plans.make(frames=1, portable=True)
            try:
                self._start(plan, [image], self.queue)
                self._found(plan)  # lets the lists grow
                return read_maps(plan)
            finally:
                plan.release()

    def grid(
        self,
        frame: AnyImage,
        *,
        shape: tuple[int, int] | None = None,
        like: Grid | None = None,
    ) -> tuple[Corners, Grid]:
        """Find the corners of a frame and number them where they are, on the device.

        shape, like: as in `build_grid`. Raises the errors of a call and of `build_grid`.
        """
        image, asked = self._checked(frame), asked_of(shape, like, None)
        with self._lock:
            self._check_alive()
            corners, lattice = self._numbered(image)
            return corners, grid_of(
                boards(lattice, corners.xy, asked.shape), corners, asked, strict=False
            )

    def _numbered(self, image: GreyImage) -> tuple[Corners, LatticePlan]:
        """Return the corners of an image, and the plan in which their numbers were started."""
        plan = self._plans.lend()
        self._start(plan, [image], self.queue)
        while True:
            lattice = self._lattice_of(plan)
            lattice.start()
            found = self._found(plan)  # while the kernels of the lattice run
            if lattice is self._lattice_of(plan):  # else a list was too short, and has grown
                return found.corners[0], lattice

    def _lattice_of(self, plan: Plan) -> LatticePlan:
        """Return the plan that numbers the corners of this one where they are."""
        # By identity: a new buffer may have the address of one that was released.
        if self._lattice is None or self._lattice.corners_of is not plan.arrays["result"]:
            self._lattice = LatticePlan.of(plan, self._programs)
        return self._lattice

    def _start(
        self,
        plan: Plan,
        frames: list[GreyImage],
        transfers: cl.CommandQueue,
        *,
        read: bool = True,
    ) -> None:
        plan.events.clear()
        plan.upload(transfers, frames)
        plan.launch(plan.launches, read=read)

    def _found(self, plan: Plan, listed: NDArray[np.float32] | None = None) -> Found:
        self._plans.take_back(plan)
        self._last = plan
        while True:
            try:
                return Found(plan.read(listed), plan)
            except Overflow as overflow:
                self._grow(plan, overflow)
                listed = None

    def _grow(self, plan: Plan, overflow: Overflow) -> None:
        """Enlarge the lists and restart with the frames that are on the device."""
        self.regrown += 1
        try:
            plan.grow(overflow)
        except CapacityError:  # half of its buffers are gone; the next frame rebuilds it
            self._plans.drop(plan)
            raise
        plan.launch(plan.launches)

    def _checked(self, frame: AnyImage) -> GreyImage:
        """Return the frame as an image of this detector."""
        check_process()
        image = check_image(frame)
        if image.shape != self.shape or image.dtype != self.dtype:
            raise ImageError(
                f"this detector takes {self.shape} {self.dtype}, got {image.shape} {image.dtype}; "
                "make a Detector for that shape and dtype"
            )
        return image

    def _check_alive(self) -> None:
        if self._closed:
            raise DeviceError("this detector is closed; make a new one")


@functools.lru_cache(maxsize=1)
def kept_detector(
    shape: tuple[int, int], dtype: Any, config: DetectorConfig, device: Device | None = None
) -> Detector:
    """Return the detector that a process keeps as long as images are alike."""
    return Detector(shape=shape, dtype=dtype, config=config, device=device)


def detect(
    image: AnyImage,
    config: DetectorConfig | None = None,
    device: Device | str | None = None,
) -> Corners:
    """Find the corners of one image, (H, W) uint8 or uint16.

    It makes a Detector, runs it and releases it. For many images of one shape make a Detector
    yourself. config, device: as for a Detector. `Corners.advice` says when the corners seem to be
    noise or texture, or why there are none.

    Raises the errors of Detector.
    """
    frame = check_image(image)
    with Detector(shape=frame.shape, dtype=frame.dtype, config=config, device=device) as detector:
        return detector(frame)
