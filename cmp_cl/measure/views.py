"""The pattern at rest in each view of a recording, and its numbers in other frames."""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import GridError
from cmp_cl.grid import Grid, build_grid
from cmp_cl.grid.grid import empty_grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.patterns import check_board

# Frames without a grid over which numbers are continued. After more of them, a motion of half a
# cell per frame could reach the next position that looks the same.
BRIDGED = 1
MOST_CELLS = 0.5  # from frame to frame
# Rows and columns to the nearest nodes of the same colours
SHIFTS = np.array([(0, 2), (0, -2), (2, 0), (-2, 0), (1, 1), (-1, -1), (1, -1), (-1, 1)])


class View:
    """The pattern at rest in one view.

    rest: its grid, which may get the numbers of another view. corners: those at rest.
    of_left: whether the shape is that which the left view shows.

    Raises GridError if the view shows no pattern.
    """

    def __init__(
        self,
        detector: Detector,
        view: GreyImage,
        shape: tuple[int, int] | None,
        *,
        track: bool,
        of_left: bool = False,
    ) -> None:
        self.corners, rest = detector.grid(view, shape=shape)
        self._device = detector.device
        if of_left and rest.seen_shape is not None:
            here, left = (" x ".join(map(str, each)) for each in (rest.seen_shape, rest.shape))
            raise GridError(
                f"the board looks like {here} corners, in the left view like {left}; give its rows "
                "and columns, or show all of it in both"
            )
        check_board(rest)
        self.rest = _as_seen(rest, self.corners)
        self.track = track
        self._previous: Callable[[], Grid] | None = None
        self._lost = 0  # frames since the last one with a grid

    @functools.cached_property
    def sure(self) -> Grid:
        """Return the grid at rest, once it has its numbers, as one that is beyond doubt."""
        return dataclasses.replace(self.rest, confidence=math.inf, rival=None)

    def number(self, corners: Corners, view: GreyImage) -> Grid:
        """Number the corners of another frame; without a pattern the grid is empty.

        The grid has the rows and columns of the grid at rest; nodes beyond them have no
        displacement.
        """
        before = self._before() if self.track else None
        whole = self._numbered(corners, view, before)
        if before is not None and 0 < self._lost <= BRIDGED and self._may_slip(whole, before):
            whole = self._numbered(corners, view, _doubtful(before))
        if not whole.valid.any():
            self.lost()
            return empty_grid(len(corners), self.rest.shape, self.rest)
        whole = _as_seen(whole, corners)
        self.go_on(lambda: whole)
        return whole.cut_to(self.rest)

    def _numbered(self, corners: Corners, view: GreyImage, before: Grid | None) -> Grid:
        """Return the grid of a frame after another one, empty if it shows no pattern."""
        try:
            return build_grid(corners, view, like=self.rest, previous=before, device=self._device)
        except GridError:
            return empty_grid(len(corners), self.rest.shape, self.rest)

    def _may_slip(self, grid: Grid, before: Grid) -> bool:
        """Return whether the pattern may have come to another position that looks the same, in the
        frames since the one before."""
        most = MOST_CELLS * (self._lost + 1)
        off = np.linalg.norm(SHIFTS - _motion(grid, before), axis=1)
        return bool(grid.valid.any() and not off.min() >= most)

    def go_on(self, grid: Callable[[], Grid]) -> None:
        """Continue the numbers of a grid, which is made when needed, in the frames that follow."""
        self._previous, self._lost = grid, 0

    def lost(self) -> None:
        """Note that a frame is missing; numbers are continued over BRIDGED of them at most."""
        self._lost += 1
        if self._lost > BRIDGED:
            doubtful = _doubtful(self._before())
            self._previous = lambda: doubtful

    def _before(self) -> Grid:
        return self.rest if self._previous is None else self._previous()


def _doubtful(grid: Grid) -> Grid:
    """Return a grid whose numbers are not sure."""
    return dataclasses.replace(grid, confidence=0.0)


def _motion(grid: Grid, before: Grid) -> NDArray[np.float64]:
    """Return the mean motion of the nodes of two frames, (rows, columns), NaN without any."""
    moved = grid.cut_to(before).xy.astype(np.float64) - before.xy
    steps = [_mean(np.diff(before.xy.astype(np.float64), axis=axis)) for axis in (0, 1)]
    return np.asarray(np.linalg.solve(np.transpose(steps), _mean(moved)), np.float64)


def _mean(ways: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the known ones of ways (R, C, 2), NaN without any."""
    known = ways[np.isfinite(ways).all(axis=2)]
    return np.asarray(known.mean(axis=0)) if len(known) else np.full(2, np.nan)


def _as_seen(grid: Grid, corners: Corners) -> Grid:
    """Return a grid with its corners where they were seen, torn ones too, at rest as in each frame:
    wear moves with the print. The filter of a field knows their sigma."""
    known = grid.index[:, 0] >= 0
    xy = grid.xy.copy()
    xy[tuple(grid.index[known].T)] = corners.xy[known]
    return dataclasses.replace(grid, xy=xy)


@contextlib.contextmanager
def named(number: int, views: Sequence[GreyImage]) -> Iterator[None]:
    """Say in a GridError which of the views it is about, if there are two; number: of the view."""
    try:
        yield
    except GridError as error:
        if len(views) == 1:
            raise
        raise GridError(f"the {('left', 'right')[number]} view: {error}") from error
