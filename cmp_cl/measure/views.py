"""The views of a recording: the pattern at rest in each, and its numbers in other frames."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence

from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, check_kind
from cmp_cl.grid import Grid, build_grid
from cmp_cl.grid.grid import empty_grid
from cmp_cl.image import GreyImage, check_image
from cmp_cl.measure.patterns import Region, check_size, find_pattern
from cmp_cl.opencl.device import Device
from cmp_cl.stages.plan import Plan
from cmp_cl.stages.refine import Found

# Frames without a grid over which numbers are continued. After more of them, a motion of half a
# cell per frame could reach the next position that looks the same.
BRIDGED = 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Search:
    """The settings of a search for a pattern, see `OneView`."""

    device: Device
    shape: tuple[int, int] | None
    config: DetectorConfig | None
    full_scale: int | None
    track: bool
    profile: bool


class View:
    """The pattern at rest in one view.

    rest: its grid. corners: those at rest.

    Raises GridError if the view shows no pattern.
    """

    def __init__(
        self,
        detector: Detector,
        view: GreyImage,
        shape: tuple[int, int] | None,
        region: Region | None,
        *,
        track: bool,
    ) -> None:
        self.corners, self.rest = detector.grid(view, shape=shape, region=region)
        self._device = detector.device
        if not self.rest.valid.any():
            raise GridError("no pattern is seen")
        check_size(self.rest)
        self.region, self.track = region, track
        self._previous: Callable[[], Grid] | None = None
        self._lost = 0  # frames since the last one with a grid

    def number(self, corners: Corners, view: GreyImage) -> Grid:
        """Number the corners of another frame; without a pattern the grid is empty.

        The grid has the rows and columns of the grid at rest; nodes beyond them have no
        displacement.
        """
        before = self._before() if self.track else None
        try:
            whole = build_grid(
                corners,
                view,
                like=self.rest,
                region=self.region,
                previous=before,
                device=self._device,
            )
        except GridError:
            whole = None
        if whole is None or not whole.valid.any():
            self.lost()
            return empty_grid(len(corners), self.rest.shape, self.rest)
        # A field takes the corners as they were seen, torn ones too; its filter knows their sigma.
        known = whole.index[:, 0] >= 0
        xy = whole.xy.copy()
        xy[tuple(whole.index[known].T)] = corners.xy[known]
        whole = dataclasses.replace(whole, xy=xy)
        self.go_on(lambda: whole)
        return whole.cut_to(self.rest)

    def go_on(self, grid: Callable[[], Grid]) -> None:
        """Continue the numbers of a grid, which is made when needed, in the frames that follow."""
        self._previous, self._lost = grid, 0

    def lost(self) -> None:
        """Note that a frame is missing; numbers are continued over BRIDGED of them at most."""
        self._lost += 1
        if self._lost > BRIDGED:
            doubtful = dataclasses.replace(self._before(), confidence=0.0)
            self._previous = lambda: doubtful

    @property
    def continues(self) -> bool:
        """Return whether few frames are missing since the last one with a grid."""
        return self._lost <= BRIDGED

    def _before(self) -> Grid:
        return self.rest if self._previous is None else self._previous()


class Views(Closing):
    """The views of a recording, and the detectors that find their corners.

    at_rest: the views of the frame at rest. regions: one for each, see `OneView`.

    Raises GridError if a view shows no pattern.
    """

    def __init__(
        self, at_rest: Sequence[GreyImage], search: Search, regions: Sequence[Region | None]
    ) -> None:
        at_rest = [check_image(view) for view in at_rest]
        names = [None] if len(at_rest) == 1 else ["left", "right"]
        shape = search.shape
        with _named(names[0]):
            config = _config_for(at_rest[0], search, regions[0])
        alike = len({view.shape for view in at_rest}) == 1
        parts = [slice(None)] if alike else [slice(n, n + 1) for n in range(len(at_rest))]
        found: list[View] = []
        with contextlib.ExitStack() as stack:
            # One detector for views of one size, so that their kernels run together.
            self._detectors = [
                (stack.enter_context(_detector(at_rest[part][0], config, search)), part)
                for part in parts
            ]
            for number, (view, name) in enumerate(zip(at_rest, names, strict=True)):
                detector = self._detectors[0 if alike else number][0]
                with _named(name):
                    found.append(View(detector, view, shape, regions[number], track=search.track))
                shape = found[-1].rest.shape
            self._stack = stack.pop_all()
        self.views = tuple(found)

    def close(self) -> None:
        """Release the device's memory."""
        self._stack.close()

    @property
    def detector(self) -> Detector | None:
        """Return the detector of all views; None if each has its own."""
        return self._detectors[0][0] if len(self._detectors) == 1 else None

    @property
    def launches(self) -> int:
        """Return the number of launches that find the corners of a frame."""
        return sum(len(detector.layout.launches) for detector, _ in self._detectors)

    def begin(self, views: Sequence[GreyImage]) -> list[Plan]:
        """Enqueue the kernels that find the corners of a frame, see `Detector.begin`."""
        return [detector.begin(views[part]) for detector, part in self._detectors]

    def finish(self, plans: Sequence[Plan]) -> tuple["Seen", bool]:
        """Return the corners of each view, and whether `Detector.finish` says that they are those
        on the device."""
        done = [each.finish(plan) for (each, _), plan in zip(self._detectors, plans, strict=True)]
        return Seen([found for found, _ in done]), all(same for _, same in done)


class Seen:
    """The corners of each view, made when they are asked for. counts: their numbers."""

    def __init__(self, found: Sequence[Found]) -> None:
        self._found = found
        self.counts = [count for each in found for count in each.counts]

    @property
    def corners(self) -> tuple[Corners, ...]:
        """Return the corners of each view."""
        return tuple(corners for each in self._found for corners in each.corners)


@contextlib.contextmanager
def _named(side: str | None) -> Iterator[None]:
    """Say in a GridError which view it is about."""
    try:
        yield
    except GridError as error:
        if side is None:
            raise
        raise GridError(f"the {side} view: {error}") from error


def _config_for(view: GreyImage, search: Search, region: Region | None) -> DetectorConfig:
    """Return the configuration of the detector, by default that for the cells in a view."""
    config = search.config
    if config is None:
        cell, _ = find_pattern(
            view,
            shape=search.shape,
            region=region,
            full_scale=search.full_scale,
            device=search.device,
        )
        return DetectorConfig.for_cell(cell).replace(full_scale=search.full_scale)
    check_kind("config", config, DetectorConfig, ConfigError)
    return config if search.full_scale is None else config.replace(full_scale=search.full_scale)


def _detector(view: GreyImage, config: DetectorConfig, search: Search) -> Detector:
    return Detector(
        shape=view.shape,
        dtype=view.dtype,
        config=config,
        device=search.device,
        profile=search.profile,
    )
