"""`cmp-cl detect`: the corners of images, folders of images and videos."""

import argparse
import contextlib
import itertools
import os
import statistics
import sys
import time
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_max_pixels,
    grid_shape,
    refuse_to_overwrite,
)
from cmp_cl.cli.messages import counted, one_line, shown, tell_what_opencv_hides
from cmp_cl.cli.progress import Progress
from cmp_cl.cli.tables import CORNER_COLUMNS, NODE_COLUMNS, Table, corner_rows, node_rows
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector, choose_config
from cmp_cl.errors import ConfigError, GridError, ImageError
from cmp_cl.files import whole_file
from cmp_cl.grid import Grid, build_grid
from cmp_cl.image import GreyImage
from cmp_cl.marks import drop_marks
from cmp_cl.measure.patterns import is_of_few_bits, of_few_bits
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.viz import corner_overlay, grid_overlay


def add_parser(commands: Any) -> None:
    """Add `detect` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "detect",
        help="find the corners in images, folders of images and videos",
        description="Finds the corners of checkerboard-like patterns. Colour becomes grey. "
        "One line for each file says how many corners were found, on which device, and in how "
        "many milliseconds: from the image in host memory to the corners in host memory, "
        "without reading the file and without building the kernels.",
    )
    parser.add_argument("inputs", nargs="+", metavar="IMAGE", help="image, video or folder")
    parser.add_argument(
        "--out",
        metavar="CSV",
        help="write the corners of all inputs to this CSV file; positions in px, (0, 0) is the "
        "centre of the top-left pixel",
    )
    parser.add_argument(
        "--overlay",
        metavar="PNG",
        help="write the image with its corners marked; for several images or a video the name "
        "of a folder, made if missing, that gets one NAME-corners.png each",
    )
    parser.add_argument(
        "--config",
        metavar="TOML",
        help="settings of the detector; without it the cell size is estimated from each image, "
        "in a video until corners are found",
    )
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        help="number the corners of a pattern of this size, and search again for those that are "
        "missing; table and picture then show the nodes, and how each was found",
    )
    parser.add_argument(
        "--drop-marks",
        action="store_true",
        help="leave out corners inside the cells, for boards with dots, rings or codes there",
    )
    add_full_scale(parser)
    add_max_pixels(parser)
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Find the corners of every input; return the exit status."""
    config = None if arguments.config is None else DetectorConfig.load(arguments.config)
    if config is not None and arguments.full_scale is not None:
        config = config.replace(full_scale=arguments.full_scale)
    paths = media.find_inputs(arguments.inputs)
    overlays = _overlay_paths(arguments.overlay, paths)
    out = _csv_path(arguments.out)
    refuse_to_overwrite([*paths, arguments.config], [*overlays.values(), out])
    tell_what_opencv_hides(paths)
    device = None if arguments.device is None else select_device(arguments.device)
    status = 0
    told = False  # that weak corners may be missing
    table = None
    with contextlib.suppress(_NothingToWrite), contextlib.ExitStack() as stack:
        if out is not None:
            columns = CORNER_COLUMNS if arguments.grid is None else NODE_COLUMNS
            table = Table(stack.enter_context(whole_file(out)), columns)
        finder = stack.enter_context(
            contextlib.closing(
                _Finder(
                    config,
                    arguments.full_scale,
                    device,
                    arguments.max_pixels,
                    marks_go=arguments.drop_marks,
                )
            )
        )
        progress = stack.enter_context(Progress(_frames_in(paths), "frames"))
        for path in paths:
            tally = _Tally()
            failures = []
            try:
                for number, image, corners in finder.find(path, tally):
                    grid = None
                    if arguments.grid is not None:
                        grid = tally.numbered(number, image, corners, arguments.grid)
                    if table is not None and arguments.grid is None:
                        table.write(str(path), number, corner_rows(corners))
                    elif table is not None and grid is not None:
                        table.write(str(path), number, node_rows(grid))
                    if path in overlays:
                        name = _of_frame(overlays[path], path, number)
                        drawn = corner_overlay(image, corners)
                        media.write_image(
                            name,
                            drawn if grid is None else grid_overlay(image, grid, corners=corners),
                        )
                        tally.overlays.append(name)
                    progress.step()
            except ImageError as error:
                failures.append(one_line(error))
            if tally.refused:
                failures.append(f"{shown(path)}: {tally.refused_line()}")
            status = 2 if failures else status
            empty = table is not None and status == 2 and not table.rows and path is paths[-1]
            if empty:
                failures.append(f"{shown(out)} was not written")
            if failures:
                progress.say(f"cmp-cl: {'; '.join(failures)}", sys.stderr)
            if tally.broken and tally.counts:
                progress.say(f"cmp-cl: {shown(path)}: {tally.broken_line()}", sys.stderr)
            if tally.counts:
                progress.say(f"{shown(path)}: {tally.line()}", sys.stdout)
            if tally.is_dark() and not (told and any(tally.counts)):
                told = True
                progress.say(
                    f"cmp-cl: {shown(path)}: {of_few_bits(tally.brightest)}",
                    sys.stderr,
                )
            if empty:
                raise _NothingToWrite
    if table is not None and not (status and not table.rows):
        what = "corners" if arguments.grid is None else "nodes"
        print(f"wrote {shown(out)}: {table.rows} {what}")
    return status


