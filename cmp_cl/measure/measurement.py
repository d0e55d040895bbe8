"""Frames measured one after the other, each numbered from the one before it, or anew."""

import contextlib
import dataclasses
import functools
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypedDict

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, FieldError, ImageError, check_kind, errors_last
from cmp_cl.grid import Grid
from cmp_cl.image import AnyImage, GreyImage, check_image
from cmp_cl.measure.fit import Fit
from cmp_cl.measure.measured import Measured
from cmp_cl.measure.patterns import find_pattern
from cmp_cl.measure.views import View, named
from cmp_cl.motion.geometry import InPlane, InSpace
from cmp_cl.motion.moments import Moment
from cmp_cl.motion.nodes import grid_of
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.motion.track import Tracker, can_track, differing, lost
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.opencl.launches import enqueue, sum_times
from cmp_cl.opencl.program import programs_of
from cmp_cl.space import Bias
from cmp_cl.stages.plan import Plan
from cmp_cl.stages.refine import Found

AUDITED = 256  # tracked frames, of which a view of the last is numbered anew too


class Settings(TypedDict, total=False):
    """What `OneView` and `TwoViews` take by name.

    shape: (rows, columns) of the pattern's corners; None takes the shape that is seen at rest.
    config: configuration of the detector; None finds the pattern at rest with `DetectorConfig()`,
        and then takes `DetectorConfig.for_cell` for its cells.
    track: continue the numbers of the previous frame if the frame at rest leaves them ambiguous.
        Frames then come in order, and the pattern as a whole moves by less than half a cell from
        the frame at rest to the first and from each to the next. After two frames without a grid,
        or one that is ambiguous, those that follow are ambiguous too, until a border or the
        printing errors decide.
    full_scale: the camera's largest grey level; None is that of the configuration or of the type.
    device: a Device, a text for `select_device`, or None for the default device.
    strain: give every field its strain, see `DisplacementField.with_strain`.
    profile: record the times of the kernels of the last frame, see `Measurement.times`.
    """

    shape: tuple[int, int] | None
    config: DetectorConfig | None
    track: bool
    full_scale: int | None
    device: Device | str | None
    strain: bool
    profile: bool


@dataclasses.dataclass(eq=False)
class _Begun:
    """A frame whose kernels run. tracker: what tracks its nodes, if they are tracked."""

    views: tuple[GreyImage, ...]
    plan: Plan
    tracker: Tracker | None = None


