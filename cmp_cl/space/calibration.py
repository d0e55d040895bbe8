"""Calibrates one camera, or a rig of two, on views of a flat board."""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, FieldError, as_size, check_positive, listed
from cmp_cl.grid.grid import Grid
from cmp_cl.space.adjustment import Adjusted, Look, adjust, root_mean_square
from cmp_cl.space.free_board import adjust_board, numbered_alike
from cmp_cl.space.joint import adjust_together
from cmp_cl.space.lens import Lens, distortion_of, matrix_of, rotation_of
from cmp_cl.space.rig import StereoRig
from cmp_cl.space.start import (
    MIN_NODES,
    MIN_VIEWS,
    Alone,
    board_of,
    calibrate_alone,
    joined,
    look_at,
    unknowns,
)

_LENS = Lens.PINHOLE
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CameraCalibration:
    """One camera, calibrated on views of a flat board.

    matrix: (3, 3), px.
    distortion: (5,), k1 k2 p1 p2 k3, with k3 = 0: a few views do not determine it.
    focal_sigma: standard deviation of the focal length, px.
    error: root mean square reprojection error, px.
    view_errors: (V,), the same for each view.
    board: (R, C, 3), the nodes of a free board, in the unit of spacing, z towards the back of the
        board, NaN where no view shows the node; None if the board was taken to be flat.
    """

    matrix: Array
    distortion: Array
    focal_sigma: float
    error: float
    view_errors: Array
    board: Array | None = None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class StereoCalibration:
    """Two cameras, calibrated on views of a flat board.

    rig: the two cameras.
    error: root mean square reprojection error of both cameras, px.
    view_errors: (V, 2), the same for each view, left and right.
    left, right: each camera, calibrated alone on a board that is taken to be flat.
    board: see `CameraCalibration`.
    """

    rig: StereoRig
    error: float
    view_errors: Array
    left: CameraCalibration
    right: CameraCalibration
    board: Array | None = None


def calibrate_camera(
    grids: Sequence[Grid],
    *,
    spacing: float,
    image_size: tuple[int, int],
    free_board: bool = False,
) -> CameraCalibration:
    """Calibrate a camera on at least three views of a flat board.

    A view may show part of the board, and the views may be numbered differently. Each node has
    the weight 1 / (sigma^2 + t^2). t^2 is the variance that the residuals have beyond the sigmas of
    the nodes. On an inexact board it is the larger part, and all nodes weigh nearly alike.

    grids: one a view. spacing: side of a square, in any unit. image_size: (width, height), px.
    free_board: whether the board may be bent or inexact. Its nodes are then found too; its overall
        size is that of the flat board. This needs at least four views, in which equal indices are
        the same node. If its rows and columns add up to an odd number, the colours of the cells
        show how to rotate each view to get this.

    Raises CalibrationError if there are too few views or nodes, if the views do not
    determine the focal length (the board faces the camera in all of them), or if the views of a
    free board are numbered differently.
    """
    check_positive("spacing", spacing, CalibrationError)
    grids = listed("grids", grids, Grid, CalibrationError)
    return _one(
        grids, spacing, as_size("image_size", image_size, CalibrationError), free_board=free_board
    )[0]


