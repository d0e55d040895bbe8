"""Frames measured one after the other, each numbered from the one before it, or anew."""

import contextlib
import dataclasses
import functools
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.corners import Corners
from cmp_cl.errors import DeviceError
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.measured import Measured, Tally
from cmp_cl.measure.views import Seen, Views
from cmp_cl.motion.geometry import InPlane, InSpace
from cmp_cl.motion.moments import Moment
from cmp_cl.motion.nodes import grid_of, positions_of
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.motion.track import Tracker, can_track, differing
from cmp_cl.opencl.device import Device
from cmp_cl.opencl.launches import sum_times
from cmp_cl.opencl.program import programs_of
from cmp_cl.space import Bias, StereoRig
from cmp_cl.stages.plan import Plan

AUDITED = 256  # tracked frames, of which the last is numbered anew too


@dataclasses.dataclass(eq=False)
class _Begun:
    """A frame whose kernels run. tracked: whether those that track its nodes do. settled: what has
    been read of it."""

    views: tuple[GreyImage, ...]
    plans: list[Plan]
    tracked: bool = False
    settled: "_Settled | None" = None


class Measurement(Closing):
    """Measures frames against the frame at rest. Use it in a with statement.

    constants: arrays that a series holds once: rest (R, C, 2) or (R, C, 3), raw_rest (rest before
    the lattice filter), unit, and the detected positions at rest, (R, C, 2), px: xy_rest, or
    left_rest and right_rest.
    unit: unit of the displacements.
    nodes: number of nodes of the pattern.
    tally: how the frames so far got their numbers.
    strain, profile: as in `OneView`.

    A frame gets its numbers from the frame before, if its nodes are found where they were expected;
    else they are found anew. One frame in AUDITED that were tracked is numbered anew all the same,
    and if a node then has another corner, that counts. The numbers that were found anew hold.
    """

    constants: dict[str, NDArray[Any]]
    unit: str
    nodes: int
    _views: Views
    _plan: FieldPlan | None = None
    _tracker: Tracker | None = None
    _rig: StereoRig | None = None
    _bias: Bias | None = None

    def __init__(self, *, device: Device, strain: bool, profile: bool) -> None:
        self.tally = Tally()
        self._device, self._strain, self._profile = device, strain, profile
        # One frame at a time; a stream may be collected, and so end, within a call.
        self._lock = threading.RLock()
        self._stack = contextlib.ExitStack()
        self._events: list[tuple[str, cl.Event]] = []  # of the last frame, but of the detector
        self._running: _Begun | None = None  # whose results have not been read
        self._follows = False  # whether the tracker has the nodes of the frame before

    def close(self) -> None:
        """Release the device's memory, once a call of another thread has ended."""
        with self._lock:
            self._stack.close()

    @property
    def times(self) -> dict[str, float]:
        """Return the milliseconds of each kernel of the last frame, those of the detector first;
        empty without profile=True. The kernels of a frame that was tracked run one after the other,
        without a decision of the host in between."""
        detector = self._views.detector
        if not self._profile or detector is None:
            return {}
        with self._lock:
            return sum_times(self._events, detector.times)

    @property
    def launches(self) -> int:
        """Return the number of launches that a tracked frame takes."""
        own = [each.launches for each in (self._tracker, self._plan) if each is not None]
        looks = self._tracker is not None
        return self._views.launches + sum(map(len, own)) + looks

    @contextlib.contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self.close()
            raise

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure one frame, of the size and the type of the frame at rest.

        frame: (H, W). Nodes that are not found are NaN; in a frame without the pattern all are.
        Raises ImageError, CapacityError and DeviceError as a `Detector` does.
        """
        with self._lock:
            begun = self._begin(frame)
            self._follow(begun)
            return self._measured(self._settled(begun))

    def stream(self, frames: Iterable[GreyImage | None]) -> Iterator[Measured | None]:
        """Measure each frame, in order; a frame that is missing is None, and so is its result.

        The kernels of a frame run while the one before it becomes a result, so a frame must not
        change before the frame after the next one is requested. Raises the errors of a call.
        """
        waiting: _Begun | None = None
        try:
            for frame in frames:
                with self._lock:
                    begun = None if frame is None else self._begin(frame)
                    ready, waiting = waiting, begun
                    settled = [] if ready is None else [self._settled(ready)]
                    if begun is None:
                        self._skip()
                    else:
                        self._follow(begun)
                    done = [self._measured(each) for each in settled]
                yield from done
                if frame is None:
                    yield None
            if waiting is not None:
                with self._lock:
                    ready, waiting = waiting, None
                    last = self._measured(self._settled(ready))
                yield last
        finally:
            if waiting is not None:
                self._abandon(waiting)

    def _abandon(self, begun: _Begun) -> None:
        """Forget a frame whose kernels run: nobody has checked the nodes that it tracks."""
        with self._lock, contextlib.suppress(DeviceError):  # closed
            if begun.settled is None:
                self._running, self._follows = None, False
                self._views.finish(begun.plans)

    def skip(self) -> None:
        """Note that a frame is missing here; `track` continues numbers over few missing frames
        only."""
        with self._lock:
            self._skip()

    def _skip(self) -> None:
        for view in self._views.views:
            view.lost()
            self._follows &= view.continues

    def _plan_for(
        self, device: Device, at_rest: GreyImage, rest: Moment, geometry: InSpace | InPlane
    ) -> None:
        """Make the plan of the field, and the tracker, where one detector finds all corners.

        at_rest: the frame. rest: its nodes. geometry: how the views show them.
        """
        detector = self._views.detector
        if detector is None:
            return
        views, programs = self._views.views, programs_of(device.handle)
        self._plan = FieldPlan(
            detector.queue, programs, device, rest=rest, geometry=geometry, strain=self._strain
        )
        self._stack.callback(self._plan.release)
        if all(can_track(view.rest, slow=view.track) for view in views):
            self._tracker = Tracker(
                detector.queue,
                programs,
                device,
                views=[(view.rest, view.corners) for view in views],
                sizes=[detector.shape] * len(views),
                regions=[view.region for view in views],
                frame=self._plan.frame,
                octaves=detector.layout.octaves,
                lists=detector.layout.lists,
            )
            self._stack.callback(self._tracker.release)
            grids, corners = [view.rest for view in views], [view.corners for view in views]
            self._plan.take(grids, corners)
            self._follows = self._tracker.begin(grids)
            begun = self._begin(at_rest)
            self._follow(begun)
            self._views.finish(begun.plans)
            if begun.tracked:
                self._tracker.know_rest(self._plan.read())
            self._running, self._follows = None, False

    def _views_of(self, frame: GreyImage) -> tuple[GreyImage, ...]:
        """Return the views of a frame."""
        raise NotImplementedError

    def _between(self, grids: Sequence[Grid]) -> DisplacementField:
        """Return the displacement from rest to the moment of these grids, without the plan."""
        raise NotImplementedError

    def _begin(self, frame: GreyImage) -> "_Begun":
        """Enqueue the kernels that find the corners."""
        views = self._views_of(frame)
        return _Begun(views, self._views.begin(views))

    def _follow(self, begun: "_Begun") -> None:
        """Enqueue those that track the nodes and compute the field, if the tracker can go on."""
        if self._running is not None:  # of a stream
            self._settled(self._running)
        self._running = begun
        if self._tracker is None or self._plan is None or not self._follows:
            return
        (plan,) = begun.plans
        looks = self._tracker.looks(plan)
        self._events = self._tracker.start(plan.arrays["result"], plan.corner_capacity, looks)
        self._events += self._plan.start()
        begun.tracked = True

    def _settled(self, begun: _Begun) -> "_Settled":
        """Return what becomes of a frame, once its kernels are done."""
        if self._running is begun:
            self._running = None
        if begun.settled is None:
            try:
                begun.settled = self._settle(begun)
            except BaseException:
                self._follows = False  # nobody has checked the nodes that it tracks
                raise
        return begun.settled

    def _settle(self, begun: _Begun) -> "_Settled":
        """Wait for a frame. Number it anew where tracking does not hold, or is audited."""
        views, tally = self._views.views, self.tally
        # One wait: a second one, for the corners, would take a core from the kernels.
        arrays = self._plan.read() if begun.tracked and self._plan is not None else None
        seen, same = self._views.finish(begun.plans)
        settled = _Settled(begun.views, seen, arrays=arrays)
        if arrays is not None and self._tracker is not None:
            settled.tracked = same and self._tracker.holds(arrays, seen.counts)
            settled.grids = [
                functools.partial(grid_of, arrays, number, view.rest, count)
                for number, (view, count) in enumerate(zip(views, seen.counts, strict=True))
            ]
        if settled.tracked:
            tally.tracked += 1
            for view, grid in zip(views, settled.grids, strict=True):
                view.go_on(grid)
            if tally.tracked % AUDITED:
                return settled
        corners = seen.corners
        anew = [
            view.number(found, image)
            for view, found, image in zip(views, corners, begun.views, strict=True)
        ]
        tally.numbered += 1
        if settled.tracked:
            tally.audited += 1
            settled.differing = sum(
                differing(grid(), other) for grid, other in zip(settled.grids, anew, strict=True)
            )
            tally.differing += settled.differing
            if not settled.differing:
                return settled
        settled.ambiguous = any(grid.ambiguous for grid in anew)
        settled.grids = [functools.partial(_given, grid) for grid in anew]
        settled.tracked = False
        if self._plan is not None:
            self._plan.take(anew, corners)
            self._follows = self._tracker is not None and self._tracker.begin(anew)
            self._events = self._plan.start()
            settled.arrays = self._plan.read()
        return settled

    def _measured(self, settled: "_Settled") -> Measured:
        """Return what a frame becomes."""
        if self._plan is None or settled.arrays is None:
            field = self._between([grid() for grid in settled.grids])
        else:
            field = self._plan.field(settled.arrays)
        return Measured(
            field=field.with_strain() if self._strain else field,
            ambiguous=settled.ambiguous,
            views=settled.views,
            find=settled.find,
            number=settled.number,
            seen=settled.seen,
            rig=self._rig,
            bias=self._bias,
            tracked=settled.tracked,
            differing=settled.differing,
        )


@dataclasses.dataclass(eq=False)
class _Settled:
    """A frame whose kernels are done, and whose nodes have numbers.

    found: the corners of each view. grids: return the grid of each view. arrays: what its field
    comes from; None without a plan.
    tracked, differing, ambiguous: as in `Measured`.
    """

    views: tuple[GreyImage, ...]
    found: Seen
    grids: list[Callable[[], Grid]] = dataclasses.field(default_factory=list)
    arrays: dict[str, NDArray[Any]] | None = None
    tracked: bool = False
    differing: int = 0
    ambiguous: bool = False

    def find(self) -> tuple[Corners, ...]:
        return self.found.corners

    def number(self) -> tuple[Grid, ...]:
        return tuple(grid() for grid in self.grids)

    def seen(self) -> tuple[NDArray[np.float32], ...]:
        """Return the positions of the nodes; those of a tracked frame need no grid."""
        if self.arrays is None:
            return tuple(grid.xy for grid in self.number())
        return tuple(positions_of(self.arrays, view) for view in range(len(self.grids)))


def _given(grid: Grid) -> Grid:
    return grid


def constants_of(still: DisplacementField) -> dict[str, NDArray[Any]]:
    """Return the arrays that a series holds once, from the field of the frame at rest."""
    assert still.raw is not None
    return {
        "rest": still.position,
        "raw_rest": still.raw.position,
        "unit": np.array(still.unit),
    }
