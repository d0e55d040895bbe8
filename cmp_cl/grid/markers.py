"""Virtual markers are moved onto the edges of an image here (section 4.3 of the paper)."""

import dataclasses
from numbers import Integral
from typing import NamedTuple

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.errors import GridError, check_kind, check_range
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage, check_image
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.opencl.launches import GROUP, bound, constant, enqueue, multiple
from cmp_cl.opencl.memory import Memory
from cmp_cl.opencl.program import programs_of

SEARCHED = 0.3  # share of the edge's length: the edge is searched so far from the curve
LONGEST_SEARCH = 6.0  # px


class Profiles(NamedTuple):
    """The grey profiles in which the edges at virtual markers are searched.

    place: (M, 2) int64, (row, column) of the marker in the dense grid.
    pixel: (M, 2) int32, the pixel nearest to the marker, (x, y).
    line: (M, 4) float32, the marker from that pixel's centre (x, y), px, and the unit normal
        of the edge (x, y) from white to black.
    reach: (M,) float32, px on either side.
    """

    place: NDArray[np.int64]
    pixel: NDArray[np.int32]
    line: NDArray[np.float32]
    reach: NDArray[np.float32]


def profiles(dense: Grid, count: int) -> Profiles:
    """Return the profiles across the edges of a dense grid, at `count` virtual markers per edge."""
    row, column = np.nonzero(dense.status == NodeStatus.VIRTUAL)
    padded = np.pad(dense.xy.astype(np.float64), ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    # markers of a row have neighbours left and right, those of a column above and below
    in_row = ~np.isnan(padded[row + 1, column, 0])
    down, right = np.where(in_row, 0, 1), np.where(in_row, 1, 0)
    tangent = (
        padded[row + 1 + down, column + 1 + right] - padded[row + 1 - down, column + 1 - right]
    )
    length = np.hypot(*tangent.T)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)  # right of the tangent, clockwise
    normal /= np.maximum(length, 1e-6)[:, None]
    times = count + 1
    # right of a row's edge is the cell below, right of a column's edge the cell to the left
    cell = row // times + column // times + np.where(in_row, 0, 1) + dense.parity
    normal[cell % 2 == 1] *= -1
    at = dense.xy[row, column].astype(np.float64)
    pixel = np.rint(at)
    return Profiles(
        place=np.stack([row, column], axis=1),
        pixel=pixel.astype(np.int32),
        line=np.concatenate([at - pixel, normal], axis=1).astype(np.float32),
        reach=np.minimum(SEARCHED / 2 * times * length, LONGEST_SEARCH).astype(np.float32),
    )


def refine_markers(
    dense: Grid,
    count: int,
    image: GreyImage,
    device: Device | str | None = None,
    contrast: float = 20,
) -> Grid:
    """Refine the virtual markers of a dense grid: move them across their edges to the edge itself.

    dense: the result of `grid.with_virtual_markers(count)`. image: (H, W) uint8 or uint16.
    device: a Device, a text for `select_device`, or None for the default device. contrast: least
        difference of the two sides of an edge, grey levels; with less, the marker stays.

    On soft or worn edges, such as those of rendered gels, the curve through the nodes is the better
    estimate. Raises GridError if the grid does not have that count, ImageError, DeviceError,
    KernelBuildError; ConfigError for a contrast that is not a number from 0 to 65535.
    """
    image = check_image(image)
    check_kind("dense", dense, Grid, GridError)
    check_kind("count", count, Integral, GridError)
    check_range("contrast", contrast, 0, 65535)
    _check_count(dense, count)
    at = profiles(dense, count)
    if not len(at.place):
        return dense
    device = select_device(device)
    shift = _shifts(image, at, device, contrast)
    shift = np.where(np.isnan(shift), 0, shift)
    xy = dense.xy.copy()
    xy[at.place[:, 0], at.place[:, 1]] += shift[:, None] * at.line[:, 2:]
    return dataclasses.replace(dense, xy=xy)


def _check_count(dense: Grid, count: int) -> None:
    """Raise GridError if the grid is not one of nodes and `count` markers on each edge."""
    times = count + 1
    whole = count >= 0 and not any(max(n - 1, 0) % times for n in dense.shape)
    if not whole or (dense.status[::times, ::times] == NodeStatus.VIRTUAL).any():
        raise GridError(
            f"a grid of {dense.shape} nodes does not hold {count} virtual markers on each edge; "
            "give what with_virtual_markers(count) gave, and its count"
        )


def _shifts(image: GreyImage, at: Profiles, device: Device, contrast: float) -> NDArray[np.float32]:
    """Return (M,) px along the normals, NaN where no edge is found, from kernels/markers.cl."""
    programs = programs_of(device.handle)
    queue = cl.CommandQueue(programs.context)
    pixel = "uchar" if image.dtype == np.uint8 else "ushort"
    kernels = programs.kernels(["markers"], {"PIXEL": pixel})
    (rows, columns), count = image.shape, len(at.place)
    found = Memory(queue, {"shift": ((count,), np.float32)})
    inputs = {"image": image, "pixel": at.pixel, "line": at.line, "reach": at.reach}
    parts = {
        **{name: constant(queue.context, values) for name, values in inputs.items()},
        "step": np.uint32(columns),
        "rows": np.int32(rows),
        "columns": np.int32(columns),
        "count": np.int32(count),
        "contrast": np.float32(contrast),
        **found.parts,
    }
    items = (multiple(count, GROUP),)
    enqueue(queue, [bound(kernels, parts, "refine_markers", items, (GROUP,))])
    found.download()
    queue.finish()
    return found.arrays["shift"].copy()
