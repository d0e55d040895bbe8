"""What the commands share: arguments, names in messages, progress, patterns and views."""

import argparse
import contextlib
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cell import estimate_cell
from cmp_cl.config import DetectorConfig, EdgeStep
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError
from cmp_cl.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage
from cmp_cl.opencl.device import Device
from cmp_cl.stereo import BinocularSplit

_USUAL_CELLS = (20.0, 12.0, 40.0)  # px, tried where the estimate does not find the pattern
_MOST_TURNED = np.pi / 3  # rad between the rows of one pattern in two views
_BOX = r"(\d+),(\d+),(\d+),(\d+)"

Box = tuple[int, int, int, int]  # x, y, width, height, px
Region = tuple[float, float, float, float]  # x0, y0, x1, y1, px
View = tuple[Box, bool]  # where it is in the frame, and whether it is mirrored


def shown(name: object) -> str:
    """A file name as it can stand in a line: itself, or quoted with its odd characters escaped."""
    text = os.fspath(name) if isinstance(name, Path) else str(name)
    return text if text.isprintable() else repr(text)


def one_line(error: Exception) -> str:
    """The message of an error on one line."""
    if isinstance(error, OSError) and error.strerror is not None:
        name = "" if error.filename is None else f"{shown(error.filename)}: "
        return f"{name}{error.strerror}"
    return " ".join(str(error).splitlines())


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 frame, 2 frames."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


# arguments


def add_device(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="part of a device's or platform's name, an index such as 0:0, gpu or cpu; default: "
        "the variable CMP_CL_DEVICE, else the first GPU, else the first CPU",
    )


def add_full_scale(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--full-scale",
        metavar="LEVEL",
        type=int,
        help="largest grey level of the camera, 4095 for 12 bits in a 16-bit file; default: that "
        "of the settings, else 255 or 65535",
    )


def add_split(parser: argparse.ArgumentParser, *, help_: str) -> None:
    parser.add_argument("--split", metavar="WHERE", help=help_)
    parser.add_argument(
        "--mirror",
        choices=("left", "right", "both"),
        help="the views that an odd number of mirrors shows reversed",
    )


def add_region(parser: argparse.ArgumentParser, *, help_: str) -> None:
    parser.add_argument("--region", metavar="WHERE", type=boxes, help=help_)


def grid_shape(text: str) -> tuple[int, int]:
    """Rows and columns from a text such as 40x40."""
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None or min(int(match[1]), int(match[2])) < 2:
        raise argparse.ArgumentTypeError(f"{text!r} is no pair of counts such as 40x40")
    return int(match[1]), int(match[2])


def boxes(text: str) -> tuple[Box, ...]:
    """One or two rectangles from a text such as 0,0,320,480 or 0,0,320,480:400,0,320,480."""
    match = re.fullmatch(f"{_BOX}(?::{_BOX})?", text)
    numbers = [] if match is None else [int(number) for number in match.groups() if number]
    found = [(x, y, w, h) for x, y, w, h in zip(*[iter(numbers)] * 4, strict=True)]
    if not found or min(min(box[2:]) for box in found) < 1:
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither a rectangle X,Y,WIDTH,HEIGHT in px nor two of them with a colon "
            "between"
        )
    return tuple(found)


def regions_in(chosen: Sequence[Box] | None, *views: View) -> tuple[Region | None, ...]:
    """Of each view the region that --region chooses in its frame, None without it.

    Raises ConfigError where there are not as many rectangles as views, or one lies outside.
    """
    if chosen is None:
        return (None,) * len(views)
    if len(chosen) != len(views):
        raise ConfigError(
            f"--region needs a rectangle for each view, here {len(views)}, with a colon between "
            f"two; it has {len(chosen)}"
        )
    return tuple(
        region_in(view, box, mirror=mirror)
        for box, (view, mirror) in zip(chosen, views, strict=True)
    )


def whole(image: GreyImage) -> View:
    """The view that is all of the frame."""
    return (0, 0, image.shape[1], image.shape[0]), False


def views_of(split: BinocularSplit) -> tuple[View, View]:
    """The left and the right view."""
    return (split.left, split.mirror_left), (split.right, split.mirror_right)


def region_in(view: Box, box: Box, *, mirror: bool) -> Region:
    """Where a rectangle of a frame lies in a view that was cut from it.

    Raises ConfigError where it lies outside.
    """
    x, y, width, height = view
    x0, y0 = box[0] - x, box[1] - y
    x1, y1 = x0 + box[2], y0 + box[3]
    if not (x1 > 0 and y1 > 0 and x0 < width and y0 < height):
        raise ConfigError(
            f"--region {','.join(map(str, box))} lies outside the view, which is "
            f"{','.join(map(str, view))} of the frame (X,Y,WIDTH,HEIGHT)"
        )
    if mirror:
        x0, x1 = width - x1, width - x0
    return x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5


def split_of(where: str, mirror: str | None, shape: tuple[int, ...]) -> BinocularSplit:
    """The split that --split and --mirror ask for, for frames of that shape.

    Raises ConfigError for a text that is neither halves nor two rectangles.
    """
    match = re.fullmatch(f"{_BOX}:{_BOX}", where)
    if where == "halves":
        halves = BinocularSplit.halves(shape[1], shape[0])
        left, right = halves.left, halves.right
    elif match is not None:
        x, y, width, height, *other = map(int, match.groups())
        left, right = (x, y, width, height), (other[0], other[1], other[2], other[3])
    else:
        raise ConfigError(
            f"--split {where!r} is neither halves nor two rectangles X,Y,WIDTH,HEIGHT:"
            "X,Y,WIDTH,HEIGHT in px, left and right"
        )
    return BinocularSplit(left, right, mirror in ("left", "both"), mirror in ("right", "both"))


