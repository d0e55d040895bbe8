"""Calibrates one, two or more cameras on views of a board."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, check_kind, check_positive
from cmp_cl.grid.grid import Grid
from cmp_cl.space.calibration.adjustment import (
    BEND,
    Look,
    State,
    adjust,
    heights,
    residuals,
    root_mean_square,
)
from cmp_cl.space.calibration.alone import Alone, calibrate_alone
from cmp_cl.space.calibration.placing import Seen, place, pose_of, vector_of
from cmp_cl.space.lens import (
    POSE,
    Lens,
    distortion_of,
    matrix_of,
    rotation_of,
    unknowns,
)
from cmp_cl.space.rig import StereoRig, spread

MIN_VIEWS = 3
MIN_NODES = 8  # fewest nodes of a board in a view
# Views that tell a bent board from other errors: with four of OpenCV's pairs, the bend makes the
# squares of the fifth worse.
ENOUGH_VIEWS = 10
# The nodes of two views that are alike lie apart by less than this, px and share of the board.
_ALIKE_PX, _ALIKE_SHARE = 1.0, 0.01
_MAX_MISFIT = 1.0  # px: the joint reprojection error may reach this, or
_MAX_MISFIT_RATIO = 3.0  # times the largest error of a camera alone
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A calibrated camera, and its pose relative to the first one.

    lens: the model. size: (width, height), px. matrix: (3, 3), px. distortion: as many coefficients
    as the lens has, 5, 8 or 4. R: (3, 3), T: (3,): X = R X_first + T, mm.

    Raises CalibrationError for another number of coefficients.
    """

    lens: Lens
    size: tuple[int, int]
    matrix: Array
    distortion: Array
    R: Array
    T: Array

    def __post_init__(self) -> None:
        if np.size(self.distortion) != self.lens.coefficients:
            raise CalibrationError(
                f"a {self.lens.value} lens has {self.lens.coefficients} coefficients of "
                f"distortion, not {np.size(self.distortion)}; give 0 for those it does not use"
            )


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """Cameras, calibrated on views of a board. V is the number of moments.

    cameras: by name, the first at the origin.
    grids: by camera, the grid of each view that is used, all with the numbers of the first camera
        that sees the board; None for the others.
    residuals: by camera, for each of these (R, C, 2) measured minus projected, px, with one pose
        of the board a moment.
    normals: (V, 3), the direction of the board's back in the frame of the first camera, NaN for
        moments that are not used.
    alike: groups of moments that show the same; of each only the first is used.
    focal_sigma: by camera, the larger standard deviation of the two focal lengths, px.
    covariance: see `StereoRig`; None but for two pinholes.
    flatness: how much higher than the lowest node the highest one of the board is, from the plane
        that fits best, mm; NaN if the views are too few to tell, or for a square board, whose
        numbers may begin at another corner once it is turned.
    """

    cameras: Mapping[str, Camera]
    grids: Mapping[str, Sequence[Grid | None]]
    residuals: Mapping[str, Sequence[Array | None]]
    normals: Array
    alike: Sequence[Sequence[int]]
    focal_sigma: Mapping[str, float]
    covariance: Array | None = None
    flatness: float = math.nan

    def __repr__(self) -> str:
        return f"<Calibration of {', '.join(self.cameras)}: {self.error:.3g} px>"

    @property
    def error(self) -> float:
        """Return the root mean square reprojection error, px."""
        every = itertools.chain.from_iterable(self.residuals.values())
        return root_mean_square([each for each in every if each is not None])

    @property
    def view_errors(self) -> dict[str, Array]:
        """Return the same for each view, by camera, (V,), NaN for views that are not used."""
        return {
            name: np.array([np.nan if one is None else root_mean_square([one]) for one in each])
            for name, each in self.residuals.items()
        }

    def rig(self) -> StereoRig:
        """Return the rig of two cameras; raises CalibrationError for fisheyes or another number."""
        cameras = list(self.cameras.values())
        if len(cameras) != 2 or Lens.FISHEYE in {camera.lens for camera in cameras}:
            raise CalibrationError("a rig has two cameras, neither of them a fisheye")
        one, two = cameras
        return StereoRig(
            one.matrix,
            one.distortion,
            two.matrix,
            two.distortion,
            two.R,
            two.T,
            covariance=self.covariance,
        )