class _NothingToWrite(Exception):
    """Nothing was found and something failed, so that an older table is kept."""


class _Tally:
    """The counts and the failures of a file."""

    def __init__(self) -> None:
        self.counts: list[int] = []
        self.milliseconds: list[float] = []
        self.nodes: list[int] = []
        self.refused: dict[int, str] = {}  # frame to reason
        self.ambiguous: list[int] = []
        self.broken: list[int] = []
        self.overlays: list[Path] = []
        self.brightest = 0
        self.device = ""
        self.size = 0  # nodes of the pattern

    def add(self, corners: Corners, milliseconds: float) -> None:
        self.counts.append(len(corners))
        self.milliseconds.append(milliseconds)
        self.device = corners.device

    def numbered(
        self, frame: int, image: GreyImage, corners: Corners, shape: tuple[int, int]
    ) -> Grid | None:
        """Number the corners of a frame by row and column; return None if that fails.

        A board of another size is refused, because the wanted part of it is unknown.
        """
        try:
            grid = build_grid(corners, image, shape=shape)
        except GridError as error:
            self.refused[frame] = one_line(error)
            return None
        if grid.seen_shape is not None:
            self.refused[frame] = grid.doubts[0]
            return None
        if grid.ambiguous:
            self.ambiguous.append(frame)
        self.nodes.append(int(np.count_nonzero(grid.valid)))
        self.size = grid.status.size
        return grid

    def line(self) -> str:
        corners = f"{_span(self.counts)} corners"
        time_of_one = f"{statistics.median(self.milliseconds):.2f} ms"
        if len(self.counts) > 1:
            corners = f"{len(self.counts)} frames, {corners} each,"
            time_of_one = f"a median of {time_of_one} each"
        line = f"{corners} in {time_of_one} (upload, kernels, download) on {self.device}"
        if self.nodes:
            line += f"; {_span(self.nodes)} of {self.size} nodes"
        if self.ambiguous:
            line += f"; ambiguous numbers in {counted(len(self.ambiguous), 'frame')}: "
            line += f"{_some(self.ambiguous)}, in which too little of the board's border is "
            line += "visible, or a reflection of it"
        if self.overlays:
            last = f" to {shown(self.overlays[-1])}" if len(self.overlays) > 1 else ""
            line += f"; wrote {shown(self.overlays[0])}{last}"
        return line

    def is_dark(self) -> bool:
        """Return whether 16-bit pixels seem to be of fewer bits, so that corners may be missing."""
        return is_of_few_bits(np.uint16, self.brightest)

    def refused_line(self) -> str:
        (first, why), *more = self.refused.items()
        if not more:
            return f"frame {first} is not numbered: {why}"
        some = _some(self.refused)
        return f"{len(self.refused)} frames are not numbered: {some}; the first: {why}"

    def broken_line(self) -> str:
        frames = counted(len(self.broken), "frame")
        return f"skipped {frames} that could not be read: {_some(self.broken)}"


def _some(numbers: Collection[int]) -> str:
    """Return the first of the numbers, as a list."""
    few = ", ".join(map(str, itertools.islice(numbers, 8)))
    return f"{few}, ..." if len(numbers) > 8 else few


def _span(counts: Sequence[int]) -> str:
    least, most = min(counts), max(counts)
    return f"{least}" if least == most else f"{least} to {most}"


