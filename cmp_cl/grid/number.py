"""The numbers of corners that any detector found."""

import dataclasses

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.errors import GridError, as_numbers
from cmp_cl.grid.build import build_grid
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import AnyImage, GreyImage, check_image
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.opencl.device import Device, select_device

LEAST = LatticeConstants.least_board
SMOOTHINGS, AXIS, DIAGONAL = 2, 4, 3  # px, the ring of levels around a corner


def number(
    xy: ArrayLike,
    image: AnyImage,
    shape: tuple[int, int] | None = None,
    like: Grid | None = None,
    *,
    device: Device | str | None = None,
) -> Grid:
    """Number the corners of a checkerboard that any detector found, from OpenCV to a hand.

    xy: (N, 2), px, x right and y down, (0, 0) the centre of the top-left pixel. In any order; there
        may be others among them, and some may be missing.
    image: (H, W) in which they lie.
    shape, like: as for `build_grid`, which chooses among several boards, and tells its doubts, in
        the same way.
    device: as for `Detector`.

    Corners keep the given positions (DETECTED). Where one is missing that the image seems to show,
    the node has the position that its neighbours predict (INTERPOLATED). `index` has a row for each
    given corner. `sigma` is unknown.

    Raises GridError if xy is not (N, 2), not finite or outside the image, or shows no board of nine
    corners; the errors of `build_grid` for several boards; ImageError; DeviceError.
    """
    frame = check_image(image)
    at = _checked(xy, frame)
    count, chosen = len(at), select_device(device)
    corners = Corners(
        xy=at,
        pixel=np.clip(np.rint(at), 0, np.array(frame.shape[::-1]) - 1).astype(np.int32),
        octave=np.zeros(count, np.uint8),
        response=np.zeros(count, np.float32),
        method=np.full(count, Method.CENTROID, np.uint8),
        refusal=np.full(count, Refusal.NONE, np.uint8),
        sigma=np.full(count, np.nan, np.float32),
        edges=_edges(frame, at),
        doubtful=np.zeros(count, np.bool_),
        device=str(chosen),
    )
    grid = build_grid(corners, frame, shape, like, device=chosen)
    if not grid.valid.any():
        raise GridError(
            f"the {count} corners form no board: too few of them are linked by the sides of cells; "
            "check that they lie in this image, as (x, y), and that its cells are 4 px or wider"
        )
    nodes = grid.index[:, 0] >= 0
    places = tuple(grid.index[nodes].T)
    xy, status = grid.xy.copy(), grid.status.copy()
    xy[places], status[places] = at[nodes], NodeStatus.DETECTED
    return dataclasses.replace(grid, xy=xy, status=status)


def _checked(xy: ArrayLike, image: AnyImage) -> NDArray[np.float32]:
    at = as_numbers("xy", xy, GridError)
    if at.ndim != 2 or at.shape[1] != 2:
        raise GridError(
            f"xy must be (N, 2), px, got {at.shape}; OpenCV's corners need reshape(-1, 2)"
        )
    if not np.isfinite(at).all():
        raise GridError("xy has positions that are not finite; leave these corners out")
    rows, columns = image.shape
    outside = ((at < -0.5) | (at > [columns - 0.5, rows - 0.5])).any(axis=1)
    if outside.any():
        raise GridError(
            f"{np.count_nonzero(outside)} of {len(at)} corners lie outside the image of "
            f"{columns} x {rows} px; give (x, y), not (row, column), and their own image"
        )
    if len(at) < LEAST:
        raise GridError(f"{len(at)} corners form no board: it has {LEAST} or more")
    return at.astype(np.float32)


def _edges(image: GreyImage, xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the angles of the four boundaries at each corner, (N, 4) as `Corners.edges`.

    They lie half way between the bright and the dark axis, the second harmonic of eight grey levels
    on a ring.
    """
    last = np.array(image.shape[::-1]) - 1
    x, y = np.clip(np.rint(xy), 0, last).astype(np.int64).T + AXIS
    smooth = np.pad(image.astype(np.float32), AXIS, mode="edge")
    kernel = np.array([1, 2, 1], np.float32) / 4
    for _ in range(SMOOTHINGS):
        smooth = np.asarray(
            cv2.sepFilter2D(smooth, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE), np.float32
        )
    ring = ((0, -AXIS), (DIAGONAL, -DIAGONAL), (AXIS, 0), (DIAGONAL, DIAGONAL))
    upright, rising, level, falling = (smooth[y + v, x + u] + smooth[y - v, x - u] for u, v in ring)
    angle = np.arctan2(rising - falling, upright - level) / 2
    edges: NDArray[np.float64] = angle[:, None] - np.pi / 4 + np.arange(4) * (np.pi / 2)
    return ((edges + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)