def calibrate(
    views: Mapping[str, Sequence[Grid | None]],
    *,
    spacing: float,
    sizes: Mapping[str, tuple[int, int]],
    lens: Lens = Lens.PINHOLE,
) -> Calibration:
    """Calibrate cameras on views of one board.

    views: by camera, the grid at every moment, None if the camera does not see the board.
    spacing: side of a square, mm. sizes: by camera, (width, height) of its images, px.
    lens: the lens model of all cameras.

    A view may show part of the board, and may be numbered from any corner of it. Views that show
    the same, as frames of a board that stands still do, count as one: copies bring nothing new.
    OpenCV calibrates each camera alone; all are then adjusted by least squares, with one pose of
    the board a moment. From ten moments on, the board may be bent, alike in all views.

    Raises CalibrationError if a camera has fewer than three different views of at least eight
    nodes, if they do not determine the focal length (the board faces the camera in all of them), if
    a camera shares no moment with the others, if no pose between the cameras fits the views, or if
    a node lies outside its image.
    """
    if not views or views.keys() != sizes.keys():
        raise CalibrationError(
            f"sizes must be of the cameras in views, at least one: {list(views)}, not {list(sizes)}"
        )
    check_positive("spacing", spacing, CalibrationError)
    check_kind("lens", lens, Lens, CalibrationError)
    for name, each in views.items():
        _check_size(name, each, sizes[name])
    seen, alike = _different(views)
    names = list(views)
    alone = {
        name: calibrate_alone(
            name,
            lens,
            [_look(grid, 0, moment) for (own, moment), grid in seen.items() if own == name],
            sizes[name],
        )
        for name in names
    }
    places = place(alone, seen)
    seen = places.grids
    moments = {moment: number for number, moment in enumerate(sorted(places.boards))}
    every = [
        _look(grid, names.index(name), moments[moment]) for (name, moment), grid in seen.items()
    ]
    state = State(
        np.array([np.r_[alone[n].camera[:-POSE], vector_of(places.cameras[n])] for n in names]),
        np.array([vector_of(places.boards[moment]) for moment in moments]),
        np.zeros(BEND if _may_bend(every, len(moments)) else 0),
    )
    state, cov = adjust(every, state)
    _check_fit(every, state, alone, places.odd)
    factor = np.ones(state.cameras.shape)
    factor[:, -3:] = spacing  # the translations
    cameras, unknown = state.cameras * factor, unknowns(state.cameras)
    deviation = np.full(unknown.shape, np.nan)
    if cov is not None:
        cov = cov * np.outer(factor[unknown], factor[unknown])
        deviation[unknown] = np.sqrt(np.diag(cov))
    residual: dict[str, list[Array | None]] = {n: [None] * len(each) for n, each in views.items()}
    for ((name, moment), grid), look in zip(seen.items(), every, strict=True):
        residual[name][moment] = spread(grid.valid, residuals(look, state))
    normals = np.full((max(map(len, views.values())), 3), np.nan)
    normals[list(moments)] = [pose_of(pose)[:3, 2] for pose in state.poses]
    return Calibration(
        cameras={
            name: Camera(
                lens=lens,
                size=sizes[name],
                matrix=matrix_of(camera),
                distortion=distortion_of(camera),
                R=rotation_of(camera),
                T=camera[-3:],
            )
            for name, camera in zip(names, cameras, strict=True)
        },
        grids={n: [seen.get((n, moment)) for moment in range(len(views[n]))] for n in names},
        residuals=residual,
        normals=normals,
        alike=alike,
        focal_sigma={
            name: float(row[:2].max()) for name, row in zip(names, deviation, strict=True)
        },
        covariance=cov if lens is Lens.PINHOLE and len(names) == 2 else None,
        flatness=spacing * _flatness(every, state),
    )


def _check_size(name: str, views: Sequence[Grid | None], size: tuple[int, int]) -> None:
    """Raise CalibrationError if a node of a camera's views lies beyond its images."""
    every = [grid.xy[grid.valid] for grid in views if grid is not None]
    x, y = np.concatenate([np.zeros((1, 2)), *every]).max(axis=0)
    if x > size[0] or y > size[1]:
        raise CalibrationError(
            f"{name}: corners lie at up to x = {x:.0f} and y = {y:.0f}, beyond images of "
            f"{size[0]} x {size[1]} px; a size is (width, height)"
        )


