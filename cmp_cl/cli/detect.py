"""`cmp-cl detect`: the corners of images, folders of images and videos."""

import argparse
import itertools
import os
import statistics
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import add_device, add_full_scale, check_files, grid_shape
from cmp_cl.cli.messages import Progress, counted, in_shell, one_line, shown
from cmp_cl.closing import Closing
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, ImageError
from cmp_cl.files import csv_bytes, whole_file
from cmp_cl.grid import Grid, NodeStatus, build_grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.patterns import of_few_bits
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.viz import corner_overlay, grid_overlay

_CORNER_COLUMNS = (
    *("x_px", "y_px", "pixel_x_px", "pixel_y_px", "response", "method"),
    *("sigma_px", "edge0_rad", "edge1_rad", "edge2_rad", "edge3_rad", "doubtful", "refusal"),
)
_NODE_COLUMNS = ("row", "column", "x_px", "y_px", "sigma_px", "status")


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
        help="number the corners of a pattern of this size; table and picture then show the nodes, "
        "and how each was found",
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
    device = select_device(arguments.device)
    failed = told = False
    with ExitStack() as stack:
        table = None
        if out is not None:
            columns = _CORNER_COLUMNS if arguments.grid is None else _NODE_COLUMNS
            table = _Table(stack.enter_context(whole_file(out)), columns)
        search = stack.enter_context(_Search(arguments, config, device, table))
        progress = stack.enter_context(Progress(_frames_in(paths), "frames"))
        for path in paths:
            found = search.file(path, overlays.get(path), progress)
            failed = failed or bool(found.failures)
            for stream, line in found.lines(hint=not told):
                progress.say(line, stream)
            told = told or bool(found.dark)
        if table is not None and failed and not table.rows:  # an error keeps an older table
            raise ImageError(f"nothing was found, so {shown(out)} is not written")
    if table is not None:
        print(
            f"wrote {shown(out)}: {table.rows} {'corners' if arguments.grid is None else 'nodes'}"
        )
    return 2 if failed else 0


class _Table:
    """Writes rows of frames as CSV: a header with units, then a row for each corner or node.

    columns: the names of the columns after those of the image and the frame. rows: how many were
    written.
    """

    def __init__(self, file: BinaryIO, columns: Sequence[str]) -> None:
        self._file = file
        self.rows = 0
        file.write(csv_bytes([("image", "frame", *columns)]))

    def write(self, name: str, frame: int, rows: Iterable[Sequence[object]]) -> None:
        """Append the rows of one frame; name: the file that holds the frame."""
        full = [(name, frame, *row) for row in rows]
        self._file.write(csv_bytes(full))
        self.rows += len(full)


def _corner_rows(corners: Corners) -> Iterator[Sequence[object]]:
    """Return a row of _CORNER_COLUMNS for every corner."""
    arrays = (
        *(corners.xy, corners.pixel, corners.response, corners.method),
        *(corners.sigma, corners.edges, corners.doubtful, corners.refusal),
    )
    for xy, pixel, response, method, sigma, edges, doubtful, refusal in zip(*arrays, strict=True):
        how, why = Method(method).name, Refusal(refusal).name
        yield (*xy, *pixel, response, how, sigma, *edges, int(doubtful), why)


def _node_rows(grid: Grid) -> Iterator[Sequence[object]]:
    """Return a row of _NODE_COLUMNS for every node; missing positions are NaN."""
    for index in np.ndindex(grid.shape):
        status = NodeStatus(int(grid.status[index])).name
        yield (*index, *grid.xy[index], grid.sigma[index], status)


