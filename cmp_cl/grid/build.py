"""Corners are arranged by row and column here."""

import contextlib
from collections.abc import Iterable, Iterator

import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.errors import GridError, ImageError, check_kind, check_shape
from cmp_cl.grid.choice import Asked, by_size, chosen_of, found_in, reference_of
from cmp_cl.grid.grid import Grid, check_size, empty_grid
from cmp_cl.grid.placing import placed
from cmp_cl.image import AnyImage, GreyImage, check_image
from cmp_cl.lattice.arrays import Board
from cmp_cl.lattice.boards import boards
from cmp_cl.lattice.plan import lattice_plan
from cmp_cl.opencl.device import Device, select_device

BITS = (10, 12, 14, 16)  # of a camera whose pixels have 16
FARTHEST = 1e6  # px, of any corner


def build_grid(
    corners: Corners,
    image: AnyImage,
    shape: tuple[int, int] | None = None,
    like: Grid | None = None,
    *,
    previous: Grid | None = None,
    strict: bool = False,
    device: Device | str | None = None,
) -> Grid:
    """Number the corners of a checkerboard by row and column (section 4.3 of the paper).

    image: the view, (H, W) uint8 or uint16.
    shape: rows and columns of the pattern's inner corners. The grid then has this shape; if the
        pattern lies the other way, its rows run up or down the image. If fewer are seen, borders
        and the edge of the image decide which part it is. If more are seen, see `Grid.seen_shape`.
        Without it, the grid has the rows and columns that are seen.
    like: a grid of the same pattern, usually at rest. The result has its orientation and
        numbers, and at least its rows and columns: nodes beyond a side on which that grid
        shows no border are kept, see `Grid.origin`. Without it row 0 is at the top and column
        0 at the left of the image.
    previous: the grid of the frame before, with the numbers of `like`, or `like` itself for the
        first frame. The pattern as a whole moves by less than half a cell from frame to frame.
    strict: raise GridError if the result has doubts, see `Grid.doubts`.
    device: as for `Detector`; the lattice is found there.

    Nodes without a corner are NaN and MISSING; where the image seems to show one between two others
    of its row or column, the node has the position that its neighbours predict (INTERPOLATED).

    A checkerboard repeats itself, so a frame has many numberings. Each is a hypothesis, to which
    printing errors, borders, the motion from `like` and `previous`, and the known size add their
    nats. `Grid.confidence` is by how many nats the best beats the second; below five the grid is
    ambiguous, and `Grid.rival` is the second. A pattern without a border in view that moved by a
    whole period looks as if it had not moved; a pattern that looks the same after a quarter turn is
    expected to rotate by less than 33 degrees from rest.

    If several boards are seen, the grid is of the one that fills the known size, or fits the print
    and the borders of `like`; else of the largest. If no size is known and that ends nowhere, it is
    the ground behind the largest full rectangle with a border, if there is one. A second board that
    is comparable is an error, a smaller one, or the ground behind one that is not whole, is told by
    `Grid.others`.

    Raises GridError if corners have no finite position or no edge angles, if two comparable
    boards are seen, if the board holds few of the corners, if a shape has millions of nodes, if
    `like` is empty or contradicts `shape`; ImageError for an image that is not one, or not the
    corners' own; DeviceError.
    """
    asked = asked_of(shape, like, previous)
    with _boards_of(corners, image, device, asked.shape) as found:
        return grid_of(found, corners, asked, strict=strict)


def grid_of(
    found: Iterable[Board],
    corners: Corners,
    asked: Asked,
    *,
    strict: bool,
) -> Grid:
    """Return the grid of the board that is meant."""
    chosen, told = chosen_of(found_in(found, asked, corners), asked, len(corners))
    if chosen is None:
        grid = empty_grid(len(corners), asked.shape, asked.like)
    else:
        grid = placed(chosen, corners, asked, told)
    if strict and grid.doubts:
        raise GridError("; ".join(grid.doubts))
    return grid


def build_grids(
    corners: Corners,
    image: AnyImage,
    shape: tuple[int, int] | None = None,
    *,
    device: Device | str | None = None,
) -> list[Grid]:
    """Number the corners of every checkerboard in a view, the one with the most nodes first.

    corners, image, shape, device: as in `build_grid`. A corner belongs to one grid at most.
    A board has nine corners or more, and half the nodes of a known shape.

    Raises the errors of `build_grid` for its arguments.
    """
    asked = asked_of(shape, None, None)
    with _boards_of(corners, image, device, shape) as boards_of_view:
        found = by_size(found_in(boards_of_view, asked, corners))
    if shape is not None:
        found = [each for each in found if 2 * each.size >= shape[0] * shape[1]]
    return [placed(each, corners, asked) for each in found]


@contextlib.contextmanager
def _boards_of(
    corners: Corners,
    image: AnyImage,
    device: Device | str | None,
    shape: tuple[int, int] | None,
) -> Iterator[Iterable[Board]]:
    """Give the boards that corners form, the largest part's first, one after the other."""
    frame = check_image(image)
    _check_corners(corners, frame)
    count = len(corners)
    if count < 4:
        yield ()
        return
    plan = lattice_plan(select_device(device), frame.shape, frame.dtype, _full_scale(frame), count)
    with plan.lock:
        plan.take(frame, corners)
        plan.start()
        yield boards(plan, corners.xy, shape)


def _full_scale(image: GreyImage) -> int:
    """Return the largest grey level of the camera that took an image, by its brightest pixel."""
    if image.dtype == np.uint8:
        return 255
    brightest = int(image.max(initial=0))
    return min(int(2**bits) - 1 for bits in BITS if brightest < 2**bits)


def asked_of(shape: tuple[int, int] | None, like: Grid | None, previous: Grid | None) -> Asked:
    """Check what is known of the numbers."""
    if previous is not None and like is None:
        raise GridError("the grid of the frame before needs the grid at rest too")
    for name, given in (("like", like), ("previous", previous)):
        if given is None:
            continue
        check_kind(name, given, Grid, GridError)
        if not given.valid.any():
            raise GridError(
                f"the grid given as `{name}` has no nodes; give one that has been found"
            )
        if not reference_of(given).board.steps[0]:
            raise GridError(
                f"the grid given as `{name}` has no two measured nodes side by side, which show "
                "its steps; give one that shows more of the pattern"
            )
    if shape is not None:
        check_shape(shape, GridError)
        check_size(*shape)
    if like is None:
        return Asked(shape, None, None)
    if shape is not None and tuple(shape) != like.shape:
        raise GridError(f"shape is {shape}, but the grid given as `like` has {like.shape}")
    return Asked(like.shape, like, previous)


def _check_corners(corners: Corners, image: GreyImage) -> None:
    check_kind("corners", corners, Corners, GridError)
    columns, rows = (int(line.max(initial=-1)) + 1 for line in corners.pixel.T)
    if rows > image.shape[0] or columns > image.shape[1]:
        raise ImageError(
            f"the corners reach over {rows} rows and {columns} columns, the image has shape "
            f"{image.shape}; give the image that they were found in"
        )
    near = (np.abs(corners.xy) < FARTHEST).all(axis=1)
    if not near.all():
        raise GridError(
            f"{np.count_nonzero(~near)} of the {len(corners)} corners have no finite position; "
            "leave them out"
        )
    if len(corners) >= 4 and np.isnan(corners.edges).all():
        raise GridError(
            "the corners have no edge angles, which the grid is built from; "
            "detect them with a refinement (EdgeLines, EdgeStep or Midlines)"
        )
