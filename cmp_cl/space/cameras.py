"""Calibration of one, two or more cameras from views of a flat board, with a choice of lens.

`cmp_cl.calibrate` makes the rig of two pinhole cameras for triangulation. `calibrate_cameras` takes
any number of cameras and wide lenses, for the formats of `cmp_cl.space.exports`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, as_size, check_kind, check_positive, listed
from cmp_cl.grid.grid import Grid
from cmp_cl.space.adjustment import Look, root_mean_square
from cmp_cl.space.joint import adjust_together
from cmp_cl.space.lens import (
    POSE,
    Lens,
    camera_of,
    distortion_of,
    matrix_of,
    projected,
    rotation_of,
)
from cmp_cl.space.rig import StereoRig, spread
from cmp_cl.space.start import (
    MIN_NODES,
    MIN_VIEWS,
    Alone,
    board_of,
    calibrate_alone,
    look_at,
    unknowns,
)

__all__ = ["Camera", "CamerasCalibration", "Lens", "calibrate_cameras"]

Array = NDArray[np.float64]

_COVERAGE = 8  # cells along a side of the image, for the coverage


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A calibrated camera, and its pose relative to the first one.

    lens: the model. size: (width, height), px. matrix: (3, 3), px. distortion: 5, 8 or 4
    coefficients. R: (3, 3), T: (3,): X = R X_first + T, T in `unit`.
    """

    lens: Lens
    size: tuple[int, int]
    matrix: Array
    distortion: Array
    R: Array
    T: Array
    unit: str

    def project(self, points: Array) -> Array:
        """Project points (..., 3) in the frame of the first camera to the image, (..., 2) px."""
        camera = camera_of(self.matrix, self.distortion, self.R, self.T)
        flat = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
        return projected(self.lens, flat, camera)[0].reshape(*points.shape[:-1], 2)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CamerasCalibration:
    """Cameras, calibrated on views of a flat board.

    cameras: by name, the first at the origin. error: root mean square reprojection error with
    one board pose a view, px. view_errors: by camera (V,), NaN where a camera does not see it.
    places, residuals: by camera, for each view (R, C, 2) the measured corners, and measured minus
        projected ones, px, NaN where missing; None if the camera does not see the board.
    coverage: by camera, share of the image's 8 x 8 cells that hold a corner.
    focal_sigma: by camera, the larger standard deviation of the two focal lengths, px.
    """

    cameras: Mapping[str, Camera]
    error: float
    view_errors: Mapping[str, Array]
    places: Mapping[str, Sequence[Array | None]]
    residuals: Mapping[str, Sequence[Array | None]]
    coverage: Mapping[str, float]
    focal_sigma: Mapping[str, float]

    def rig(self) -> StereoRig:
        """Return the rig of two cameras; raises CalibrationError for fisheyes or another number."""
        cameras = list(self.cameras.values())
        if len(cameras) != 2 or Lens.FISHEYE in {camera.lens for camera in cameras}:
            raise CalibrationError("a rig has two cameras, neither of them a fisheye")
        one, two = cameras
        return StereoRig(
            one.matrix, one.distortion, two.matrix, two.distortion, two.R, two.T, unit=two.unit
        )


