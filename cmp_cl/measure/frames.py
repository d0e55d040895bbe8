"""Frames measured against the frame at rest, in one view and in two."""

import contextlib
import dataclasses
import functools
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.errors import ConfigError, DeviceError, GridError, ImageError, check_kind
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid
from cmp_cl.grid.grid import NO_SIDES
from cmp_cl.image import GreyImage
from cmp_cl.measure.patterns import Region, align_views, check_two
from cmp_cl.measure.views import Search, Views
from cmp_cl.motion import PlaneScale, displacement
from cmp_cl.motion.geometry import InPlane, InSpace, fits
from cmp_cl.motion.moments import Moment
from cmp_cl.motion.nodes import grid_of
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.motion.track import Tracker, can_track, differing
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.opencl.launches import sum_times
from cmp_cl.opencl.program import programs_of
from cmp_cl.space import Bias, BinocularSplit, Points3D, PointStatus, StereoRig
from cmp_cl.stages.plan import Plan

AUDITED = 256  # tracked frames, of which the last is numbered anew too
_FITS = 1.0  # px, largest reprojection error of a node that fits the rig
_LEAST_FITTING = 0.75  # share of the nodes at rest that must fit
_FLIP = np.array([-1, 1], np.float32)
# Rows and columns to the nearest nodes of the same colours; the opposite ones follow from them.
_SHIFTS = (0, 2), (2, 0), (1, 1), (1, -1)
_BETTER = 0.25  # share of the reprojection error that is left if the views were swapped or mirrored


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A frame, measured against the frame at rest.

    field: the displacement of the nodes, in the image, in the plane of a flat pattern, or in space.
    ambiguous: whether the numbering of a grid is ambiguous, see `Grid.ambiguous`.
    views, corners: of the one view, or of the left and of the right one.
    number: returns their grids, see `grids`.
    rig: the cameras of two views; None from one view.
    bias: of the rig, where it has a window and a covariance.
    tracked: whether its nodes have their numbers from the frame before.
    differing: the nodes for which tracking had another corner than the numbers that were found
        anew, which hold; 0 where none were looked for.
    """

    field: DisplacementField
    ambiguous: bool
    views: tuple[GreyImage, ...]
    corners: tuple[Corners, ...]
    number: Callable[[], tuple[Grid, ...]]
    rig: StereoRig | None = None
    bias: Bias | None = None
    tracked: bool = False
    differing: int = 0

    @functools.cached_property
    def grids(self) -> tuple[Grid, ...]:
        """Return the grid of the one view, or those of the left and of the right one."""
        return self.number()

    @functools.cached_property
    def points(self) -> Points3D | None:
        """Return the positions of the nodes now, in space, triangulated when they are asked for;
        None from one view."""
        return None if self.rig is None else self.rig.triangulate(*self.grids)

    @property
    def bias_sigma(self) -> NDArray[np.float64] | None:
        """Return the standard deviation of the displacement by the error of the rig, (R, C), see
        `cmp_cl.space.Bias`; None without a bias."""
        return None if self.bias is None else self.bias.sigma(self.field.displacement)

    @property
    def nodes(self) -> int:
        """Return the number of nodes that are measured both at rest and now."""
        return int(np.count_nonzero(self.field.valid))

    @property
    def largest(self) -> float:
        """Return the largest displacement in the unit of the field, 0 without nodes."""
        moved = self.field.displacement[self.field.valid]
        return float(np.linalg.norm(moved, axis=1).max(initial=0))

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for `SeriesWriter.append`, by name.

        displacement, sigma, status and source of the field; raw_displacement and raw_sigma before
        the lattice filter; its strain, if it has one, see
        `DisplacementField.strains`; bias_sigma, if there is one; and the detected positions,
        (R, C, 2) float32, px: xy of one view, left and right of two.
        """
        field = self.field
        arrays: dict[str, NDArray[Any]] = {
            "displacement": field.displacement,
            "sigma": field.sigma,
            "status": field.status,
            "source": field.source,
            **field.strains(),
        }
        if field.raw is not None:
            arrays |= {"raw_displacement": field.raw.displacement, "raw_sigma": field.raw.sigma}
        if self.bias is not None:
            arrays["bias_sigma"] = self.bias.sigma(field.displacement)
        names = ("xy",) if len(self.grids) == 1 else ("left", "right")
        return arrays | {name: grid.xy for name, grid in zip(names, self.grids, strict=True)}