def calibrate(
    views: Sequence[tuple[Grid, Grid]],
    *,
    spacing: float,
    image_size: tuple[int, int],
    unit: str = "mm",
    free_board: bool = False,
) -> StereoCalibration:
    """Calibrate a rig on at least three views (left, right) of a flat board.

    The two grids of a view have the same numbering. First each camera is calibrated alone, then
    the pose between them, and last all parameters together.
    spacing: side of a square, in `unit`. image_size: (width, height) of each view, px.
    free_board: see `calibrate_camera`.

    Raises CalibrationError as `calibrate_camera` does, and if no pose between the cameras
    fits all views. Raises FieldError if the grids of a view have different shapes.
    """
    views = [_pair(pair) for pair in listed("views", views, Sequence, CalibrationError)]
    for view, (one, other) in enumerate(views):
        if one.shape != other.shape:
            raise FieldError(
                f"view {view}: the grids have different shapes: {one.shape} and {other.shape}"
            )
    if free_board:
        grids = numbered_alike([grid for pair in views for grid in pair])
        views = list(zip(grids[::2], grids[1::2], strict=True))
    check_positive("spacing", spacing, CalibrationError)
    size = as_size("image_size", image_size, CalibrationError)
    left, left_start = _one([one for one, _ in views], spacing, size)
    right, right_start = _one([other for _, other in views], spacing, size)
    board = board_of([grid for pair in views for grid in pair], spacing)
    looks = [
        _look(board, grid, one.valid & other.valid, camera, view)
        for view, (one, other) in enumerate(views)
        for camera, grid in enumerate((one, other))
    ]
    free = unknowns(_LENS, 2)
    found = {"left": left_start, "right": right_start}
    adjusted, shape = adjust_together(_LENS, looks, found, board, free), None
    if free_board:
        adjusted, shape = adjust_board(_LENS, looks, adjusted.state, free, board.shape[:2], spacing)
    first, second = adjusted.state.cameras
    return StereoCalibration(
        rig=StereoRig(
            matrix_of(first),
            distortion_of(first),
            matrix_of(second),
            distortion_of(second),
            rotation_of(second),
            second[-3:],
            unit,
            adjusted.covariance,
        ),
        error=root_mean_square(*adjusted.residuals),
        view_errors=_errors(adjusted).reshape(-1, 2),
        left=left,
        right=right,
        board=shape,
    )


def _one(
    grids: Sequence[Grid], spacing: float, size: tuple[int, int], *, free_board: bool = False
) -> tuple[CameraCalibration, Alone]:
    """Calibrate one camera; return it, and what a calibration of several starts from."""
    grids = numbered_alike(grids) if free_board else grids
    board = board_of(grids, spacing)
    looks = [_look(board, grid, grid.valid, 0, view) for view, grid in enumerate(grids)]
    if len(looks) < MIN_VIEWS:
        noun = "view" if len(looks) == 1 else "views"
        raise CalibrationError(f"{len(looks)} {noun} of the board, at least {MIN_VIEWS} are needed")
    try:
        start = calibrate_alone(_LENS, looks, board, size)
    except cv2.error as failure:
        raise CalibrationError(f"the views do not determine a camera: {failure}") from failure
    free, sigma = unknowns(_LENS, 1), start.focal_sigma
    adjusted, shape = adjust(_LENS, looks, joined({"": start}, board), free), None
    if free_board:
        adjusted, shape = adjust_board(_LENS, looks, adjusted.state, free, board.shape[:2], spacing)
        sigma = float(np.sqrt(np.diag(adjusted.covariance)[:2].max()))
    camera = adjusted.state.cameras[0]
    found = CameraCalibration(
        matrix=matrix_of(camera),
        distortion=distortion_of(camera),
        focal_sigma=sigma,
        error=root_mean_square(*adjusted.residuals),
        view_errors=_errors(adjusted),
        board=shape,
    )
    return found, Alone(camera, dict(enumerate(adjusted.state.poses)), sigma, found.error)


def _errors(adjusted: Adjusted) -> Array:
    """Return the RMS reprojection error of each look, px."""
    return np.array([root_mean_square(off) for off in adjusted.residuals])


def _pair(views: Sequence[Grid]) -> tuple[Grid, Grid]:
    """Return the grids of the left and of the right view; raises CalibrationError if not both."""
    found = listed("views", views, Grid, CalibrationError)
    if len(found) != 2:
        raise CalibrationError(f"each of views must be (left, right), not {len(found)} grids")
    return found[0], found[1]


def _look(board: Array, grid: Grid, valid: NDArray[np.bool_], camera: int, view: int) -> Look:
    """Return what a camera sees of a board; raises CalibrationError if it is too little."""
    row, column = np.nonzero(valid)
    if len(row) < MIN_NODES or len(set(row)) < 2 or len(set(column)) < 2:
        raise CalibrationError(
            f"view {view} shows {len(row)} nodes, at least {MIN_NODES} in two rows and two "
            "columns are needed"
        )
    return look_at(board, grid, valid, camera, view)