def calibrate_cameras(
    views: Mapping[str, Sequence[Grid | None]],
    *,
    spacing: float,
    sizes: Mapping[str, tuple[int, int]],
    lens: Lens = Lens.PINHOLE,
    unit: str = "mm",
) -> CamerasCalibration:
    """Calibrate cameras on views of one flat board, which all cameras number alike at each moment.

    views: by camera, the grid at every moment, None if the camera does not see the board.
    spacing: side of a square, in `unit`. sizes: (width, height) of each camera's images, px. lens:
        the lens model of all cameras.

    Each camera is calibrated alone. Its pose relative to an earlier camera comes from the moments
    that both see; the pairs with the most common moments come first. Then all poses of cameras and
    boards are fitted together, with the lenses fixed.

    Raises CalibrationError if a camera has too few views or nodes, if its views do not
    determine the focal length, if it shares no moment with the others, or if no pose between the
    cameras fits all views.
    """
    check_positive("spacing", spacing, CalibrationError)
    check_kind("views", views, Mapping, CalibrationError)
    check_kind("sizes", sizes, Mapping, CalibrationError)
    check_kind("lens", lens, Lens, CalibrationError)
    check_kind("unit", unit, str, CalibrationError)
    views = {name: _grids(name, grids) for name, grids in views.items()}
    if not views:
        raise CalibrationError("no camera is given")
    moments = {len(grids) for grids in views.values()}
    if len(moments) != 1:
        counts = ", ".join(f"{name} {len(grids)}" for name, grids in views.items())
        raise CalibrationError(f"every camera needs an entry for each moment, here {counts}")
    names = list(views)
    missing = [name for name in names if name not in sizes]
    if missing:
        raise CalibrationError(f"sizes must have an entry for each camera: no {missing[0]!r}")
    sizes = {name: as_size(f"sizes[{name!r}]", sizes[name], CalibrationError) for name in names}
    board = board_of([grid for grids in views.values() for grid in grids], spacing)
    looks = {name: _looks(views[name], board, number) for number, name in enumerate(names)}
    found = {name: _one(name, looks[name], board, sizes[name], lens) for name in names}
    free = unknowns(lens, len(names))
    free[:, :-POSE] = False
    every = [look for name in names for look in looks[name]]
    adjusted = adjust_together(lens, every, found, board, free)
    errors = {name: np.full(len(grids), np.nan) for name, grids in views.items()}
    places: dict[str, list[Array | None]] = {name: [None] * len(errors[name]) for name in names}
    residuals: dict[str, list[Array | None]] = {name: [None] * len(errors[name]) for name in names}
    for look, off in zip(every, adjusted.residuals, strict=True):
        name, moment = names[look.camera], look.moment
        grid = cast(Grid, views[name][moment])
        errors[name][moment] = root_mean_square(off)
        places[name][moment] = grid.xy.astype(np.float64)
        residuals[name][moment] = spread(grid.valid, off)
    return CamerasCalibration(
        cameras={
            name: Camera(
                lens=lens,
                size=sizes[name],
                matrix=matrix_of(camera),
                distortion=distortion_of(camera),
                R=rotation_of(camera),
                T=camera[-3:],
                unit=unit,
            )
            for name, camera in zip(names, adjusted.state.cameras, strict=True)
        },
        error=root_mean_square(*adjusted.residuals),
        view_errors=errors,
        places=places,
        residuals=residuals,
        coverage={name: _coverage(looks[name], sizes[name]) for name in names},
        focal_sigma={name: found[name].focal_sigma for name in names},
    )


def _grids(name: str, values: Sequence[Grid | None]) -> list[Grid | None]:
    """Return the grids of a camera; raises CalibrationError if one is neither a grid nor None."""
    check_kind("each name of views", name, str, CalibrationError)
    grids = listed(f"views[{name!r}]", values, object, CalibrationError)
    listed(f"views[{name!r}]", [g for g in grids if g is not None], Grid, CalibrationError)
    return grids


def _looks(grids: Sequence[Grid | None], board: Array, camera: int) -> list[Look]:
    """Return what a camera sees of the board where it sees enough; all nodes weigh alike."""
    looks = [
        look_at(board, grid, grid.valid, camera, moment)
        for moment, grid in enumerate(grids)
        if grid is not None and np.count_nonzero(grid.valid) >= MIN_NODES
    ]
    return [dataclasses.replace(look, sigma=np.full(len(look.nodes), np.nan)) for look in looks]


def _one(
    name: str, looks: Sequence[Look], board: Array, size: tuple[int, int], lens: Lens
) -> Alone:
    """Calibrate one camera alone; errors name it."""
    if len(looks) < MIN_VIEWS:
        raise CalibrationError(
            f"{name}: {MIN_VIEWS} views with at least {MIN_NODES} corners are needed, not "
            f"{len(looks)}"
        )
    try:
        return calibrate_alone(lens, looks, board, size)
    except cv2.error as failure:
        raise CalibrationError(f"{name}: the views do not determine the camera") from failure
    except CalibrationError as error:
        raise CalibrationError(f"{name}: {error}") from error


def _coverage(looks: Sequence[Look], size: tuple[int, int]) -> float:
    """Return the share of the cells of an image that hold a corner."""
    xy = np.concatenate([look.xy for look in looks])
    cells = np.floor((xy + 0.5) / np.array(size) * _COVERAGE).astype(int)
    filled = np.zeros((_COVERAGE, _COVERAGE), bool)
    filled[tuple(np.clip(cells.T[::-1], 0, _COVERAGE - 1))] = True
    return float(filled.mean())