@dataclasses.dataclass
class Tally:
    """How the frames of a recording got their numbers.

    tracked: frames that have them from the frame before. numbered: frames whose numbers were found
    anew, those that could not be tracked and those audited. audited: frames that were tracked, and
    whose numbers were found anew all the same. differing: nodes for which the two had another
    corner.
    """

    tracked: int = 0
    numbered: int = 0
    audited: int = 0
    differing: int = 0


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
        corners, same = self._views.finish(begun.plans)
        settled = _Settled(begun.views, corners)
        if begun.tracked and self._plan is not None and self._tracker is not None:
            settled.arrays = arrays = self._plan.read()
            counts = [len(each) for each in corners]
            settled.tracked = same and self._tracker.holds(arrays, counts)
            settled.grids = [
                functools.partial(grid_of, arrays, number, view.rest, count)
                for number, (view, count) in enumerate(zip(views, counts, strict=True))
            ]
        if settled.tracked:
            tally.tracked += 1
            for view, grid in zip(views, settled.grids, strict=True):
                view.go_on(grid)
            if tally.tracked % AUDITED:
                return settled
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
            corners=settled.corners,
            number=settled.number,
            rig=self._rig,
            bias=self._bias,
            tracked=settled.tracked,
            differing=settled.differing,
        )


@dataclasses.dataclass(eq=False)
class _Settled:
    """A frame whose kernels are done, and whose nodes have numbers.

    grids: return the grid of each view. arrays: what its field comes from; None without a plan.
    tracked, differing, ambiguous: as in `Measured`.
    """

    views: tuple[GreyImage, ...]
    corners: tuple[Corners, ...]
    grids: list[Callable[[], Grid]] = dataclasses.field(default_factory=list)
    arrays: dict[str, NDArray[Any]] | None = None
    tracked: bool = False
    differing: int = 0
    ambiguous: bool = False

    def number(self) -> tuple[Grid, ...]:
        return tuple(grid() for grid in self.grids)


def _given(grid: Grid) -> Grid:
    return grid


class OneView(Measurement):
    """Measures the displacement of the nodes in the image, px, or in the plane of a flat pattern.

    rest: the frame at rest, (H, W) uint8 or uint16.
    shape: (rows, columns) of the pattern's corners; None takes the shape that is seen at rest.
    region: (x0, y0, x1, y1), px, holds the pattern in every frame; None is the whole frame.
    cell: side of the cells of a flat pattern, in `unit`, to measure in its plane, see
        `cmp_cl.motion.PlaneScale.of_cells`; None measures in px.
    unit: name of the unit of length; only with a cell.
    config: configuration of the detector; None finds the pattern at rest with `DetectorConfig()`,
        as every caller does, and then takes `DetectorConfig.for_cell` for its cells.
    track: continue the numbers of the previous frame if the frame at rest leaves them ambiguous.
        Frames then come in order, and the pattern as a whole moves by less than half a cell from
        the frame at rest to the first and from each to the next. After two frames without a grid,
        or one that is ambiguous, those that follow are ambiguous too, until a border or the
        printing errors decide.
    full_scale: the camera's largest grey level; None is that of the configuration or of the type.
    device: a Device, a text for `select_device`, or None for the default device.
    strain: give every field its strain, see `DisplacementField.with_strain`.
    profile: record the times of the kernels of the last frame, see `times`.

    With a cell, constants has the homography too, (3, 3), from px to the plane.

    Raises GridError if the frame at rest shows no such pattern, FieldError if its nodes do not fix
    the plane, and the errors of `Detector`.
    """

    def __init__(
        self,
        rest: GreyImage,
        *,
        shape: tuple[int, int] | None = None,
        region: Region | None = None,
        cell: float | None = None,
        unit: str = "mm",
        config: DetectorConfig | None = None,
        full_scale: int | None = None,
        device: Device | str | None = None,
        track: bool = False,
        strain: bool = False,
        profile: bool = False,
    ) -> None:
        super().__init__(device=select_device(device), strain=strain, profile=profile)
        search = Search(
            device=self._device,
            shape=shape,
            config=config,
            full_scale=full_scale,
            track=track,
            profile=profile,
        )
        with self._closed_on_error():
            self._views = self._stack.enter_context(Views([rest], search, [region]))
            at_rest = self.rest_grid
            self._scale = (
                PlaneScale.pixels() if cell is None else PlaneScale.of_cells(at_rest, cell, unit)
            )
            moment = Moment.in_plane(at_rest, self._scale)
            geometry = InPlane(self._scale, at_rest.edge_radius)
            self._plan_for(search.device, rest, moment, geometry)
        self.unit = self._scale.unit
        self.nodes = at_rest.status.size
        still = displacement(at_rest, at_rest, scale=self._scale, device=self._device)
        self.constants = _constants(still) | {"xy_rest": at_rest.xy}
        if cell is not None:
            self.constants["homography"] = self._scale.matrix

    @property
    def rest_grid(self) -> Grid:
        """Return the grid of the frame at rest."""
        return self._views.views[0].rest

    def _views_of(self, frame: GreyImage) -> tuple[GreyImage, ...]:
        return (frame,)

    def _between(self, grids: Sequence[Grid]) -> DisplacementField:
        return displacement(self.rest_grid, grids[0], scale=self._scale, device=self._device)


