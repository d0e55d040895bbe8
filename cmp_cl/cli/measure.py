"""Frames against the frame at rest: one view in the image, two views in space."""

import contextlib
import dataclasses
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cli.common import Region, alike, exact_config, find_pattern
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import GridError
from cmp_cl.field import DisplacementField, displacement
from cmp_cl.grid import Grid, build_grid
from cmp_cl.image import GreyImage
from cmp_cl.opencl.device import Device
from cmp_cl.stereo import BinocularSplit, Points3D, StereoRig

_FITS = 1.0  # px, largest reprojection error of a node that fits the rig
_LEAST_FITTING = 0.75  # share of the nodes at rest that must fit


class Wanted(NamedTuple):
    """How a pattern is looked for.

    shape: (rows, columns) of its corners, None for what is seen at rest. config: None for the
    most complete settings for the cells seen at rest. full_scale: of the camera, or None.
    regions: of each view (x0, y0, x1, y1), px, where its pattern is in every frame, or None.
    """

    device: Device
    shape: tuple[int, int] | None = None
    config: DetectorConfig | None = None
    full_scale: int | None = None
    regions: tuple[Region | None, ...] = (None, None)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """One frame against the rest frame.

    arrays: what goes into the series, by name. nodes: how many are measured now and at rest.
    largest: the largest displacement, px or the rig's unit, 0 without nodes. views, corners,
    grids: one, or left and right.
    """

    arrays: dict[str, NDArray[Any]]
    nodes: int
    largest: float
    views: tuple[GreyImage, ...]
    corners: tuple[Corners, ...]
    grids: tuple[Grid, ...]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MeasuredInSpace(Measured):
    """The same with where the nodes are in space, and how far they have moved."""

    points: Points3D
    field: DisplacementField


class Pattern:
    """The pattern at rest in a view, and the detector that finds it in others.

    Raises GridError where the view shows no pattern.
    """

    def __init__(self, view: GreyImage, wanted: Wanted, region: Region | None) -> None:
        config, shape = wanted.config, wanted.shape
        self._region = region
        if config is None:
            cell, seen = find_pattern(view, shape, wanted.device, wanted.full_scale, region)
            config, shape = exact_config(cell, wanted.full_scale), seen.shape
        elif wanted.full_scale is not None:
            config = config.replace(full_scale=wanted.full_scale)
        with contextlib.ExitStack() as stack:
            self.detector = stack.enter_context(
                Detector(shape=view.shape, dtype=view.dtype, config=config, device=wanted.device)
            )
            self.corners, self.rest = self.detector.grid(view, shape=shape, region=region)
            if not self.rest.valid.any():
                raise GridError("no pattern is seen")
            stack.pop_all()

    def find(self, view: GreyImage) -> tuple[Corners, Grid]:
        """The corners of another view and their grid, without a node where there is none."""
        corners = self.detector(view)
        try:
            return corners, build_grid(corners, view, like=self.rest, region=self._region)
        except GridError:
            return corners, _without_nodes(self.rest.shape, len(corners))


def _without_nodes(shape: tuple[int, int], corners: int) -> Grid:
    return Grid(
        xy=np.full((*shape, 2), np.nan, np.float32),
        status=np.zeros(shape, np.uint8),
        sigma=np.full(shape, np.nan, np.float32),
        index=np.full((corners, 2), -1, np.int32),
    )


class Measurement:
    """Frames against the rest frame; use it in a with statement.

    constants: what a series says once. unit: of the displacements. nodes: of the pattern.
    """

    constants: dict[str, NDArray[Any]]
    unit: str
    nodes: int

    def __init__(self) -> None:
        self._detectors = contextlib.ExitStack()

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure one frame, of the size and type of the rest frame."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._detectors.close()


class OneView(Measurement):
    """Positions in the image, px. Raises GridError where the rest frame has no pattern."""

    def __init__(self, rest: GreyImage, wanted: Wanted) -> None:
        super().__init__()
        self._pattern = Pattern(rest, wanted, wanted.regions[0])
        self._detectors.enter_context(self._pattern.detector)
        self.unit = "px"
        self.nodes = self._pattern.rest.status.size
        self.constants = {"rest": self._pattern.rest.xy, "unit": np.array(self.unit)}

    def __call__(self, frame: GreyImage) -> Measured:
        corners, grid = self._pattern.find(frame)
        moved = np.linalg.norm(grid.xy - self._pattern.rest.xy, axis=2)
        moved = moved[~np.isnan(moved)]
        return Measured(
            arrays={"xy": grid.xy, "sigma": grid.sigma, "status": grid.status},
            nodes=len(moved),
            largest=float(moved.max(initial=0)),
            views=(frame,),
            corners=(corners,),
            grids=(grid,),
        )


class TwoViews(Measurement):
    """Displacements in space from frames that hold two views.

    rest: the rest frame. Raises GridError where a view of it shows no pattern or the rig
    does not fit three quarters of its nodes, ImageError where a view leaves the frame.
    """

    def __init__(
        self, rest: GreyImage, rig: StereoRig, split: BinocularSplit, wanted: Wanted
    ) -> None:
        super().__init__()
        self._rig = rig
        self._split = split
        with contextlib.ExitStack() as stack:
            patterns = []
            sides = zip(("left", "right"), split(rest), wanted.regions, strict=True)
            for side, view, region in sides:
                try:
                    pattern = Pattern(view, wanted, region)
                except GridError as error:
                    raise GridError(f"the {side} view: {error}") from error
                stack.enter_context(pattern.detector)
                patterns.append(pattern)
                wanted = wanted._replace(shape=pattern.rest.shape)
            self._left, self._right = patterns
            self._right.rest = alike(self._left.rest, self._right.rest)
            self.rest = self._placed(self._left.rest, self._right.rest)
            self._detectors = stack.pop_all()
        self.unit = rig.unit
        self.nodes = self.rest.status.size
        self.constants = {
            "rest": self.rest.xyz,
            "left_rest": self._left.rest.xy,
            "right_rest": self._right.rest.xy,
            "unit": np.array(rig.unit),
        }

    @property
    def rest_grids(self) -> tuple[Grid, Grid]:
        """The grids of the rest frame, left and right."""
        return self._left.rest, self._right.rest

    def _placed(self, left: Grid, right: Grid) -> Points3D:
        points = self._rig.triangulate(left, right)
        both = np.count_nonzero(left.valid & right.valid)
        fitting = np.count_nonzero(points.valid & (points.error <= _FITS))
        if not fitting >= _LEAST_FITTING * both or not both:
            raise GridError(
                f"the rig fits {fitting} of the {both} nodes that both views show to "
                f"{_FITS:g} px; check the calibration, the number of corners, the split, mirrored "
                "views, and which view is the left one"
            )
        return points

    def __call__(self, frame: GreyImage) -> MeasuredInSpace:
        views = self._split(frame)
        left_corners, left = self._left.find(views[0])
        right_corners, right = self._right.find(views[1])
        points = self._rig.triangulate(left, right)
        field = displacement(self.rest, points)
        arrays: dict[str, NDArray[Any]] = {
            "displacement": field.displacement,
            "sigma": field.sigma,
            "status": field.status,
            "source": field.source,
            "left": left.xy,
            "right": right.xy,
        }
        moved = np.linalg.norm(field.displacement[field.valid], axis=1)
        return MeasuredInSpace(
            arrays=arrays,
            nodes=len(moved),
            largest=float(moved.max(initial=0)),
            views=views,
            corners=(left_corners, right_corners),
            grids=(left, right),
            points=points,
            field=field,
        )
