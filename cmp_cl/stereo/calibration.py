"""Calibrates one camera, or a rig of two, on views of a flat board."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from numbers import Integral
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import CalibrationError, FieldError, check_positive, listed
from cmp_cl.grid.grid import Grid
from cmp_cl.stereo.adjustment import CAMERA, OF_CAMERA, POSE, Adjusted, View, adjust, matrix_of
from cmp_cl.stereo.free_board import adjust_board
from cmp_cl.stereo.points import sides
from cmp_cl.stereo.rig import StereoRig
from cmp_cl.stereo.threads import one_thread

MIN_VIEWS = 3
MIN_NODES = 8  # fewest nodes of a board in a view
# Share of the focal length; a larger sigma means that the views do not determine it.
MAX_FOCAL_SIGMA = 0.05
_MAX_MISFIT = 1.0  # px: the joint reprojection error may reach this, or
_MAX_MISFIT_RATIO = 3.0  # times the larger error of a camera alone
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
    image_size = _checked_size(image_size)
    grids = listed("grids", grids, Grid, CalibrationError)
    grids = _numbered_alike(grids) if free_board else grids
    parts = [_board(grid.xy, grid.valid, spacing, view) for view, grid in enumerate(grids)]
    _check_views(len(parts))
    try:
        with one_thread():
            error, matrix, distortion, rotations, translations, _, _, _ = (
                cv2.calibrateCameraExtended(
                    [board for board, _ in parts],
                    [points for _, points in parts],
                    image_size,
                    np.eye(3),
                    np.zeros(5),
                    flags=cv2.CALIB_FIX_K3,
                )
            )
    except cv2.error as failure:
        raise CalibrationError(f"the views do not determine a camera: {failure}") from failure
    slopes = (
        cv2.projectPoints(board, rotation, translation, matrix, distortion)[1]
        for (board, _), rotation, translation in zip(parts, rotations, translations, strict=True)
    )
    sigma = focal_sigma(((each[:, :POSE], each[:, OF_CAMERA]) for each in slopes), float(error))
    if not sigma < MAX_FOCAL_SIGMA * matrix[0, 0]:
        raise CalibrationError(
            f"the views leave the focal length uncertain by {sigma / matrix[0, 0]:.0%}: "
            "show the board tilted, in different directions"
        )
    views = [
        _view(board, rotation, translation, grid)
        for (board, _), rotation, translation, grid in zip(
            parts, rotations, translations, grids, strict=True
        )
    ]
    start = _parameters_of(matrix, distortion)
    shape = None
    if free_board:
        adjusted, shape = _with_board(views, [grid.valid for grid in grids], start, spacing)
        sigma = float(np.sqrt(np.diag(adjusted.covariance)[:2].max()))
    else:
        adjusted = adjust(views, start)
    return CameraCalibration(
        matrix=matrix_of(adjusted.parameters),
        distortion=_distortion_of(adjusted.parameters),
        focal_sigma=sigma,
        error=_whole_error(adjusted, views),
        view_errors=adjusted.errors[:, 0],
        board=shape,
    )


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
    for view, (left, right) in enumerate(views):
        if left.shape != right.shape:
            raise FieldError(
                f"view {view}: the grids have different shapes: {left.shape} and {right.shape}"
            )
    if free_board:
        both = _numbered_alike([grid for pair in views for grid in pair])
        views = list(zip(both[::2], both[1::2], strict=True))
    one = calibrate_camera([left for left, _ in views], spacing=spacing, image_size=image_size)
    two = calibrate_camera([right for _, right in views], spacing=spacing, image_size=image_size)
    pairs = [
        (
            _board(left.xy, left.valid & right.valid, spacing, view),
            _board(right.xy, left.valid & right.valid, spacing, view),
        )
        for view, (left, right) in enumerate(views)
    ]
    try:
        with one_thread():
            error, K1, D1, K2, D2, R, T, _, _, rotations, translations, _ = (
                cv2.stereoCalibrateExtended(
                    [left[0] for left, _ in pairs],
                    [left[1] for left, _ in pairs],
                    [right[1] for _, right in pairs],
                    one.matrix.copy(),
                    one.distortion.copy(),
                    two.matrix.copy(),
                    two.distortion.copy(),
                    image_size,
                    np.eye(3),
                    np.zeros(3),
                    flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3,
                )
            )
    except cv2.error as failure:
        raise CalibrationError(f"the views do not determine a rig: {failure}") from failure
    alone = max(one.error, two.error)
    if not error <= max(_MAX_MISFIT, _MAX_MISFIT_RATIO * alone):
        raise CalibrationError(
            f"no pose between the cameras fits the views: both together miss by {error:.1f} px, "
            f"each alone by {alone:.2f} px; check the shape of the board, and that left and "
            "right views are pairs"
        )
    whole = [
        _view(left[0], rotation, translation, *grids, both=grids[0].valid & grids[1].valid)
        for (left, _), rotation, translation, grids in zip(
            pairs, rotations, translations, views, strict=True
        )
    ]
    pose = np.concatenate([cv2.Rodrigues(R)[0].reshape(-1), _double(T).reshape(-1)])
    start = np.concatenate([_parameters_of(K1, D1), _parameters_of(K2, D2), pose])
    shape = None
    if free_board:
        seen = [left.valid & right.valid for left, right in views]
        adjusted, shape = _with_board(whole, seen, start, spacing)
    else:
        adjusted = adjust(whole, start)
    cameras = [adjusted.parameters[k : k + CAMERA] for k in (0, CAMERA)]
    rotation, translation = np.split(adjusted.parameters[2 * CAMERA :], 2)
    return StereoCalibration(
        rig=StereoRig(
            matrix_of(cameras[0]),
            _distortion_of(cameras[0]),
            matrix_of(cameras[1]),
            _distortion_of(cameras[1]),
            _double(cv2.Rodrigues(rotation)[0]),
            translation,
            unit,
            adjusted.covariance,
        ),
        error=_whole_error(adjusted, whole),
        view_errors=adjusted.errors,
        left=one,
        right=two,
        board=shape,
    )


def _numbered_alike(grids: Sequence[Grid]) -> list[Grid]:
    """Return the grids of a free board with equal indices for the same node.

    If a half turn exchanges black and white, the colours show which way up the board is. Raises
    CalibrationError if the grids have different rows or columns.
    """
    for view, grid in enumerate(grids):
        if grid.shape != grids[0].shape:
            raise CalibrationError(
                "the views of a free board must be numbered alike: the first grid has "
                f"{grids[0].extent}, number {view} has {grid.extent}"
            )
    return [
        grid.turned(2) if sum(grid.shape) % 2 and grid.parity != grids[0].parity else grid
        for grid in grids
    ]


def _with_board(
    views: Sequence[View], seen: Sequence[NDArray[np.bool_]], start: Array, spacing: float
) -> tuple[Adjusted, Array]:
    """Adjust with a free board; return its nodes too, (R, C, 3), NaN where no view shows one.

    The views do not show how large a board is: the mean of its sides is `spacing`.
    """
    flat = on_board(np.ones_like(seen[0]), spacing)
    nodes = [np.flatnonzero(each) for each in seen]
    adjusted, found = adjust_board(views, nodes, start, flat, spacing)
    shown = np.any(seen, axis=0)
    shape = np.where(shown[..., None], found.reshape(*shown.shape, 3), np.nan)
    lengths = np.concatenate([each.ravel() for each in sides(shape)])
    if not np.isfinite(lengths).any():
        return adjusted, shape
    scale = spacing / float(np.nanmean(lengths))
    centre = np.nanmean(shape, axis=(0, 1))
    return _scaled(adjusted, scale), centre + (shape - centre) * scale


def _scaled(adjusted: Adjusted, scale: float) -> Adjusted:
    """Return the cameras with the distance between them multiplied by a factor."""
    factors = np.ones(len(adjusted.parameters))
    factors[2 * CAMERA + 3 :] = scale
    return dataclasses.replace(
        adjusted,
        parameters=adjusted.parameters * factors,
        covariance=adjusted.covariance * np.outer(factors, factors),
    )


def _view(
    board: NDArray[np.float32],
    rotation: ArrayLike,
    translation: ArrayLike,
    *grids: Grid,
    both: NDArray[np.bool_] | None = None,
) -> View:
    """Return a view of a board in one or two cameras, at the nodes of the mask `both` or at all."""
    chosen = [grid.valid if both is None else both for grid in grids]
    return View(
        board=board,
        seen=tuple(g.xy[v].astype(np.float64) for g, v in zip(grids, chosen, strict=True)),
        sigma=tuple(g.sigma[v].astype(np.float64) for g, v in zip(grids, chosen, strict=True)),
        pose=np.concatenate([_double(rotation).reshape(-1), _double(translation).reshape(-1)]),
    )


def _parameters_of(matrix: ArrayLike, distortion: ArrayLike) -> Array:
    """Return the parameters fx fy cx cy k1 k2 p1 p2."""
    k = _double(matrix)
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *_double(distortion).reshape(-1)[:4]])


def _distortion_of(parameters: Array) -> Array:
    return np.append(parameters[4:CAMERA], 0.0)


def _whole_error(adjusted: Adjusted, views: Sequence[View]) -> float:
    """Return the root mean square reprojection error over all views and cameras, px."""
    counts = np.array([len(view.board) for view in views], np.float64)[:, None]
    mean = (np.square(adjusted.errors) * counts).sum() / (counts.sum() * adjusted.errors.shape[1])
    return float(math.sqrt(mean))


def focal_sigma(slopes: Iterable[tuple[NDArray[Any], NDArray[Any]]], error: float) -> float:
    """Return the larger standard deviation of fx and fy, px; infinite where undetermined.

    OpenCV's own estimate drops small singular values: it is 0 where every view faces the camera.
    slopes: for each view the derivatives of its projection by the pose and by the camera, whose
    first two parameters are fx and fy. error: RMS reprojection error, px.
    """
    free = []
    for by_pose, by_camera in slopes:
        basis = np.linalg.qr(by_pose)[0]
        free.append(by_camera - basis @ (basis.T @ by_camera))
    stacked = np.concatenate(free)
    scale = np.linalg.norm(stacked, axis=0)
    if not (scale > 0).all():
        return math.inf
    _, singular, axes = np.linalg.svd(stacked / scale, full_matrices=False)
    if not singular[-1] > 0:
        return math.inf
    deviation = np.linalg.norm(axes[:, :2] / singular[:, None], axis=0) / scale[:2]
    return float(deviation.max() * error / math.sqrt(2))


def _double(value: ArrayLike) -> Array:
    return np.asarray(value, np.float64)


def _pair(views: Sequence[Grid]) -> tuple[Grid, Grid]:
    """Return the grids of the left and of the right view; raises CalibrationError if not both."""
    found = listed("views", views, Grid, CalibrationError)
    if len(found) != 2:
        raise CalibrationError(f"each of views must be (left, right), not {len(found)} grids")
    return found[0], found[1]


def _checked_size(size: Any) -> tuple[int, int]:
    sides = listed("image_size", size, Integral, CalibrationError)
    if len(sides) != 2 or min(sides) < 1:
        raise CalibrationError(f"image_size must be (width, height), px, not {size!r}")
    return int(sides[0]), int(sides[1])


def _check_views(count: int) -> None:
    if count < MIN_VIEWS:
        noun = "view" if count == 1 else "views"
        raise CalibrationError(f"{count} {noun} of the board, at least {MIN_VIEWS} are needed")


def _board(
    xy: NDArray[np.float32], valid: NDArray[np.bool_], spacing: float, view: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the nodes of a view on the board (N, 3), in the unit of spacing, and in px (N, 2)."""
    row, column = np.nonzero(valid)
    if len(row) < MIN_NODES or len(set(row)) < 2 or len(set(column)) < 2:
        raise CalibrationError(
            f"view {view} shows {len(row)} nodes, at least {MIN_NODES} in two rows and two "
            "columns are needed"
        )
    return on_board(valid, spacing).astype(np.float32), np.ascontiguousarray(xy[valid], np.float32)


def on_board(nodes: NDArray[np.bool_], spacing: float) -> Array:
    """Return the positions of the nodes (R, C) on a flat board, (N, 3), in the unit of spacing."""
    row, column = np.nonzero(nodes)
    flat = np.column_stack([column, row, np.zeros(len(row))])
    return flat.astype(np.float64) * spacing
