"""`cmp-cl detect`: the corners of images, folders of images and videos."""

import argparse
import contextlib
import dataclasses
import functools
import itertools
import statistics
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

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
    out, shape = arguments.out, arguments.grid
    check_suffix("--out", out, ".csv")
    check_files([*paths, arguments.config], [*overlays.values(), out])
    device = select_device(arguments.device)
    failed, count = False, 0
    with contextlib.ExitStack() as stack:
        table = None if out is None else stack.enter_context(whole_file(out))
        if table is not None:
            columns = _CORNER_COLUMNS if shape is None else _NODE_COLUMNS
            table.write(csv_bytes([("image", "frame", *columns)]))
        progress = stack.enter_context(Progress(None, "frames"))
        for path in paths:
            found = _Found(path, device)
            try:
                for index, image, corners, grid in _searched(found, config, shape):
                    progress.step()
                    rows = _node_rows(grid) if shape else _corner_rows(corners)
                    count += len(rows)
                    if table is not None:
                        table.write(csv_bytes([(str(path), index, *row) for row in rows]))
                    if path in overlays:
                        found.overlays.append(_of_frame(overlays[path], path, index))
                        media.write_image(found.overlays[-1], _picture(image, corners, grid))
            except ImageError as error:
                progress.tell(one_line(error))
                failed = True
            found.report(progress)
            failed = failed or bool(found.refused)
        if table is not None and failed and not count:  # an error keeps an older table
            raise ImageError(f"nothing was found, so {shown(out)} is not written")
    if out is not None:
        print(f"wrote {shown(out)}: {count} {'corners' if shape is None else 'nodes'}")
    return 2 if failed else 0


@functools.lru_cache(maxsize=1)
def _detector(
    shape: tuple[int, int], dtype: np.dtype[Any], config: DetectorConfig, device: Device
) -> Detector:
    """Return the detector, which is kept as long as images are alike."""
    return Detector(shape=shape, dtype=dtype, config=config, device=device)


def _searched(
    found: "_Found", config: DetectorConfig, shape: tuple[int, int] | None
) -> Iterator[tuple[int, GreyImage, Corners, Grid | None]]:
    """Yield the number of each frame of a file, its image, its corners, and their grid if there is
    one of that shape; what there is to say goes to `found`. Raises ImageError."""
    if config.full_scale is None:
        config = config.replace(full_scale=media.video_info(found.path).full_scale)
    found.full_scale = config.full_scale
    for frame in media.read_frames(found.path):
        image = frame.image
        if image is None:
            found.broken[frame.index] = frame.why
            continue
        start = time.perf_counter()
        corners = _detector(image.shape, image.dtype, config, found.device)(image)
        found.add(image, corners, 1e3 * (time.perf_counter() - start))
        grid = None if shape is None else found.numbered(frame.index, image, corners, shape)
        yield frame.index, image, corners, grid
    if not found.corners:
        raise ImageError(f"{str(found.path)!r} has no frame that can be read")


def _picture(image: GreyImage, corners: Corners, grid: Grid | None) -> NDArray[np.uint8]:
    if grid is None:
        return corner_overlay(image, corners)
    return grid_overlay(image, grid, corners=corners)


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


def _node_rows(grid: Grid | None) -> list[Sequence[object]]:
    """Return a row of _NODE_COLUMNS for every node; missing positions are NaN."""
    if grid is None:
        return []
    return [
        (*index, *grid.xy[index], grid.sigma[index], NodeStatus(int(status)).name)
        for index, status in np.ndenumerate(grid.status)
    ]


@dataclasses.dataclass
class _Found:
    """What was found in the frames of a file. Mappings are from frames to reasons."""

    path: Path
    device: Device
    full_scale: int | None = None
    corners: list[int] = dataclasses.field(default_factory=list)  # in each frame
    milliseconds: list[float] = dataclasses.field(default_factory=list)
    nodes: list[int] = dataclasses.field(default_factory=list)
    of_nodes: int = 0
    ambiguous: list[int] = dataclasses.field(default_factory=list)
    broken: dict[int, str] = dataclasses.field(default_factory=dict)
    refused: dict[int, str] = dataclasses.field(default_factory=dict)
    doubted: dict[int, str] = dataclasses.field(default_factory=dict)
    overlays: list[Path] = dataclasses.field(default_factory=list)
    darkest: int = 65535  # of 16 bits
    brightest: int = 0
    advice: str = ""  # of the first frame that gives one

    def add(self, image: GreyImage, corners: Corners, milliseconds: float) -> None:
        """Count the corners of a frame."""
        if not self.corners or not (len(corners) or self.advice):
            self.advice = corners.advice(image)
        self.corners.append(len(corners))
        self.milliseconds.append(milliseconds)
        if image.dtype == np.uint16:
            self.darkest = min(self.darkest, int(image.min()))
            self.brightest = max(self.brightest, int(image.max()))

    def numbered(
        self, index: int, image: GreyImage, corners: Corners, shape: tuple[int, int]
    ) -> Grid | None:
        """Return the grid of a frame, and count its nodes; None if it is refused."""
        try:
            grid = build_grid(corners, image, shape=shape)
            if grid.seen_shape is not None or not grid.valid.any():
                raise GridError(grid.doubts[0])  # which part of a board is wanted, or no board
        except GridError as error:
            self.refused[index] = one_line(error)
            return None
        self.ambiguous += [index] if grid.ambiguous else []
        if grid.others:
            self.doubted[index] = grid.doubts[0]
        self.nodes.append(int(np.count_nonzero(grid.valid)))
        self.of_nodes = grid.status.size
        return grid

    def report(self, progress: Progress) -> None:
        """Print the lines about the file."""
        name = shown(self.path)
        for frames, what in ((self.refused, "not numbered"), (self.broken, "left out")):
            if frames and self.corners:
                progress.tell(f"{name}: {_listed(frames, what)}")
        if self.corners:
            progress.say(f"{name}: {self._counts()}")
        if self.doubted:
            progress.tell(f"{name}: {_listed(self.doubted, 'in doubt')}")
        advice = self.advice
        if self.full_scale is None:
            advice = of_few_bits(np.uint16, self.darkest, self.brightest) or advice
        elif self.brightest > self.full_scale:
            progress.tell(
                f"{name}: the brightest pixel is {self.brightest}, above the full scale of "
                f"{self.full_scale}: such pixels all look alike"
            )
        if advice:
            progress.tell(f"{name}: {in_shell(advice)}")

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