class _Found:
    """What was found in a file, and what there is to say about it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failures: list[str] = []
        self.corners: list[int] = []  # in each frame
        self.milliseconds: list[float] = []
        self.nodes: list[int] = []
        self.of_nodes = 0
        self.refused: dict[int, str] = {}  # frame to reason
        self.ambiguous: list[int] = []
        self.broken: dict[int, str] = {}  # likewise
        self.overlays: list[Path] = []
        self.brightest = 0
        self.full_scale: int | None = None
        self.device = ""
        self.advice = ""  # of the first frame that gives one

    @property
    def dark(self) -> str:
        """What to do about pixels of 16 bits that seem to be of fewer, as text; "" if none do."""
        return of_few_bits(np.uint16, self.brightest) if self.full_scale is None else ""

    def lines(self, *, hint: bool) -> Iterator[tuple[TextIO, str]]:
        """Yield the lines about the file, each with its stream; hint: about a dark image too."""
        name = shown(self.path)
        for failure in self.failures:
            yield sys.stderr, f"cmp-cl: {failure}"
        if not self.corners:
            return
        if self.broken:
            yield sys.stderr, f"cmp-cl: {name}: {_listed(self.broken, 'left out')}"
        yield sys.stdout, f"{name}: {self._counts()}"
        if self.full_scale is not None and self.brightest > self.full_scale:
            yield (
                sys.stderr,
                f"cmp-cl: {name}: the brightest pixel is {self.brightest}, above the full scale of "
                f"{self.full_scale}: such pixels all look alike",
            )
        if self.advice and not self.dark:
            yield sys.stderr, f"cmp-cl: {name}: {self.advice}"
        if hint and self.dark:
            yield sys.stderr, f"cmp-cl: {name}: {in_shell(self.dark)}"

    def _counts(self) -> str:
        corners, spent = f"{_span(self.corners)} corners", f"{self.milliseconds[0]:.2f} ms"
        if len(self.corners) > 1:
            corners = f"{len(self.corners)} frames, {corners} each,"
            median = statistics.median(self.milliseconds)
            spent = f"{sum(self.milliseconds):.0f} ms, a median of {median:.2f} ms each,"
        line = f"{corners} in {spent} on {self.device}"
        if self.nodes:
            line += f"; {_span(self.nodes)} of {self.of_nodes} nodes"
        if self.ambiguous:
            line += f"; ambiguous numbers in {counted(len(self.ambiguous), 'frame')}: "
            line += f"{_some(self.ambiguous)}, in which too little of the board's border is "
            line += "visible: rows and columns may be shifted or turned"
        if self.overlays:
            last = f" to {shown(self.overlays[-1])}" if len(self.overlays) > 1 else ""
            line += f"; wrote {shown(self.overlays[0])}{last}"
        return line


def _listed(frames: Mapping[int, str], what: str) -> str:
    """Return which frames are not numbered or left out, and why."""
    why = next(filter(None, frames.values()), "")
    return f"{counted(len(frames), 'frame')} {what}: {_some(frames)}{f'; {why}' if why else ''}"


def _some(numbers: Collection[int]) -> str:
    """Return the first of the numbers, as a list."""
    few = ", ".join(map(str, itertools.islice(numbers, 8)))
    return f"{few}, ..." if len(numbers) > 8 else few


def _span(counts: Sequence[int]) -> str:
    least, most = min(counts), max(counts)
    return f"{least}" if least == most else f"{least} to {most}"


class _Search(Closing):
    """Finds, writes and draws the corners of files; keeps its detector as long as it fits them."""

    def __init__(
        self,
        arguments: argparse.Namespace,
        config: DetectorConfig,
        device: Device,
        table: _Table | None,
    ) -> None:
        self._arguments, self._config = arguments, config
        self._device, self._table = device, table
        self._key: object = None
        self._detector: Detector | None = None

    def file(self, path: Path, overlay: Path | None, progress: Progress) -> _Found:
        """Search a file. overlay: the picture to draw of its first frame, or None."""
        found = _Found(path)
        try:
            config = self._config
            if config.full_scale is None:
                config = config.replace(full_scale=media.video_info(path).full_scale)
            for frame in media.read_frames(path):
                progress.step()
                if frame.image is None:
                    found.broken[frame.index] = frame.why
                    continue
                corners = self._corners(found, frame.image, config)
                drawn = self._write(found, frame.index, frame.image, corners)
                if overlay is not None:
                    name = _of_frame(overlay, path, frame.index)
                    media.write_image(name, drawn())
                    found.overlays.append(name)
            if not found.corners:
                raise ImageError(f"{str(path)!r} has no frame that can be read")
        except ImageError as error:
            found.failures.append(one_line(error))
        if found.refused:
            why = _listed(found.refused, "not numbered")
            found.failures.append(f"{shown(path)}: {why}")
        return found

    def _corners(self, found: _Found, image: GreyImage, config: DetectorConfig) -> Corners:
        """Return the corners of a frame, and count them."""
        start = time.perf_counter()
        key = (image.shape, image.dtype, config)
        if self._detector is None or key != self._key:
            self.close()
            self._detector = Detector(
                shape=image.shape, dtype=image.dtype, config=config, device=self._device
            )
            self._key = key
        corners = self._detector(image)
        found.milliseconds.append((time.perf_counter() - start) * 1e3)
        if not found.corners or not (len(corners) or found.advice):
            found.advice = corners.advice(image)
        found.corners.append(len(corners))
        found.device = corners.device
        if image.dtype == np.uint16:
            found.brightest = max(found.brightest, int(image.max()))
            found.full_scale = config.full_scale
        return corners

    def _write(
        self, found: _Found, number: int, image: GreyImage, corners: Corners
    ) -> Callable[[], NDArray[np.uint8]]:
        """Write the rows of a frame; return a function that draws it."""
        rows, drawn = _corner_rows(corners), lambda: corner_overlay(image, corners)
        if self._arguments.grid is not None:
            try:
                grid = build_grid(corners, image, shape=self._arguments.grid)
                if grid.seen_shape is not None or not grid.valid.any():
                    raise GridError(grid.doubts[0])  # which part of a board is wanted, or no board
            except GridError as error:
                found.refused[number] = one_line(error)
                return drawn
            found.ambiguous += [number] if grid.ambiguous else []
            found.nodes.append(int(np.count_nonzero(grid.valid)))
            found.of_nodes = grid.status.size
            rows, drawn = _node_rows(grid), lambda: grid_overlay(image, grid, corners=corners)
        if self._table is not None:
            self._table.write(str(found.path), number, rows)
        return drawn

    def close(self) -> None:
        if self._detector is not None:
            self._detector.close()


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
    if out in ("", "-"):
        raise ConfigError("--out needs a file name, for example corners.csv")
    if out is None:
        return None
    return Path(out) / "corners.csv" if os.path.isdir(out) else Path(out)


def _overlay_paths(overlay: str | None, paths: Sequence[Path]) -> dict[Path, Path]:
    """Return the path of each input's overlay; a missing folder is made."""
    if overlay is None:
        return {}
    folder, suffix = Path(overlay), Path(overlay).suffix.lower()
    if suffix in media.IMAGE_SUFFIXES and not folder.is_dir():
        if len(paths) > 1 or media.is_video(paths[0]):
            what = f"there are {len(paths)} inputs" if len(paths) > 1 else "the input is a video"
            raise ConfigError(
                f"--overlay {shown(overlay)} is one picture, but {what}; name a folder"
            )
        return {paths[0]: folder}
    if not overlay or (suffix and not folder.is_dir()):
        raise ConfigError(
            f"--overlay {shown(overlay)} is neither a folder nor a picture that can be written; "
            "end it in .png"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if any(path.resolve().parent == folder.resolve() for path in paths):
        raise ConfigError(f"--overlay {shown(overlay)} contains inputs; choose another folder")
    names: dict[Path, Path] = {}
    for path in dict.fromkeys(paths):
        stems = (path.stem, *(f"{path.stem}-{number}" for number in range(2, len(paths) + 1)))
        free = (folder / f"{stem}-corners.png" for stem in stems)
        names[path] = next(name for name in free if name not in names.values())
    return names


def _of_frame(overlay: Path, path: Path, index: int) -> Path:
    """Return the path of the overlay of one frame of a video, or of one page of an image."""
    if index == 0 and not media.is_video(path):
        return overlay
    return overlay.with_stem(f"{overlay.stem}-{index:06}")
