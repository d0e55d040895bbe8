"""`cmp-cl detect`: find the corners in images, folders of images and videos."""

import argparse
import contextlib
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add,
    add_device,
    add_full_scale,
    check_files,
    check_suffix,
    grid_shape,
)
from cmp_cl.cli.messages import counted, one_line, shown, tell
from cmp_cl.config import DetectorConfig
from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.detector import kept_detector
from cmp_cl.errors import ConfigError, GridError, ImageError
from cmp_cl.files import csv_bytes, whole_file
from cmp_cl.grid import Grid, NodeStatus, build_grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.patterns import check_board
from cmp_cl.media import Frame
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.viz import corner_overlay, grid_overlay

_CORNER_COLUMNS = (
    *("x_px", "y_px", "pixel_x_px", "pixel_y_px", "response", "method"),
    *("sigma_px", "edge0_rad", "edge1_rad", "edge2_rad", "edge3_rad", "doubtful", "refusal"),
)
_NODE_COLUMNS = ("row", "column", "x_px", "y_px", "sigma_px", "status")


DESCRIPTION = """\
Finds the corners of checkerboard-like patterns. Colour becomes grey. One line for each image or
video says how many corners were found, on which device, and in how many milliseconds: from the
image in host memory to the corners, or with --grid the nodes, in host memory, once the kernels are
compiled; of a video the median.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "inputs IMAGE", "image, video or folder", nargs="+")
    what = (
        "write the corners of all inputs to this CSV file; positions in px, (0, 0) is the centre "
        "of the top-left pixel"
    )
    add(parser, "--out CSV", what)
    add(
        parser, "--overlay PNG", "write the image, which is the only input, with its corners marked"
    )
    what = "settings of the detector; default: those of DetectorConfig(), for cells of any size"
    add(parser, "--config TOML", what)
    what = (
        "number the corners of a pattern of this size; table and picture then show the nodes, and "
        "how each was found"
    )
    add(parser, "--grid ROWSxCOLUMNS", what, type=grid_shape)
    add_full_scale(parser)
    add_device(parser)


def run(arguments: argparse.Namespace) -> int:
    config = DetectorConfig() if arguments.config is None else DetectorConfig.load(arguments.config)
    if arguments.full_scale is not None:
        config = config.replace(full_scale=arguments.full_scale)
    paths = media.find_inputs(arguments.inputs)
    out, overlay, shape = arguments.out, arguments.overlay, arguments.grid
    check_suffix("--out", out, ".csv")
    check_suffix("--overlay", overlay, ".png", ".jpg")
    if overlay is not None and (len(paths) > 1 or media.is_video(paths[0])):
        raise ConfigError("--overlay is the picture of one image; give them one by one")
    check_files([*paths, arguments.config], [overlay, out])
    device = select_device(arguments.device)
    failed, count = False, 0
    with contextlib.ExitStack() as stack:
        table = None if out is None else stack.enter_context(whole_file(out))
        if table is not None:
            columns = _CORNER_COLUMNS if shape is None else _NODE_COLUMNS
            table.write(csv_bytes([("image", "frame", *columns)]))
        for path in paths:
            try:
                for index, image, corners, grid in _searched(path, config, shape, device):
                    if overlay is not None and not index:
                        picture = (
                            corner_overlay(image, corners)
                            if grid is None
                            else grid_overlay(image, grid, corners=corners)
                        )
                        media.write_image(overlay, picture)
                        print(f"wrote {shown(overlay)}")
                    if shape is not None and grid is None:
                        failed = True
                        continue
                    rows = _corner_rows(corners) if grid is None else _node_rows(grid)
                    count += len(rows)
                    if table is not None:
                        table.write(csv_bytes([(str(path), index, *row) for row in rows]))
            except ImageError as error:
                tell(one_line(error))
                failed = True
        if table is not None and failed and not count:  # an error keeps an older table
            raise ImageError(f"nothing was found, so {shown(out)} is not written")
    if out is not None:
        print(f"wrote {shown(out)}: {count} {'corners' if shape is None else 'nodes'}")
    return 2 if failed else 0


def _searched(
    path: Path, config: DetectorConfig, shape: tuple[int, int] | None, device: Device
) -> Iterator[tuple[int, GreyImage, Corners, Grid | None]]:
    """Yield each frame of a file that can be read: its number, its image, its corners, and their
    grid if that is one of the shape. Tell what is found in an image, and in all frames of a video.

    Raises ImageError if there is no such frame.
    """
    info, video = media.video_info(path), media.is_video(path)
    if config.full_scale is None:
        config = config.replace(full_scale=info.full_scale)
    broken, advice, doubtful = list[Frame](), "", 0
    counts, times = list[int](), list[float]()  # corners or nodes of each frame, and ms
    for frame in media.read_frames(path):
        image = frame.image
        if image is None:
            broken.append(frame)
            continue
        name = shown(path) if not frame.index else f"{shown(path)}, frame {frame.index}"
        for _ in range(1 if video else 2):  # the first time kernels may have to be compiled
            start = time.perf_counter()
            corners = kept_detector(image.shape, image.dtype, config, device)(image)
            grid, doubts = None, list[str]()
            if shape is not None:
                grid, doubts = _numbered(corners, image, shape, device)
            ms = 1e3 * (time.perf_counter() - start)
        times.append(ms)
        nodes = 0 if grid is None else int(grid.valid.sum())
        counts.append(len(corners) if shape is None else nodes)
        if not video:
            said = f"{len(corners)} corners"
            said += "" if grid is None else f", {nodes} of {grid.valid.size} nodes"
            print(f"{name}: {said} in {ms:.2f} ms on {device}", flush=True)
        if not advice and (len(counts) == 1 or not len(corners)):
            sure = nodes > 0 and not doubts
            advice = corners.advice(image, config.full_scale, numbered=sure)
            doubts += [advice] if advice else []
        if not (video and doubtful):
            for doubt in doubts:
                tell(f"{name}: {doubt}")
        doubtful += bool(doubts)
        yield frame.index, image, corners, grid
    if not counts:
        raise ImageError(f"{str(path)!r} has no frame that can be read")
    if video:
        what = "corners" if shape is None else f"of {shape[0] * shape[1]} nodes"
        print(
            f"{shown(path)}: {counted(len(counts), 'frame')}, {statistics.fmean(counts):.1f} {what}"
            f" on average, at least {min(counts)}, in {statistics.median(times):.2f} ms a frame on "
            f"{device}"
        )
    if video and doubtful > 1:
        further = counted(doubtful - 1, "further frame")
        tell(f"{shown(path)}: there are doubts about {further} too")
    if broken:
        left_out = f"{counted(len(broken), 'frame')} left out, the first is {broken[0].index}"
        why = next((f": {frame.why}" for frame in broken if frame.why), "")
        tell(f"{shown(path)}: {left_out}{why}")


def _numbered(
    corners: Corners, image: GreyImage, shape: tuple[int, int], device: Device
) -> tuple[Grid | None, list[str]]:
    """Return the grid of the corners, None if they are no pattern of the shape, and the doubts."""
    try:
        grid = build_grid(corners, image, shape=shape, device=device)
        check_board(grid)
    except GridError as error:
        return None, [f"not numbered: {one_line(error)}"]
    return grid, grid.doubts


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