class TwoViews(Measurement):
    """Measures displacements in space from frames that hold two views.

    rest: the frame at rest, (H, W) uint8 or uint16. rig: the cameras, calibrated on views that were
        split in the same way.
    split: the rectangles of the two views in a frame. regions: regions of the left and of the right
    view, see `OneView`. The other arguments are those of `OneView`.

    A device without double precision computes in float32: displacements 46 mm away then differ by
    at most .015 um, behind a window by .05 um (measured).

    Raises GridError if a view of the frame at rest shows no such pattern, or the rig does not fit
    three quarters of its nodes to 1 px, or it fits other pairs of nodes as well and the two views
    do not show the pattern's border on the same side; ImageError if a view extends past the frame;
    ConfigError if rig or split is of another type; and the errors of `Detector`.
    """

    def __init__(
        self,
        rest: GreyImage,
        rig: StereoRig,
        split: BinocularSplit,
        *,
        shape: tuple[int, int] | None = None,
        regions: tuple[Region | None, Region | None] = (None, None),
        config: DetectorConfig | None = None,
        full_scale: int | None = None,
        device: Device | str | None = None,
        track: bool = False,
        strain: bool = False,
        profile: bool = False,
    ) -> None:
        check_kind("rig", rig, StereoRig, ConfigError)
        check_kind("split", split, BinocularSplit, ConfigError)
        super().__init__(device=select_device(device), strain=strain, profile=profile)
        self._rig: StereoRig = rig
        self._split = split
        check_two("regions", regions)
        search = Search(
            device=self._device,
            shape=shape,
            config=config,
            full_scale=full_scale,
            track=track,
            profile=profile,
        )
        with self._closed_on_error():
            self._views = self._stack.enter_context(Views(split(rest), search, regions))
            self._size = rest.shape
            left, right = self._views.views
            right.rest = align_views(left.rest, right.rest, rig.R)
            self.rest = self._placed(left.rest, right.rest)
            if fits(rig):
                geometry = InSpace(rig, [view.rest.edge_radius for view in self._views.views])
                self._plan_for(search.device, rest, Moment.in_space(self.rest), geometry)
        if rig.window is not None and rig.covariance is not None:
            self._bias = Bias(rig, self.rest.xyz)
        self.unit = rig.unit
        self.nodes = self.rest.status.size
        still = displacement(self.rest, self.rest, device=self._device)
        positions = {"left_rest": left.rest.xy, "right_rest": right.rest.xy}
        self.constants = _constants(still) | positions

    @property
    def rest_grids(self) -> tuple[Grid, Grid]:
        """Return the grids of the frame at rest, left and right."""
        left, right = self._views.views
        return left.rest, right.rest

    def _placed(self, left: Grid, right: Grid) -> Points3D:
        points = self._rig.triangulate(left, right)
        both = np.count_nonzero(left.valid & right.valid)
        fitting = _fit(points)
        in_front = np.count_nonzero(points.status == PointStatus.BEHIND)
        if self._rig.window is not None and in_front > both / 2:
            raise GridError(
                f"the rig's window lies beyond the pattern: {in_front} of the {both} nodes would "
                "lie in front of its last face; check its distance, its layers, and which view is "
                "the left one"
            )
        if not fitting >= _LEAST_FITTING * both or not both:
            glass = ", a window or gel that the calibration does not know (calibrate --window)"
            raise GridError(
                f"the rig fits {fitting} of the {both} nodes that both views show to "
                f"{_FITS:g} px; check the calibration, the number of corners, the split, mirrored "
                f"views{glass if self._rig.window is None else ''}, and which view is the left one"
            )
        self._check_order(left, right, _middle(points.error))
        self._check_pairs(left, right)
        return points

    def _check_pairs(self, left: Grid, right: Grid) -> None:
        """Raise GridError if the rig fits as well with the numbers of one view shifted, and no side
        at which both views show the border of the pattern decides.

        Along the epipolar lines another pair of nodes is a point at another depth.
        """
        borders = zip(left.border or NO_SIDES, right.border or NO_SIDES, strict=True)
        both = [here and there for here, there in borders]
        open_ways = not any(both[:2]), not any(both[2:])
        for shift in _SHIFTS:
            if any(step and not is_open for step, is_open in zip(shift, open_ways, strict=True)):
                continue
            for sign in (1, -1):
                rows, columns = shifted = sign * shift[0], sign * shift[1]
                other = dataclasses.replace(right, origin=shifted).cut_to(left)
                points = self._rig.triangulate(left, other)
                pairs = np.count_nonzero(left.valid & other.valid)
                if pairs and _fit(points) >= _LEAST_FITTING * pairs:
                    raise GridError(
                        f"the two views may show different parts of the pattern: the rig fits as "
                        f"well with the right view's numbers shifted by {rows} rows and {columns} "
                        "columns; give the pattern's rows and columns, or show its border on the "
                        "same side of both views"
                    )

    def _check_order(self, left: Grid, right: Grid, error: float) -> None:
        """Raise GridError if the rig fits far better to views that are swapped or mirrored.

        A flat pattern near the point at which the cameras look fits to 1 px even so, with its
        heights reversed. error: the median reprojection error of the views as they are, px.
        """
        flipped = [
            dataclasses.replace(grid, xy=grid.xy * _FLIP + (view[2] - 1, 0))
            for grid, view in ((left, self._split.left), (right, self._split.right))
        ]
        other, how = min(
            (_middle(self._rig.triangulate(*views).error), how)
            for how, views in (
                ("left and right swapped", (right, left)),
                ("both views mirrored", flipped),
            )
        )
        if other < _BETTER * error:
            raise GridError(
                f"the rig fits the nodes to {error:.2g} px, but with {how} to {other:.2g} px; give "
                "the views as they were in the calibration"
            )

    def _views_of(self, frame: GreyImage) -> tuple[GreyImage, ...]:
        views = self._split(frame)
        if frame.shape != self._size:
            raise ImageError(
                f"the frame at rest is {self._size}, this one {frame.shape}; measure a recording "
                "of another size against its own frame at rest"
            )
        return views

    def _between(self, grids: Sequence[Grid]) -> DisplacementField:
        return displacement(self.rest, self._rig.triangulate(*grids), device=self._device)


def _constants(still: DisplacementField) -> dict[str, NDArray[Any]]:
    """Return the arrays that a series holds once, from the field of the frame at rest."""
    assert still.raw is not None
    return {
        "rest": still.position,
        "raw_rest": still.raw.position,
        "unit": np.array(still.unit),
    }


def _fit(points: Points3D) -> int:
    """Return the number of nodes that fit the rig."""
    return int(np.count_nonzero(points.valid & (points.error <= _FITS)))


def _middle(error: NDArray[np.float64]) -> float:
    """Return the median of the known errors; infinity if none is known."""
    known = error[~np.isnan(error)]
    return float(np.median(known)) if len(known) else math.inf
