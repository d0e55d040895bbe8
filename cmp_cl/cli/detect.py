"""`cmp-cl detect`: the corners of images, folders of images and videos."""

import argparse
import contextlib
import functools
import itertools
import statistics
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import add_device, add_full_scale, check_files, check_suffix, grid_shape
from cmp_cl.cli.messages import Progress, counted, in_shell, one_line, shown
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
        "of a folder, made if missing, that gets a NAME-corners.png of each",
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
    out = arguments.out
    check_suffix("--out", out, ".csv")
    check_files([*paths, arguments.config], [*overlays.values(), out])
    columns = _CORNER_COLUMNS if arguments.grid is None else _NODE_COLUMNS
    device = select_device(arguments.device)
    failed = hinted = False
    rows = 0
    with contextlib.ExitStack() as stack:
        table = None if out is None else stack.enter_context(whole_file(out))
        if table is not None:
            table.write(csv_bytes([("image", "frame", *columns)]))
        progress = stack.enter_context(Progress(None, "frames"))
        for path in paths:
            found = _Found(path)
            try:
                for frame, written in _searched(found, config, device, arguments.grid):
                    progress.step()
                    rows += len(written.rows)
                    if table is not None:
                        table.write(
                            csv_bytes([(str(path), frame.index, *row) for row in written.rows])
                        )
                    if path in overlays:
                        name = _of_frame(overlays[path], path, frame.index)
                        media.write_image(name, written.draw())
                        found.overlays.append(name)
            except ImageError as error:
                found.failures.append(one_line(error))
            found.report(progress, hint=not hinted)
            hinted = hinted or bool(found.dark)
            failed = failed or bool(found.failures)
        if table is not None and failed and not rows:  # an error keeps an older table
            raise ImageError(f"nothing was found, so {shown(out)} is not written")
    if out is not None:
        print(f"wrote {shown(out)}: {rows} {'corners' if arguments.grid is None else 'nodes'}")
    return 2 if failed else 0


@functools.lru_cache(maxsize=1)
def _detector(
    shape: tuple[int, int], dtype: np.dtype[Any], config: DetectorConfig, device: Device
) -> Detector:
    """Return the detector, which is kept as long as images are alike."""
    return Detector(shape=shape, dtype=dtype, config=config, device=device)


class _Written(NamedTuple):
    """A frame for the table, and for its picture."""

    rows: list[Sequence[object]]
    draw: Callable[[], NDArray[np.uint8]]


def _searched(
    found: "_Found",
    config: DetectorConfig,
    device: Device,
    shape: tuple[int, int] | None,
) -> Iterator[tuple[media.Frame, _Written]]:
    """Search the frames of a file; what there is to say goes to `found`. Raises ImageError."""
    if config.full_scale is None:
        config = config.replace(full_scale=media.video_info(found.path).full_scale)
    for frame in media.read_frames(found.path):
        image = frame.image
        if image is None:
            found.broken[frame.index] = frame.why
            continue
        start = time.perf_counter()
        corners = _detector(image.shape, image.dtype, config, device)(image)
        found.add(image, corners, config, 1e3 * (time.perf_counter() - start))
        yield frame, _written(found, frame.index, image, corners, shape)
    if not found.corners:
        raise ImageError(f"{str(found.path)!r} has no frame that can be read")


def _written(
    found: "_Found",
    number: int,
    image: GreyImage,
    corners: Corners,
    shape: tuple[int, int] | None,
) -> _Written:
    """Return the corners of a frame, or its nodes if they are numbered."""
    if shape is None:
        return _Written(_corner_rows(corners), lambda: corner_overlay(image, corners))
    try:
        grid = build_grid(corners, image, shape=shape)
        if grid.seen_shape is not None or not grid.valid.any():
            raise GridError(grid.doubts[0])  # which part of a board is wanted, or no board
    except GridError as error:
        found.refused[number] = one_line(error)
        return _Written([], lambda: corner_overlay(image, corners))
    found.ambiguous += [number] if grid.ambiguous else []
    if grid.others:
        found.doubted[number] = grid.doubts[0]
    found.nodes.append(int(np.count_nonzero(grid.valid)))
    found.of_nodes = grid.status.size
    return _Written(_node_rows(grid), lambda: grid_overlay(image, grid, corners=corners))


