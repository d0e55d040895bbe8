"""Patterns of unknown cell size in a view, and two views of one pattern."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cmp_cl.config import DetectorConfig
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, check_kind, check_shape
from cmp_cl.grid import Grid, NodeStatus, align
from cmp_cl.grid.align import row_direction
from cmp_cl.image import GreyImage
from cmp_cl.opencl.device import Device

Region: TypeAlias = tuple[float, float, float, float]  # x0, y0, x1, y1, px

_MOST_ROTATED = np.pi / 3  # rad between the rows of one pattern in two views
_FEW_BITS = 2**14  # a grey level that an image of 16 bits reaches, unless it is very dark


def find_pattern(
    view: GreyImage,
    *,
    shape: tuple[int, int] | None = None,
    region: Region | None = None,
    full_scale: int | None = None,
    device: Device | str | None = None,
) -> tuple[float, Grid]:
    """Find a pattern of unknown cell size; return the side of its cells, px, and its grid.

    view, shape, region, full_scale, device: as in `OneView`. The corners are those of
        `DetectorConfig()`, the settings of every caller that gives none.

    Raises GridError if there is no pattern or the pattern seems to have another number of corners,
    and the errors of `Detector`.
    """
    if shape is not None:
        check_shape(shape, GridError)
    config = DetectorConfig(full_scale=full_scale)
    why = "no closed cell is seen"
    with Detector(shape=view.shape, dtype=view.dtype, config=config, device=device) as detector:
        try:
            _, grid = detector.grid(view, shape=shape, region=region)
            cell = cell_of(grid)
        except GridError as error:
            why, cell = str(error), np.nan
        advice = "" if cell >= 4 else detector(view).advice(view)
    if not cell >= 4:
        size = "" if shape is None else f" of {' x '.join(map(str, shape))} corners"
        brightest = int(view.max(initial=0)) if full_scale is None else 0
        hint = f"; {of_few_bits(brightest)}" if is_of_few_bits(view.dtype, brightest) else ""
        hint = hint or (f"; {advice}" if advice else "")
        raise GridError(f"no pattern{size} is found: {why}{hint}")
    check_size(grid)
    return cell, grid


def is_of_few_bits(dtype: DTypeLike, brightest: int) -> bool:
    """Return whether 16-bit pixels seem to come from a camera of fewer bits.

    brightest: the largest grey level.
    """
    return dtype == np.uint16 and 0 < brightest < _FEW_BITS


def of_few_bits(brightest: int) -> str:
    """Return, as text, what to do about pixels of fewer than 16 bits."""
    cameras = [bits for bits in (10, 12, 14, 16) if brightest < 2**bits]
    *levels, last = [f"full_scale={2**bits - 1} for {bits} bits" for bits in cameras[:-1]]
    asked = f"{', '.join(levels)} or {last}" if levels else last
    return f"the brightest of the 16-bit pixels is {brightest}; give {asked}"


def check_size(grid: Grid) -> None:
    """Raise GridError if the pattern seems to have another number of corners."""
    if grid.seen_shape is not None:
        raise GridError(grid.doubts[0])


def check_two(name: str, values: object) -> None:
    """Raise ConfigError if an argument of that name is not a sequence of two."""
    if not (isinstance(values, Sequence) and len(values) == 2):
        raise ConfigError(f"{name} must be those of the left and the right view, not {values!r}")


def detected(grid: Grid) -> int:
    """Count the nodes of a grid that the detector itself has found."""
    return int(np.count_nonzero(grid.status == NodeStatus.DETECTED))


def cell_of(grid: Grid) -> float:
    """Return the median side of a grid's cells, px, NaN if it has none.

    Raises GridError if grid is of another type.
    """
    check_kind("grid", grid, Grid, GridError)
    sides = [np.linalg.norm(np.diff(grid.xy, axis=axis), axis=2).ravel() for axis in (0, 1)]
    known = np.concatenate(sides)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


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