class _Finder:
    """Finds corners in a sequence of images, and keeps its detector as long as it fits them."""

    def __init__(
        self,
        config: DetectorConfig | None,
        full_scale: int | None,
        device: Device | None,
        max_pixels: int,
        *,
        marks_go: bool,
    ) -> None:
        self._max_pixels = max_pixels
        self._marks_go = marks_go
        self._config = config
        self._full_scale = full_scale
        self._device = device
        self._key: object = None
        self._kept = contextlib.ExitStack()
        self._detector: Detector

    def find(self, path: Path, tally: _Tally) -> Iterator[tuple[int, GreyImage, Corners]]:
        """Yield the frames of a file that can be read: number, image and corners.

        Without a configuration it is estimated from each frame until one has corners.
        """
        config = self._config
        scale = media.full_scale(path) if self._full_scale is None else self._full_scale
        if config is not None and config.full_scale is None:
            config = config.replace(full_scale=scale)
        for frame in media.read_frames(path, max_pixels=self._max_pixels):
            if frame.image is None:
                tally.broken.append(frame.index)
                continue
            chosen = config or choose_config(frame.image, full_scale=scale, device=self._device)
            self._fit(frame.image, chosen)
            start = time.perf_counter()
            corners = self._detector(frame.image)
            milliseconds = (time.perf_counter() - start) * 1e3
            if self._marks_go:
                corners = drop_marks(corners, frame.image)
            tally.add(corners, milliseconds)
            if frame.image.dtype == np.uint16 and chosen.full_scale is None:
                tally.brightest = max(tally.brightest, int(frame.image.max()))
            if len(corners):
                config = chosen
            yield frame.index, frame.image, corners
        if not tally.counts:
            raise ImageError(f"{str(path)!r} has no frame that can be read")

    def _fit(self, image: GreyImage, config: DetectorConfig) -> None:
        """Make a detector for such images, and run it once: some devices compile only then."""
        key = (image.shape, image.dtype, config)
        if key == self._key:
            return
        self.close()
        self._detector = self._kept.enter_context(
            Detector(shape=image.shape, dtype=image.dtype, config=config, device=self._device)
        )
        self._detector(image)
        self._key = key

    def close(self) -> None:
        self._key = None
        self._kept.close()


def _frames_in(paths: Sequence[Path]) -> int | None:
    """Return the number of frames, None if no terminal shows progress."""
    if not sys.stderr.isatty():
        return None
    total = 0
    for path in paths:
        with contextlib.suppress(ImageError, OSError):
            total += media.count_frames(path) or 1
    return total


def _csv_path(out: str | None) -> Path | None:
    if out is None:
        return None
    if out in ("", "-"):
        raise ConfigError("--out needs a file name, for example corners.csv")
    return Path(out) / "corners.csv" if os.path.isdir(out) else Path(out)


def _overlay_paths(overlay: str | None, paths: Sequence[Path]) -> dict[Path, Path]:
    """Return the path of each input's overlay; a missing folder is made."""
    if overlay is None:
        return {}
    if not overlay:
        raise ConfigError("--overlay needs the name of a picture or a folder")
    suffix = Path(overlay).suffix.lower()
    if suffix in media.IMAGE_SUFFIXES and not os.path.isdir(overlay):
        if len(paths) > 1 or media.is_video(paths[0]):
            what = f"there are {len(paths)} inputs" if len(paths) > 1 else "the input is a video"
            raise ConfigError(
                f"--overlay {shown(overlay)} is one picture, but {what}; name a folder"
            )
        return {paths[0]: Path(overlay)}
    folder = Path(overlay)
    if suffix and not folder.is_dir() and not overlay.endswith(("/", os.sep)):
        raise ConfigError(
            f"--overlay {shown(overlay)} is neither a folder nor a picture that can be written; "
            "end it in .png"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if any(os.path.realpath(path.parent) == os.path.realpath(folder) for path in paths):
        raise ConfigError(f"--overlay {shown(overlay)} contains inputs; choose another folder")
    names: dict[Path, Path] = {}
    for path in dict.fromkeys(paths):
        name = folder / f"{path.stem}-corners.png"
        number = 2
        while name in names.values():
            name = folder / f"{path.stem}-{number}-corners.png"
            number += 1
        names[path] = name
    return names


def _of_frame(overlay: Path, path: Path, index: int) -> Path:
    """Return the path of the overlay of one frame of a video, or of one page of an image."""
    if index == 0 and not media.is_video(path):
        return overlay
    return overlay.with_stem(f"{overlay.stem}-{index:06}")