def _corner_rows(corners: Corners) -> list[Sequence[object]]:
    """Return a row of _CORNER_COLUMNS for every corner."""
    arrays = (
        *(corners.xy, corners.pixel, corners.response, corners.method),
        *(corners.sigma, corners.edges, corners.doubtful, corners.refusal),
    )
    return [
        (*xy, *pixel, r, Method(how).name, sigma, *edges, int(doubtful), Refusal(why).name)
        for xy, pixel, r, how, sigma, edges, doubtful, why in zip(*arrays, strict=True)
    ]


def _node_rows(grid: Grid) -> list[Sequence[object]]:
    """Return a row of _NODE_COLUMNS for every node; missing positions are NaN."""
    return [
        (*index, *grid.xy[index], grid.sigma[index], NodeStatus(int(status)).name)
        for index, status in np.ndenumerate(grid.status)
    ]


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
        self.doubted: dict[int, str] = {}  # likewise
        self.broken: dict[int, str] = {}  # likewise
        self.overlays: list[Path] = []
        self.darkest, self.brightest = 65535, 0
        self.full_scale: int | None = None
        self.device = ""
        self.advice = ""  # of the first frame that gives one

    def add(
        self, image: GreyImage, corners: Corners, config: DetectorConfig, milliseconds: float
    ) -> None:
        """Count the corners of a frame."""
        if not self.corners or not (len(corners) or self.advice):
            self.advice = corners.advice(image)
        self.corners.append(len(corners))
        self.milliseconds.append(milliseconds)
        self.device = corners.device
        if image.dtype == np.uint16:
            self.darkest = min(self.darkest, int(image.min()))
            self.brightest = max(self.brightest, int(image.max()))
            self.full_scale = config.full_scale

    @property
    def dark(self) -> str:
        """What to do about pixels of 16 bits that seem to be of fewer, as text; "" if none do."""
        levels = self.darkest, self.brightest
        return of_few_bits(np.uint16, *levels) if self.full_scale is None else ""

    def report(self, progress: Progress, *, hint: bool) -> None:
        """Print the lines about the file; hint: about a dark image too."""
        name = shown(self.path)
        if self.refused:
            self.failures.append(f"{name}: {_listed(self.refused, 'not numbered')}")
        for failure in self.failures:
            progress.tell(failure)
        if not self.corners:
            return
        if self.broken:
            progress.tell(f"{name}: {_listed(self.broken, 'left out')}")
        progress.say(f"{name}: {self._counts()}")
        if self.doubted:
            progress.tell(f"{name}: {_listed(self.doubted, 'in doubt')}")
        if self.full_scale is not None and self.brightest > self.full_scale:
            progress.tell(
                f"{name}: the brightest pixel is {self.brightest}, above the full scale of "
                f"{self.full_scale}: such pixels all look alike"
            )
        if self.advice and not self.dark:
            progress.tell(f"{name}: {self.advice}")
        if hint and self.dark:
            progress.tell(f"{name}: {in_shell(self.dark)}")

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


def _overlay_paths(overlay: str | None, paths: Sequence[Path]) -> dict[Path, Path]:
    """Return the path of each input's overlay; a missing folder is made."""
    if overlay is None:
        return {}
    target = Path(overlay)
    if target.suffix.lower() in media.IMAGE_SUFFIXES and not target.is_dir():
        if len(paths) > 1 or media.is_video(paths[0]):
            raise ConfigError(
                f"--overlay {shown(overlay)} is one picture of several: name a folder"
            )
        return {paths[0]: target}
    if target.suffix and not target.is_dir():
        raise ConfigError(f"--overlay {shown(overlay)} is no picture that can be written: use .png")
    target.mkdir(parents=True, exist_ok=True)
    return {path: target / f"{path.stem}-corners.png" for path in paths}


def _of_frame(overlay: Path, path: Path, index: int) -> Path:
    """Return the path of the overlay of one frame of a video, or of one page of an image."""
    if index == 0 and not media.is_video(path):
        return overlay
    return overlay.with_stem(f"{overlay.stem}-{index:06}")
