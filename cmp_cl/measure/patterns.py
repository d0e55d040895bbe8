"""Patterns of unknown cell size in a view, boards for calibration, two views of one pattern."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import DetectorConfig
from cmp_cl.detector import Detector
from cmp_cl.errors import GridError, check_shape
from cmp_cl.grid import Grid, NodeStatus, align
from cmp_cl.grid.align import row_direction
from cmp_cl.image import AnyImage, check_image
from cmp_cl.motion import filter_positions
from cmp_cl.opencl.device import Device
from cmp_cl.points import sides

_MAX_SIGMA = 0.2  # px; less certain corners of a board are not used
_MOST_ROTATED = np.pi / 3  # rad between the rows of one pattern in two views


def find_pattern(
    view: AnyImage,
    *,
    shape: tuple[int, int] | None = None,
    full_scale: int | None = None,
    device: Device | str | None = None,
) -> tuple[float, Grid]:
    """Find a pattern of unknown cell size; return the side of its cells, px, and its grid.

    view, shape, full_scale, device: as in `Settings`. The corners are those of
        `DetectorConfig()`.

    Raises GridError if there is no pattern or the pattern seems to have another number of corners,
    and the errors of `Detector`.
    """
    view = check_image(view)
    if shape is not None:
        check_shape(shape, GridError)
    config = DetectorConfig(full_scale=full_scale)
    why = "no closed cell is seen"
    with Detector(shape=view.shape, dtype=view.dtype, config=config, device=device) as detector:
        try:
            _, grid = detector.grid(view, shape=shape)
            lengths = sides(grid.xy)
            cell = float(np.median(lengths)) if len(lengths) else np.nan
        except GridError as error:
            why, cell = str(error), np.nan
        advice = "" if cell >= 4 else detector(view).advice(view, full_scale)
    if not cell >= 4:
        size = "" if shape is None else f" of {' x '.join(map(str, shape))} corners"
        raise GridError(f"no pattern{size} is found: {why}{advice and '; '}{advice}")
    check_board(grid)
    return cell, grid


def find_board(
    view: AnyImage,
    shape: tuple[int, int],
    *,
    full_scale: int | None = None,
    device: Device | str | None = None,
) -> Grid:
    """Find a rigid board in a view; return its grid, which `cmp_cl.calibrate` takes.

    view: (H, W) uint8 or uint16. shape: (rows, columns) of the board's inner corners. full_scale,
        device: as in `Settings`.

    The corners are those of `DetectorConfig()`. The grid has the nodes that a calibration may use,
    at their filtered positions: those that were detected, with a sigma of at most 0.2 px.

    Raises GridError if the view does not show corners of all four sides of the board, or none that
    is sure enough.
    """
    check_shape(shape, GridError)
    _, grid = find_pattern(view, shape=shape, full_scale=full_scale, device=device)
    seen = grid.status == NodeStatus.DETECTED
    if not (seen[[0, -1]].any(axis=1).all() and seen[:, [0, -1]].any(axis=0).all()):
        raise GridError(
            f"it shows {seen.sum()} of {seen.size} corners, and not those of every side"
        )
    good = seen & (grid.image_sigma <= _MAX_SIGMA)
    if not good.any():
        raise GridError(
            f"no corner has a sigma of at most {_MAX_SIGMA} px: the image is noisy or blurred"
        )
    kept = dataclasses.replace(
        grid,
        xy=np.where(good[..., None], grid.xy, np.float32(np.nan)),
        status=np.where(good, grid.status, NodeStatus.MISSING).astype(np.uint8),
        image_sigma=np.where(good, grid.image_sigma, np.float32(np.nan)),
    )
    return filter_positions(kept, device=device)


def check_board(grid: Grid) -> None:
    """Raise GridError if no board is seen, or it seems to have another number of corners."""
    if grid.seen_shape is not None or not grid.valid.any():
        raise GridError("; ".join(grid.doubts))


def align_views(left: Grid, right: Grid, rotation: NDArray[np.float64]) -> Grid:
    """Return the right grid with the numbers of the left one, see `cmp_cl.grid.align`.

    rotation: (3, 3), of the rig, from the left camera to the right one, which may be rolled. It
        turns the rows of the left view; if those of the right view differ by more than 60 degrees,
        one of the views is numbered wrongly.

    Raises GridError if shapes, colours or the directions of the rows do not agree.
    """
    along = row_direction(left)
    ahead = complex(*(rotation[:2, :2] @ [along.real, along.imag]))
    aligned = align([left, right], ahead=ahead)[1]
    if not abs(np.angle(row_direction(aligned) / ahead)) <= _MOST_ROTATED:
        raise GridError(
            "the two views cannot be numbered alike: by their checker colours the directions of "
            "their rows do not agree"
        )
    return aligned