def _may_bend(looks: Sequence[Look], moments: int) -> bool:
    """Return whether the views tell how the board is bent: they are enough, and three rows and
    columns or more are seen."""
    extent = np.ptp(np.concatenate([look.nodes for look in looks]), axis=0)
    return bool(moments >= ENOUGH_VIEWS and (extent[:2] > 1).all())


def _flatness(looks: Sequence[Look], state: State) -> float:
    """Return how much higher than the lowest node the highest one of the bent board is, from the
    plane that fits best, squares; NaN of a flat board, or of a square one."""
    nodes = np.unique(np.concatenate([look.nodes for look in looks]), axis=0)
    columns, rows, _ = np.ptp(nodes, axis=0)
    if not len(state.bend) or rows == columns:
        return math.nan
    height = heights(nodes) @ state.bend
    plane = np.column_stack([nodes[:, :2], np.ones(len(nodes))])
    return float(np.ptp(height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]))


def _different(views: Mapping[str, Sequence[Grid | None]]) -> tuple[Seen, list[list[int]]]:
    """Return the grids that bring something new, and the groups of at least two moments whose views
    are alike in each camera, of which the first is taken.

    Raises CalibrationError if a camera has too few of them.
    """
    large: Seen = {}
    for name, each in views.items():
        for moment, grid in enumerate(each):
            rows, columns = ((), ()) if grid is None else np.nonzero(grid.valid)
            if grid is not None and len(rows) >= MIN_NODES and np.ptp(rows) and np.ptp(columns):
                large[name, moment] = grid
    groups: list[list[int]] = []
    for moment in sorted({moment for _, moment in large}):
        for group in groups:
            both = [n for n in views if (n, moment) in large and (n, group[0]) in large]
            if both and all(_same(large[name, group[0]], large[name, moment]) for name in both):
                group.append(moment)
                break
        else:
            groups.append([moment])
    first = {group[0] for group in groups}
    seen = {key: grid for key, grid in large.items() if key[1] in first}
    for name in views:
        count, copies = (sum(key[0] == name for key in each) for each in (seen, large))
        others = f"; {copies - count} more show the same: move and tilt the board between views"
        if count < MIN_VIEWS:
            raise CalibrationError(
                f"{name}: {MIN_VIEWS} different views with at least {MIN_NODES} corners are "
                f"needed, better 10, not {count}{others if copies > count else ''}"
            )
    return seen, [group for group in groups if len(group) > 1]


def _same(one: Grid, other: Grid) -> bool:
    """Return whether two views show the board at one place, from whichever corner they count."""
    size = np.linalg.norm(np.ptp(one.xy[one.valid], axis=0))
    limit = max(_ALIKE_PX, _ALIKE_SHARE * float(size))
    for quarters in range(4):
        turned = np.rot90(other.xy, quarters)
        if turned.shape == one.xy.shape:
            square = np.square(turned.astype(np.float64) - one.xy).sum(axis=2)
            both = np.isfinite(square)
            if both.sum() >= MIN_NODES and square[both].mean() < limit**2:
                return True
    return False


def _look(grid: Grid, camera: int, moment: int) -> Look:
    """Return what a camera sees of a flat board, whose squares have side 1: OpenCV's calibrations
    stop too early where the numbers of a length are large."""
    row, column = np.nonzero(grid.valid)
    nodes = np.column_stack([column, row, np.zeros(len(row))]).astype(np.float64)
    return Look(camera, moment, nodes, grid.xy[grid.valid].astype(np.float64))


def _check_fit(
    looks: Sequence[Look], state: State, alone: Mapping[str, Alone], odd: Sequence[int]
) -> None:
    """Raise CalibrationError if cameras fit the views much worse together than each alone."""
    error = root_mean_square([residuals(look, state) for look in looks])
    best = max(each.error for each in alone.values())
    if error > max(_MAX_MISFIT, _MAX_MISFIT_RATIO * best):
        named = f"; worst fit views {', '.join(map(str, odd))}, from 0" if odd else ""
        raise CalibrationError(
            f"no pose between the cameras fits the views of {', '.join(alone)}: together they miss "
            f"by {error:.1f} px, each alone by at most {best:.2f} px{named}; check the shape of "
            "the board, and that all cameras see it at the same moments"
        )
