"""`cmp-cl detect`: the corners of images, folders of images and videos."""

import argparse
import itertools
import os
import statistics
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    check_files,
    grid_shape,
)
from cmp_cl.cli.messages import counted, in_shell, one_line, shown
from cmp_cl.cli.progress import Progress
from cmp_cl.cli.tables import CORNER_COLUMNS, NODE_COLUMNS, Table, corner_rows, node_rows
from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, ImageError
from cmp_cl.files import whole_file
from cmp_cl.grid import build_grid
from cmp_cl.image import GreyImage
from cmp_cl.marks import drop_marks
from cmp_cl.measure.patterns import is_of_few_bits, of_few_bits
from cmp_cl.opencl.device import select_device
from cmp_cl.viz import corner_overlay, grid_overlay


def add_parser(commands: Any) -> None:
    """Add `detect` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "detect",
        help="find the corners in images, folders of images and videos",
        description="Finds the corners of checkerboard-like patterns. Colour becomes grey. "
        "One line for each file says how many corners were found, on which device, and in how "
        "many milliseconds: from the image in host memory to the corners in host memory, with the "
        "making of the detector for the first image of a size.",
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
        help="settings of the detector; default: those of DetectorConfig(), for cells of any size",
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
    add_device(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Find the corners of every input; return the exit status."""
    config = DetectorConfig() if arguments.config is None else DetectorConfig.load(arguments.config)
    if arguments.full_scale is not None:
        config = config.replace(full_scale=arguments.full_scale)
    paths = media.find_inputs(arguments.inputs)
    overlays = _overlay_paths(arguments.overlay, paths)
    out = _csv_path(arguments.out)
    check_files([*paths, arguments.config], [*overlays.values(), out])
    finder = _Finder(config, arguments)
    kind = _CornerOutput if arguments.grid is None else _NodeOutput
    failed = told = lost = False
    with ExitStack() as files:
        output = kind(files, out, arguments.grid)
        with finder, Progress(_frames_in(paths), "frames") as progress:
            for path in paths:
                tally = _Tally(path, overlays.get(path))
                _search(tally, finder, output, progress)
                failed = failed or bool(tally.failures)
                lost = failed and path is paths[-1] and output.is_empty()
                if lost:
                    tally.failures.append(f"{shown(out)} was not written")
                _tell(tally, progress, told=told)
                told = told or tally.is_dark()
        output.close(lost=lost)
    return 2 if failed else 0


class _Tally:
    """The counts and the failures of a file."""

    def __init__(self, path: Path, overlay: Path | None) -> None:
        self.path, self.overlay = path, overlay
        self.failures: list[str] = []
        self.counts: list[int] = []
        self.milliseconds: list[float] = []
        self.nodes: list[int] = []
        self.refused: dict[int, str] = {}  # frame to reason
        self.ambiguous: list[int] = []
        self.broken: list[int] = []
        self.why = ""  # of the last broken frame
        self.overlays: list[Path] = []
        self.brightest = 0
        self.full_scale: int | None = None
        self.device = ""
        self.size = 0  # nodes of the pattern

    def line(self) -> str:
        corners = f"{_span(self.counts)} corners"
        spent = f"{self.milliseconds[0]:.2f} ms"
        if len(self.counts) > 1:
            corners = f"{len(self.counts)} frames, {corners} each,"
            median = statistics.median(self.milliseconds)
            spent = f"{sum(self.milliseconds):.0f} ms, a median of {median:.2f} ms each,"
        line = f"{corners} in {spent} on {self.device}"
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
        return self.full_scale is None and is_of_few_bits(np.uint16, self.brightest)

    def is_too_bright(self) -> bool:
        """Return whether pixels exceed the full scale, so that corners may be missing."""
        return self.full_scale is not None and self.brightest > self.full_scale

    def refused_line(self) -> str:
        (first, why), *more = self.refused.items()
        if not more:
            return f"frame {first} is not numbered: {why}"
        some = _some(self.refused)
        return f"{len(self.refused)} frames are not numbered: {some}; the first: {why}"

    def broken_line(self) -> str:
        frames = counted(len(self.broken), "frame")
        why = f" ({self.why})" if self.why else ""
        return f"skipped {frames} that could not be read{why}: {_some(self.broken)}"


def _some(numbers: Collection[int]) -> str:
    """Return the first of the numbers, as a list."""
    few = ", ".join(map(str, itertools.islice(numbers, 8)))
    return f"{few}, ..." if len(numbers) > 8 else few


def _span(counts: Sequence[int]) -> str:
    least, most = min(counts), max(counts)
    return f"{least}" if least == most else f"{least} to {most}"


class _CornerOutput:
    """Writes the corners of frames to a table of all files, and to a picture of each frame."""

    noun = "corners"
    columns: Sequence[str] = CORNER_COLUMNS

    def __init__(self, files: ExitStack, out: Path | None, shape: tuple[int, int] | None) -> None:
        self._files, self._out, self._shape = files, out, shape
        self._table = None
        if out is not None:
            self._table = Table(files.enter_context(whole_file(out)), self.columns)

    def is_empty(self) -> bool:
        return self._table is not None and not self._table.rows

    def close(self, *, lost: bool) -> None:
        """Put the table in its place and say so; a lost one is dropped."""
        with suppress(ImageError), self._files:
            if lost:  # an error makes the file's block keep an older table
                raise ImageError("nothing was found")
        if self._table is not None and not lost:
            print(f"wrote {shown(self._out)}: {self._table.rows} {self.noun}")

    def add(self, tally: _Tally, number: int, image: GreyImage, corners: Corners) -> None:
        """Write what was found in a frame."""
        self._write(tally, number, corner_rows(corners))
        self._draw(tally, number, lambda: corner_overlay(image, corners))

    def _write(self, tally: _Tally, number: int, rows: Iterable[Sequence[object]]) -> None:
        if self._table is not None:
            self._table.write(str(tally.path), number, rows)

    def _draw(self, tally: _Tally, number: int, draw: Callable[[], NDArray[np.uint8]]) -> None:
        if tally.overlay is not None:
            name = _of_frame(tally.overlay, tally.path, number)
            media.write_image(name, draw())
            tally.overlays.append(name)


