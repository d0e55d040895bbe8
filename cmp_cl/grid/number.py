"""The numbers of corners that any detector found."""

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import GridError, ImageError
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import Frame, GreyImage, as_frame
from cmp_cl.lattice.arrays import LOOKED, Board
from cmp_cl.lattice.boards import boards
from cmp_cl.lattice.plan import lattice_plan
from cmp_cl.opencl.device import Device, select_device

LEAST = 4  # corners of the smallest lattice, one cell
COMPARABLE = 0.5  # share of the first board's corners from which a second may be the one meant
NARROW = (
    6  # px: side of bins; cells are narrow where another corner is in the 3 x 3 around one's own
)
WIDE_RING, NARROW_RING = (3, 5, 4), (1, 3, 2)  # smoothings; ring, px along the axes and diagonals


def number(xy: ArrayLike, image: Frame, *, device: Device | str | None = None) -> Grid:
    """Number the corners of a checkerboard that any detector found, from OpenCV to a hand.

    xy: (N, 2), px, x right and y down, (0, 0) the centre of the top-left pixel. In any order; there
        may be others among them, and some may be missing.
    image: (H, W) in which they lie.
    device: as for `Detector`.

    Returns the grid of the largest board. Row 0 is at the top and column 0 on the left. Corners
    keep the given positions (DETECTED). Where one is missing that the image seems to show, the node
    has the position that its neighbours predict (INTERPOLATED). `index` has a row for each given
    corner. `sigma` is unknown, and `border` is not looked for.

    Raises GridError if xy is not (N, 2), not finite or outside the image, if there are fewer than
    four corners, or no board of nine; ImageError; DeviceError.
    """
    frame = as_frame(image)
    at = _checked(xy, frame)
    count = len(at)
    plan = lattice_plan(
        select_device(device), frame.shape, frame.dtype, int(np.iinfo(frame.dtype).max), count
    )
    with plan.lock:
        plan.take(frame, at, _edges(frame, at), np.zeros(count, np.uint8))
        plan.start()
        found = boards(plan, at)
        first, second = next(found, None), next(found, None)
    if first is None:
        raise GridError(
            f"the {count} corners form no board: too few of them are linked by the sides of cells; "
            "check that they lie in this image, as (x, y), and that its cells are 4 px or wider"
        )
    return _grid(first, second, count)


def _checked(xy: ArrayLike, image: GreyImage) -> NDArray[np.float32]:
    try:
        at = np.asarray(xy, np.float64)
    except (TypeError, ValueError) as error:
        raise GridError(f"xy must be (N, 2) numbers, px, not {type(xy).__name__}") from error
    if at.ndim != 2 or at.shape[1] != 2:
        raise GridError(
            f"xy must be (N, 2), px, got {at.shape}; OpenCV's corners need reshape(-1, 2)"
        )
    if not np.isfinite(at).all():
        raise GridError("xy has positions that are not finite; leave these corners out")
    if not image.size:
        raise ImageError(f"the image has no pixels: {image.shape}")
    if len(at) < LEAST:
        raise GridError(f"{len(at)} corners form no lattice, expected {LEAST} or more")
    rows, columns = image.shape
    outside = ((at < -0.5) | (at > [columns - 0.5, rows - 0.5])).any(axis=1)
    if outside.any():
        raise GridError(
            f"{np.count_nonzero(outside)} of {len(at)} corners lie outside the image of "
            f"{columns} x {rows} px; give (x, y), not (row, column), and their own image"
        )
    return at.astype(np.float32)


def _edges(image: GreyImage, xy: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the angles of the four boundaries at each corner, (N, 4) as `Corners.edges`.

    They lie half way between the bright and the dark axis, the second harmonic of eight grey levels
    on a ring.
    """
    last = np.array(image.shape[::-1]) - 1
    column, row = np.clip(np.rint(xy), 0, last).astype(np.int64).T
    bins = np.zeros(np.array(image.shape) // NARROW + 1, np.float32)
    np.add.at(bins, (row // NARROW, column // NARROW), 1)
    around = cv2.boxFilter(bins, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    narrow = around[row // NARROW, column // NARROW] > 1
    levels: NDArray[np.float32] = image.astype(np.float32)
    kernel = np.array([1, 2, 1], np.float32) / 4
    angle = np.zeros(len(xy))
    for some, (smoothings, a, d) in ((~narrow, WIDE_RING), (narrow, NARROW_RING)):
        smooth = levels
        for _ in range(smoothings):
            smooth = np.asarray(
                cv2.sepFilter2D(smooth, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE),
                np.float32,
            )
        padded = np.pad(smooth, a, mode="edge")
        x, y = column[some] + a, row[some] + a
        s = [padded[y + v, x + u] for u, v in ((0, -a), (d, -d), (a, 0), (d, d))]
        t = [padded[y - v, x - u] for u, v in ((0, -a), (d, -d), (a, 0), (d, d))]
        upright, rising, level, falling = (one + other for one, other in zip(s, t, strict=True))
        angle[some] = np.arctan2(rising - falling, upright - level) / 2
    edges = angle[:, None] - np.pi / 4 + np.arange(4) * (np.pi / 2)
    return ((edges + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)


def _grid(board: Board, second: Board | None, count: int) -> Grid:
    row, column = np.nonzero(board.owner >= 0)
    index = np.full((count, 2), -1, np.int32)
    index[board.owner[row, column]] = np.stack([row, column], axis=1)
    status = np.where(board.owner >= 0, NodeStatus.DETECTED, NodeStatus.MISSING).astype(np.uint8)
    status[board.owner == LOOKED] = NodeStatus.INTERPOLATED
    own = 0 if second is None else int(np.count_nonzero(second.owner >= 0))
    grid = Grid(
        xy=np.stack([board.x, board.y], axis=2),
        status=status,
        sigma=np.full(status.shape, np.nan, np.float32),
        index=index,
        parity=0 if board.sign > 0 else 1,
        others=own if own > COMPARABLE * len(row) else 0,
    )
    steps = [np.nanmean(np.diff(_across(grid, q), axis=1)[..., 0]) for q in range(4)]
    return grid.turned(int(np.nanargmax(steps)))


def _across(grid: Grid, quarters: int) -> NDArray[np.float32]:
    across: NDArray[np.float32] = np.rot90(grid.xy, quarters)
    return across