# progress


class Progress:
    """A progress bar, where tqdm is installed and stderr is a terminal; else nothing.

    total: how many steps, None where nobody knows. unit: what is counted.
    """

    def __init__(self, total: int | None, unit: str) -> None:
        self._bar: Any = None
        with contextlib.suppress(ImportError):
            from tqdm import tqdm

            self._bar = tqdm(total=total, unit=f" {unit}", disable=None, leave=False)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def step(self) -> None:
        if self._bar is not None:
            self._bar.update()

    def say(self, line: str, stream: TextIO | None = None) -> None:
        """Print a line above the bar, on stdout where no stream is named."""
        if self._bar is not None:
            self._bar.clear()
        print(line, file=stream or sys.stdout, flush=True)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


# patterns


def find_pattern(
    view: GreyImage,
    shape: tuple[int, int] | None,
    device: Device,
    full_scale: int | None = None,
    region: Region | None = None,
) -> tuple[float, Grid]:
    """The cell, px, and the grid of a pattern whose cell size nobody has given.

    The estimated cell and some usual ones are tried. The first that sees all nodes of a known
    shape, or a grid of most corners, ends the search; else the most detected nodes win.

    Raises GridError where no cell shows a pattern.
    """
    best: Grid | None = None
    why = "no closed cell is seen"
    estimate = float(np.clip(estimate_cell(view), 4, 1000))
    for cell in (estimate, *_USUAL_CELLS):
        config = DetectorConfig.for_cell(cell).replace(full_scale=full_scale)
        with Detector(shape=view.shape, dtype=view.dtype, config=config, device=device) as detector:
            try:
                corners, grid = detector.grid(view, shape=shape, region=region)
            except GridError as error:
                why = one_line(error)
                continue
        if detected(grid) > (0 if best is None else detected(best)):
            best = grid
        enough = len(corners) / 2 if shape is None else grid.status.size - 1
        if detected(grid) > enough:
            break
    cell = np.nan if best is None else cell_of(best)
    if best is None or not cell >= 4:
        size = "" if shape is None else f" of {shape[0]} x {shape[1]} corners"
        raise GridError(f"no pattern{size} is found: {why}")
    return cell, best


def detected(grid: Grid) -> int:
    """How many nodes the detector itself has found."""
    return int(np.count_nonzero(grid.status == NodeStatus.DETECTED))


def cell_of(grid: Grid) -> float:
    """Median side of the cells, px, NaN where there is none."""
    sides = [np.linalg.norm(np.diff(grid.xy, axis=axis), axis=2).ravel() for axis in (0, 1)]
    known = np.concatenate(sides)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def exact_config(cell: float, full_scale: int | None = None) -> DetectorConfig:
    """The most complete and exact settings for a deformed pattern: EdgeStep for its cell."""
    return DetectorConfig.for_cell(cell).replace(
        refinement=EdgeStep(cell=cell), full_scale=full_scale
    )


def alike(left: Grid, right: Grid) -> Grid:
    """The right grid numbered as the left one is.

    Both show one pattern, so the checker colours agree; of the quarter turns with these
    colours it is the one that leaves the rows most parallel.

    Raises GridError where the shapes differ or no turn leaves them within 60 degrees.
    """
    if not (left.valid.any() and right.valid.any()):
        raise GridError("a view without any node cannot be numbered like the other one")
    along = _along(left)
    turns = [turned(right, quarters) for quarters in range(4)]
    fitting = [turn for turn in turns if turn.shape == left.shape and turn.parity == left.parity]
    off = [abs(float(np.angle(_along(turn) / along))) for turn in fitting]
    if not off or not min(off) <= _MOST_TURNED:
        raise GridError(
            "the two views cannot be numbered alike: their shapes, their checker colours or "
            "the directions of their rows do not agree"
        )
    return fitting[int(np.argmin(off))]


def _along(grid: Grid) -> complex:
    """The mean step from a column to the next, x + 1j y, px."""
    step = np.diff(grid.xy.astype(np.float64), axis=1)
    known = step[np.isfinite(step).all(axis=2)]
    return complex(*known.mean(axis=0)) if len(known) else complex(np.nan, np.nan)


def turned(grid: Grid, quarters: int) -> Grid:
    """The same nodes with the numbers turned: row 0 is the last column, and so on."""
    index: NDArray[np.int32] = grid.index.copy()
    parity, columns = grid.parity, grid.shape[1]
    for turn in range(quarters):
        last = grid.shape[1 - turn % 2] - 1
        known = index[:, 0] >= 0
        index[known] = np.column_stack([last - index[known, 1], index[known, 0]])
    first = (0, columns, sum(grid.shape), grid.shape[0])[quarters]
    return Grid(
        xy=np.rot90(grid.xy, quarters).copy(),
        status=np.rot90(grid.status, quarters).copy(),
        sigma=np.rot90(grid.sigma, quarters).copy(),
        index=index,
        parity=(parity + first) % 2,
    )
