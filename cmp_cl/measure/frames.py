"""Frames measured against the frame at rest, in one view and in two."""

import contextlib
import dataclasses
import functools
import math
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, check_kind
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid, build_grid
from cmp_cl.grid.grid import NO_SIDES, empty_grid
from cmp_cl.image import GreyImage, check_image
from cmp_cl.measure.patterns import (
    Region,
    align_views,
    check_size,
    check_two,
    find_pattern,
)
from cmp_cl.motion import PlaneScale, displacement
from cmp_cl.motion.plan import FieldPlan, fits
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.space import BinocularSplit, Points3D, StereoRig

# Frames without a grid over which numbers are continued. After more of them, a motion of half a
# cell per frame could reach the next position that looks the same.
BRIDGED = 1
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
    views, corners, grids: of the one view, or of the left and of the right one.
    rig: the cameras of two views; None from one view.
    """

    field: DisplacementField
    ambiguous: bool
    views: tuple[GreyImage, ...]
    corners: tuple[Corners, ...]
    grids: tuple[Grid, ...]
    rig: StereoRig | None = None

    @functools.cached_property
    def points(self) -> Points3D | None:
        """Return the positions of the nodes now, in space, triangulated when they are asked for;
        None from one view."""
        return None if self.rig is None else self.rig.triangulate(*self.grids)

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
        the lattice filter, if it is on; its strain, if it has one, see
        `DisplacementField.strains`; and the detected positions, (R, C, 2) float32, px: xy of one
        view, left and right of two.
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
        names = ("xy",) if len(self.grids) == 1 else ("left", "right")
        return arrays | {name: grid.xy for name, grid in zip(names, self.grids, strict=True)}


class Measurement(Closing):
    """Measures frames against the frame at rest. Use it in a with statement.

    constants: arrays that a series holds once: rest (R, C, 2) or (R, C, 3), unit, filtered (bool,
    whether the lattice filter is on), raw_rest (rest before that filter, if it is on), and the
    detected positions at rest, (R, C, 2), px: xy_rest, or left_rest and right_rest.
    unit: unit of the displacements.
    nodes: number of nodes of the pattern.
    """

    constants: dict[str, NDArray[Any]]
    unit: str
    nodes: int

    def __init__(self) -> None:
        self._detectors = contextlib.ExitStack()

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure one frame, of the size and the type of the frame at rest.

        frame: (H, W). Nodes that are not found are NaN; in a frame without the pattern all are.
        Raises ImageError, CapacityError and DeviceError as a `Detector` does.
        """
        raise NotImplementedError

    def skip(self) -> None:
        """Note that a frame is missing here; `track` continues numbers over few missing frames
        only."""
        for pattern in self._patterns():
            pattern.lost()

    def _patterns(self) -> "tuple[_Pattern, ...]":
        raise NotImplementedError

    def close(self) -> None:
        """Release the device's memory."""
        self._detectors.close()


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
    raw: leave out the lattice filter, see `cmp_cl.displacement`.
    strain: give every field its strain, see `DisplacementField.with_strain`.

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
        raw: bool = False,
        strain: bool = False,
    ) -> None:
        super().__init__()
        self._raw, self._strain = raw, strain
        search = _Search(select_device(device), shape, config, full_scale, track)
        with contextlib.ExitStack() as stack:
            self._pattern = _Pattern(rest, search, region)
            stack.enter_context(self._pattern.detector)
            at_rest = self._pattern.rest
            self._scale = (
                PlaneScale.pixels() if cell is None else PlaneScale.of_cells(at_rest, cell, unit)
            )
            self._detectors = stack.pop_all()
        self.unit = self._scale.unit
        self.nodes = at_rest.status.size
        still = displacement(at_rest, at_rest, scale=self._scale, raw=raw)
        self.constants = _constants(still) | {"xy_rest": at_rest.xy}
        if cell is not None:
            self.constants["homography"] = self._scale.matrix

    def _patterns(self) -> "tuple[_Pattern, ...]":
        return (self._pattern,)

    @property
    def rest_grid(self) -> Grid:
        """Return the grid of the frame at rest."""
        return self._pattern.rest

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure one frame, see `Measurement.__call__`."""
        corners, grid = self._pattern.find(frame)
        field = displacement(self._pattern.rest, grid, scale=self._scale, raw=self._raw)
        return Measured(
            field=field.with_strain() if self._strain else field,
            ambiguous=grid.ambiguous,
            views=(frame,),
            corners=(corners,),
            grids=(grid,),
        )


class TwoViews(Measurement):
    """Measures displacements in space from frames that hold two views.

    rest: the frame at rest, (H, W) uint8 or uint16. rig: the cameras, calibrated on views that were
        split in the same way.
    split: the rectangles of the two views in a frame. regions: regions of the left and of the right
    view, see `OneView`. The other arguments are those of `OneView`.

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
        raw: bool = False,
        strain: bool = False,
    ) -> None:
        check_kind("rig", rig, StereoRig, ConfigError)
        check_kind("split", split, BinocularSplit, ConfigError)
        super().__init__()
        self._raw, self._strain = raw, strain
        self._rig = rig
        self._split = split
        self._lock = threading.Lock()  # one frame at a time
        search = _Search(select_device(device), shape, config, full_scale, track)
        check_two("regions", regions)
        with contextlib.ExitStack() as stack:
            patterns = []
            for side, view, region in zip(("left", "right"), split(rest), regions, strict=True):
                try:
                    pattern = _Pattern(view, search, region)
                except GridError as error:
                    raise GridError(f"the {side} view: {error}") from error
                stack.enter_context(pattern.detector)
                patterns.append(pattern)
                search = dataclasses.replace(search, shape=pattern.rest.shape)
            self._left, self._right = patterns
            self._right.rest = align_views(self._left.rest, self._right.rest)
            self.rest = self._placed(self._left.rest, self._right.rest)
            self._detectors = stack.pop_all()
        self._plan = self._field_plan(search.device)
        self.unit = rig.unit
        self.nodes = self.rest.status.size
        still = displacement(self.rest, self.rest, raw=raw)
        positions = {"left_rest": self._left.rest.xy, "right_rest": self._right.rest.xy}
        self.constants = _constants(still) | positions

    def _patterns(self) -> "tuple[_Pattern, ...]":
        return self._left, self._right

    @property
    def rest_grids(self) -> tuple[Grid, Grid]:
        """Return the grids of the frame at rest, left and right."""
        return self._left.rest, self._right.rest

    def _placed(self, left: Grid, right: Grid) -> Points3D:
        points = self._rig.triangulate(left, right)
        both = np.count_nonzero(left.valid & right.valid)
        fitting = _fit(points)
        if not fitting >= _LEAST_FITTING * both or not both:
            raise GridError(
                f"the rig fits {fitting} of the {both} nodes that both views show to "
                f"{_FITS:g} px; check the calibration, the number of corners, the split, mirrored "
                "views, and which view is the left one"
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

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure one frame, see `Measurement.__call__`."""
        views = self._split(frame)
        left_corners, left = self._left.find(views[0])
        right_corners, right = self._right.find(views[1])
        field = self._between(left, right)
        return Measured(
            field=field.with_strain() if self._strain else field,
            ambiguous=left.ambiguous or right.ambiguous,
            views=views,
            corners=(left_corners, right_corners),
            grids=(left, right),
            rig=self._rig,
        )

    def _between(self, left: Grid, right: Grid) -> DisplacementField:
        """Return the displacement from rest to the moment of two grids."""
        if self._plan is None:
            return displacement(self.rest, self._rig.triangulate(left, right), raw=self._raw)
        with self._lock:
            self._plan.take((left, right))
            self._plan.start()
            field = self._plan.field(self._plan.read())
        return field.raw if self._raw and field.raw is not None else field

    def _field_plan(self, device: Device) -> FieldPlan | None:
        """Return the plan of the field; None if its kernels do not have the lens model."""
        if not fits(self._rig):
            return None
        plan = FieldPlan.on(
            device,
            rest=self.rest,
            rig=self._rig,
            edge_radii=(self._left.rest.edge_radius, self._right.rest.edge_radius),
            strain=self._strain,
        )
        self._detectors.callback(plan.release)
        return plan


def _constants(still: DisplacementField) -> dict[str, NDArray[Any]]:
    """Return the arrays that a series holds once, from the field of the frame at rest."""
    constants: dict[str, NDArray[Any]] = {
        "rest": still.position,
        "unit": np.array(still.unit),
        "filtered": np.array(still.raw is not None),
    }
    if still.raw is not None:
        constants["raw_rest"] = still.raw.position
    return constants


def _fit(points: Points3D) -> int:
    """Return the number of nodes that fit the rig."""
    return int(np.count_nonzero(points.valid & (points.error <= _FITS)))


def _middle(error: NDArray[np.float64]) -> float:
    """Return the median of the known errors; infinity if none is known."""
    known = error[~np.isnan(error)]
    return float(np.median(known)) if len(known) else math.inf


@dataclasses.dataclass(frozen=True)
class _Search:
    """The settings of a search for a pattern, see `OneView`."""

    device: Device
    shape: tuple[int, int] | None
    config: DetectorConfig | None
    full_scale: int | None
    track: bool


class _Pattern:
    """The pattern at rest in a view, and the detector that finds it in others.

    Raises GridError if the view shows no pattern.
    """

    def __init__(self, view: GreyImage, search: _Search, region: Region | None) -> None:
        config, shape, device = search.config, search.shape, search.device
        view = check_image(view)
        self._region = region
        self._track = search.track
        self._previous: Grid | None = None
        self._lost = 0  # frames since the last one with a grid
        if config is None:
            cell, _ = find_pattern(
                view, shape=shape, region=region, full_scale=search.full_scale, device=device
            )
            config = DetectorConfig.for_cell(cell).replace(full_scale=search.full_scale)
        check_kind("config", config, DetectorConfig, ConfigError)
        if search.config is not None and search.full_scale is not None:
            config = config.replace(full_scale=search.full_scale)
        with contextlib.ExitStack() as stack:
            self.detector = stack.enter_context(
                Detector(shape=view.shape, dtype=view.dtype, config=config, device=device)
            )
            self.corners, self.rest = self.detector.grid(view, shape=shape, region=region)
            if not self.rest.valid.any():
                raise GridError("no pattern is seen")
            check_size(self.rest)
            stack.pop_all()

    def find(self, view: GreyImage) -> tuple[Corners, Grid]:
        """Find the corners of another view and number them; without a pattern the grid is empty.

        The grid has the rows and columns of the grid at rest; nodes beyond them have no
        displacement.
        """
        corners = self.detector(view)
        before = (self._previous or self.rest) if self._track else None
        try:
            whole = build_grid(corners, view, like=self.rest, region=self._region, previous=before)
        except GridError:
            whole = None
        if whole is None or not whole.valid.any():
            self.lost()
            return corners, empty_grid(len(corners), self.rest.shape, self.rest)
        self._previous, self._lost = whole, 0
        return corners, whole.cut_to(self.rest)

    def lost(self) -> None:
        """Note that a frame is missing; numbers are continued over BRIDGED of them at most."""
        self._lost += 1
        if self._lost > BRIDGED:
            self._previous = dataclasses.replace(self._previous or self.rest, confidence=0.0)