class _NodeOutput(_CornerOutput):
    """Numbers the corners by row and column, and writes the nodes in their place."""

    noun, columns = "nodes", NODE_COLUMNS

    def add(self, tally: _Tally, number: int, image: GreyImage, corners: Corners) -> None:
        try:
            grid = build_grid(corners, image, shape=self._shape)
            if grid.seen_shape is not None:  # it is unknown which part of the board is wanted
                raise GridError(grid.doubts[0])
        except GridError as error:
            tally.refused[number] = one_line(error)
            self._draw(tally, number, lambda: corner_overlay(image, corners))
            return
        if grid.ambiguous:
            tally.ambiguous.append(number)
        tally.nodes.append(int(np.count_nonzero(grid.valid)))
        tally.size = grid.status.size
        self._write(tally, number, node_rows(grid))
        self._draw(tally, number, lambda: grid_overlay(image, grid, corners=corners))


class _Finder(Closing):
    """Finds corners in a sequence of images, and keeps its detector as long as it fits them."""

    def __init__(self, config: DetectorConfig, arguments: argparse.Namespace) -> None:
        self._config, self._arguments = config, arguments
        self._device = None if arguments.device is None else select_device(arguments.device)
        self._key: object = None
        self._kept = ExitStack()

    def find(self, tally: _Tally) -> Iterator[tuple[int, GreyImage, Corners]]:
        """Yield the frames of a file that can be read: number, image and corners."""
        path, config, asked = tally.path, self._config, self._arguments
        scale = media.video_info(path).full_scale if asked.full_scale is None else asked.full_scale
        if config.full_scale is None:
            config = config.replace(full_scale=scale)
        for frame in media.read_frames(path):
            if frame.image is None:
                tally.broken.append(frame.index)
                tally.why = frame.why
                continue
            start = time.perf_counter()
            self._fit(frame.image, config)
            corners = self._detector(frame.image)
            milliseconds = (time.perf_counter() - start) * 1e3
            if asked.drop_marks:
                corners = drop_marks(corners, frame.image)
            tally.counts.append(len(corners))
            tally.milliseconds.append(milliseconds)
            tally.device = corners.device
            if frame.image.dtype == np.uint16:
                tally.brightest = max(tally.brightest, int(frame.image.max()))
                tally.full_scale = config.full_scale
            yield frame.index, frame.image, corners
        if not tally.counts:
            raise ImageError(f"{str(path)!r} has no frame that can be read")

    def _fit(self, image: GreyImage, config: DetectorConfig) -> None:
        """Make a detector for such images."""
        key = (image.shape, image.dtype, config)
        if key == self._key:
            return
        self.close()
        self._detector = self._kept.enter_context(
            Detector(shape=image.shape, dtype=image.dtype, config=config, device=self._device)
        )
        self._key = key

    def close(self) -> None:
        self._key = None
        self._kept.close()


def _search(tally: _Tally, finder: _Finder, output: _CornerOutput, progress: Progress) -> None:
    """Find the corners of a file, and write them."""
    try:
        for number, image, corners in finder.find(tally):
            output.add(tally, number, image, corners)
            progress.step()
    except ImageError as error:
        tally.failures.append(one_line(error))
    if tally.refused:
        tally.failures.append(f"{shown(tally.path)}: {tally.refused_line()}")


def _tell(tally: _Tally, progress: Progress, *, told: bool) -> None:
    """Say what happened to a file; told: whether an earlier one was said to be dark."""
    name = shown(tally.path)
    if tally.failures:
        progress.say(f"cmp-cl: {'; '.join(tally.failures)}", sys.stderr)
    if tally.broken and tally.counts:
        progress.say(f"cmp-cl: {name}: {tally.broken_line()}", sys.stderr)
    if tally.counts:
        progress.say(f"{name}: {tally.line()}", sys.stdout)
    if tally.is_too_bright():
        progress.say(
            f"cmp-cl: {name}: the brightest pixel is {tally.brightest}, above the full scale of "
            f"{tally.full_scale}: such pixels all look alike",
            sys.stderr,
        )
    if tally.is_dark() and not (told and any(tally.counts)):
        progress.say(f"cmp-cl: {name}: {in_shell(of_few_bits(tally.brightest))}", sys.stderr)


def _frames_in(paths: Sequence[Path]) -> int | None:
    """Return the number of frames, None if no terminal shows progress."""
    if not sys.stderr.isatty():
        return None
    total = 0
    for path in paths:
        with suppress(ImageError, OSError):
            total += media.video_info(path).frames or 1
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
        others = (folder / f"{path.stem}-{number}-corners.png" for number in itertools.count(2))
        while name in names.values():
            name = next(others)
        names[path] = name
    return names


def _of_frame(overlay: Path, path: Path, index: int) -> Path:
    """Return the path of the overlay of one frame of a video, or of one page of an image."""
    if index == 0 and not media.is_video(path):
        return overlay
    return overlay.with_stem(f"{overlay.stem}-{index:06}")