class Measurement(Closing):
    """Measures frames against the frame at rest. Use it in a with statement.

    at_rest: the frame at rest. views_of: returns the views of a frame, of one size. The other
    arguments are `Settings`.

    constants: arrays that a series holds once: rest (R, C, 2) or (R, C, 3), raw_rest (rest before
    the lattice filter), unit, and the detected positions at rest, (R, C, 2), px: xy_rest, or
    left_rest and right_rest.
    unit: unit of the displacements.
    nodes: number of nodes of the pattern.

    A frame gets its numbers from the frame before, if its nodes are found where they were expected;
    else they are found anew. Of one frame in AUDITED that were tracked a view is numbered anew all
    the same, each in its turn. If a node then has another corner, that counts; then, and if one
    has a corner that tracking had lost, all views are numbered anew, and these numbers hold.
    """

    _bias: Bias | None = None

    def __init__(
        self,
        at_rest: AnyImage,
        views_of: Callable[[GreyImage], tuple[GreyImage, ...]],
        *,
        shape: tuple[int, int] | None = None,
        config: DetectorConfig | None = None,
        track: bool = False,
        full_scale: int | None = None,
        device: Device | str | None = None,
        strain: bool = False,
        profile: bool = False,
    ) -> None:
        self._profile = profile
        self._lock = threading.RLock()  # one frame at a time
        self._streams = False
        self._events: list[tuple[str, cl.Event]] = []  # of the last frame, but of the detector
        self._tracked = 0  # frames so far
        self._follows = False  # whether the tracker has the nodes of the frame before
        self._kind, self._views_of = _kind_of(at_rest), views_of
        chosen, images = select_device(device), views_of(at_rest)
        if config is None:
            with named(0, images):
                cell, _ = find_pattern(images[0], shape=shape, full_scale=full_scale, device=chosen)
            config = DetectorConfig.for_cell(cell)
        check_kind("config", config, DetectorConfig, ConfigError)
        if full_scale is not None:
            config = config.replace(full_scale=full_scale)
        with contextlib.ExitStack() as stack:
            self._detector = stack.enter_context(
                Detector(
                    shape=images[0].shape,
                    dtype=images[0].dtype,
                    config=config,
                    device=chosen,
                    profile=profile,
                )
            )
            self._views: list[View] = []
            for number, image in enumerate(images):
                of_left = number > 0 and shape is None
                size = self._views[0].rest.shape if number else shape
                with named(number, images):
                    self._views.append(
                        View(self._detector, image, size, track=track, of_left=of_left)
                    )
            rest, geometry = self._at_rest()
            programs = programs_of(chosen.handle)
            most = max(len(view.corners) for view in self._views)
            self._plan = FieldPlan(
                self._detector.queue,
                programs,
                chosen,
                rest=rest,
                geometry=geometry,
                strain=strain,
                listed=self._detector.layout.numbers_to_list(most * 5 // 4),
            )
            stack.callback(self._plan.release)
            self._tracker: Tracker | None = None
            if all(can_track(view.rest, slow=track) for view in self._views):
                self._tracker = Tracker(
                    self._detector.queue,
                    programs,
                    views=[(view.rest, view.corners) for view in self._views],
                    size=self._detector.shape,
                    frame=self._plan.frame,
                )
                stack.callback(self._tracker.release)
            self._know_rest(images)
            self._stack = stack.pop_all()

    def _know_rest(self, images: tuple[GreyImage, ...]) -> None:
        """Measure the frame at rest; let the tracker know what it finds there."""
        grids = [view.rest for view in self._views]
        self._start_from(grids, [view.corners for view in self._views])
        self._plan.start()
        at_rest = self._plan.read()
        self._fit = Fit(at_rest["misfit"]) if "misfit" in at_rest else None
        still = self._plan.field(at_rest)
        assert still.raw is not None
        self.unit, self.nodes = still.unit, still.status.size
        self.constants: dict[str, NDArray[Any]] = {
            "rest": still.position,
            "raw_rest": still.raw.position,
            "unit": np.array(still.unit),
        }
        if self._tracker is not None and self._follows:
            begun = self._begin(images)
            self._follow(begun)
            arrays = self._plan.read()
            self._detector.finish(begun.plan, arrays.get("listed"))
            self._tracker.know_rest(arrays)
        self._follows = False

    def close(self) -> None:
        """Release the device's memory, once a call of another thread has ended."""
        with self._lock:
            self._stack.close()

    @property
    def rest_grids(self) -> tuple[Grid, ...]:
        """Return the grid of each view of the frame at rest."""
        return tuple(view.rest for view in self._views)

    @property
    def times(self) -> dict[str, float]:
        """Return the milliseconds of each kernel of the last frame, those of the detector first;
        empty without profile=True. The kernels of a frame that was tracked run one after the other,
        without a decision of the host in between."""
        if not self._profile:
            return {}
        with self._lock:
            return sum_times(self._events, self._detector.times)

    @property
    def launches(self) -> int:
        """Return the number of launches that a tracked frame takes."""
        layout = self._detector.layout
        tracking = [] if self._tracker is None else self._tracker.launches(layout)
        return len(layout.launches) + len(tracking) + len(self._plan.launches)

    def __call__(self, frame: AnyImage) -> Measured:
        """Measure one frame, of the size and the type of the frame at rest.

        frame: (H, W). Nodes that are not found are NaN; in a frame without the pattern all are.
        Raises ImageError, CapacityError and DeviceError as a `Detector` does; FieldError within a
        stream that has not ended. A frame that raises counts as missing, see `skip`.
        """
        with self._lock:
            (measured,) = self.stream([frame])
        assert measured is not None
        return measured

    def stream(self, frames: Iterable[AnyImage | None]) -> Iterator[Measured | None]:
        """Measure each frame, in order; a frame that is missing is None, and so is its result.

        The kernels of a frame run while the one before it becomes a result, so a frame must not
        change before the frame after the next one is requested. Raises the errors of a call, and
        what making a frame raises, after the results before it.
        """
        waiting: _Begun | None = None
        begins = False
        try:
            with self._lock:
                if self._streams:
                    raise FieldError(
                        "a stream of this measurement has not ended: take its frames, or close it"
                    )
                begins = self._streams = True
            for begun in errors_last(map(self._begun, frames)):
                ready, waiting = waiting, begun if isinstance(begun, _Begun) else None
                with self._lock:
                    settled = [] if ready is None else [self._settled(ready)]
                    if waiting is None:
                        self._skip()
                    else:
                        self._follow(waiting)
                    done = [_with_field(each) for each in settled]
                yield from done
                if isinstance(begun, Exception):
                    raise begun
                if begun is None:
                    yield None
            if waiting is not None:
                with self._lock:
                    ready, waiting = waiting, None
                    last = _with_field(self._settled(ready))
                yield last
        finally:
            with self._lock:
                self._streams &= not begins
                if waiting is not None:
                    self._give_up(waiting)

    def _begun(self, frame: AnyImage | None) -> _Begun | None:
        """Enqueue the kernels that find the corners of a frame; None is a missing one."""
        with self._lock:
            return None if frame is None else self._begin(self._checked(frame))

    def skip(self) -> None:
        """Note that a frame is missing here: the next one is numbered anew. `track` continues
        numbers over one missing frame only."""
        with self._lock:
            list(self.stream([None]))

    def _skip(self) -> None:
        for view in self._views:
            view.lost()
        self._follows = False

    def _give_up(self, begun: _Begun) -> None:
        """Note that a frame is missing that has been begun."""
        self._detector.take_back(begun.plan)
        self._skip()

    def _at_rest(self) -> tuple[Moment, InSpace | InPlane]:
        """Return the nodes at rest, and how the views show them."""
        raise NotImplementedError

    def _checked(self, frame: AnyImage) -> tuple[GreyImage, ...]:
        """Return the views of a frame; raises ImageError unless it is like that at rest."""
        kind = _kind_of(frame)
        if kind != self._kind:
            rest, this = ("{} of {}".format(*each) for each in (self._kind, kind))
            raise ImageError(
                f"the frame at rest is {rest}, this one {this}; measure a recording of another "
                "size or type against its own frame at rest"
            )
        return self._views_of(frame)

    def _begin(self, views: tuple[GreyImage, ...]) -> _Begun:
        """Enqueue the kernels that find the corners of a frame."""
        return _Begun(views, self._detector.begin(views, read=False))

    def _follow(self, begun: _Begun) -> None:
        """Enqueue those that track the nodes and compute the field, if the tracker can go on; and
        one download."""
        if self._tracker is None or not self._follows:
            begun.plan.download()
            return
        self._track(self._tracker, begun.plan)
        begun.tracker = self._tracker

    def _track(self, tracker: Tracker, plan: Plan) -> None:
        """Enqueue the kernels that find the nodes of a plan's frame from those on the device."""
        plan.list_in(self._plan.frame)
        self._events = enqueue(self._detector.queue, tracker.launches(plan))
        self._events += self._plan.start()

    def _settled(self, begun: _Begun) -> Measured:
        """Return what becomes of a frame, once its kernels are done."""
        try:
            return self._settle(begun)
        except BaseException:  # also KeyboardInterrupt
            self._give_up(begun)
            raise

    def _settle(self, begun: _Begun) -> Measured:
        """Wait for a frame. Number it anew where tracking does not hold, or is audited."""
        arrays = self._plan.read() if begun.tracker else {}
        found, same = self._detector.finish(begun.plan, arrays.get("listed"))
        tracker, numbers = begun.tracker, [view.sure for view in self._views]
        settled = Measured(
            views=begun.views,
            tracked=tracker is not None and same and tracker.holds(arrays, found.counts),
            bias=self._bias,
            _fit=self._fit,
            _plan=self._plan,
            _found=found,
            _arrays=arrays,
            _numbered=functools.partial(_grids, arrays, numbers, found),
        )
        if settled.tracked:
            self._tracked += 1
            for number, view in enumerate(self._views):
                view.go_on(functools.partial(_grid, settled, number))
            if self._tracked % AUDITED:
                return settled
        return self._numbered_anew(settled, begun.plan)

    def _numbered_anew(self, settled: Measured, plan: Plan) -> Measured:
        """Return a frame with the numbers that are found without the frame before; as it is if
        tracking has the same corners, and has lost none.

        Its nodes are those that tracking finds from these numbers in the same frame, if it holds:
        torn nodes get their second look however a frame got its numbers.
        """
        count, known = len(self._views), {}
        if settled.tracked:
            audited = self._tracked // AUDITED % count
            found = known[audited] = self._number(settled, audited)
            before = settled.grids[audited]
            if not differing(before, found) and not lost(before, found):
                return settled
        anew = [known.get(view) or self._number(settled, view) for view in range(count)]
        if settled.tracked:
            others = sum(map(differing, settled.grids, anew))
            settled = dataclasses.replace(settled, differing=others)
        arrays = self._within(settled, anew, plan)
        if arrays is None:
            numbered = functools.partial(tuple[Grid, ...], anew)
            self._start_from(anew, settled.corners)
            self._events = self._plan.start()
            arrays = self._plan.read()
        else:
            numbered = functools.partial(_grids, arrays, anew, settled._found)
        return dataclasses.replace(
            settled,
            tracked=False,
            ambiguous=any(grid.ambiguous for grid in anew),
            _arrays=arrays,
            _numbered=numbered,
        )

    def _number(self, settled: Measured, view: int) -> Grid:
        """Return the grid of a view with numbers that are found without the frame before."""
        return self._views[view].number(settled.corners[view], settled.views[view])

    def _within(
        self, settled: Measured, anew: Sequence[Grid], plan: Plan
    ) -> dict[str, NDArray[Any]] | None:
        """Track the nodes of a frame from grids of the same frame. Return the arrays of the field,
        None if tracking does not hold."""
        self._start_from(anew, settled.corners)
        if self._tracker is None or not self._follows:
            return None
        self._track(self._tracker, plan)
        arrays = self._plan.read()
        return arrays if self._tracker.holds(arrays, settled._found.counts) else None

    def _start_from(self, grids: Sequence[Grid], corners: Sequence[Corners]) -> None:
        """Put the nodes of grids on the device. The tracker goes on from them if they suffice."""
        self._plan.take(grids, corners)
        self._follows = self._tracker is not None and self._tracker.begin(grids)


def _kind_of(frame: AnyImage) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Return the shape and the type of an image; raises ImageError for anything else."""
    image = check_image(frame)
    return image.shape, image.dtype


def _grids(
    arrays: dict[str, NDArray[Any]], numbers: Sequence[Grid], found: Found
) -> tuple[Grid, ...]:
    """Return the grids of nodes that were tracked, with the numbers of other grids."""
    return tuple(
        grid_of(arrays, view, grid, count)
        for view, (grid, count) in enumerate(zip(numbers, found.counts, strict=True))
    )


def _grid(measured: Measured, view: int) -> Grid:
    return measured.grids[view]


def _with_field(measured: Measured) -> Measured:
    """Return a frame, once its field is there."""
    _ = measured.field
    return measured
