"""`cmp-cl tune`: the cost and the gain of each stage of the detector on the user's own frames."""

import argparse
import contextlib
import dataclasses
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_max_pixels,
    add_region,
    add_split,
    check_files,
    check_suffix,
    grid_shape,
    regions_in,
    split_of,
    views_of,
    whole,
)
from cmp_cl.cli.messages import counted, one_line, shown, tell_what_opencv_hides
from cmp_cl.cli.progress import Progress
from cmp_cl.config import (
    BinaryRings,
    DetectorConfig,
    EdgeLines,
    Midlines,
    RingHarmonic,
)
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError, GridError, ImageError
from cmp_cl.grid import Grid
from cmp_cl.grid.predict import predict
from cmp_cl.image import GreyImage
from cmp_cl.measure import Region, cell_of, exact_config, find_pattern
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.synthetic import scoring

Change = Callable[[DetectorConfig], DetectorConfig]

FULL = "everything"
STRONG = 8.0  # weight of a prediction from both sides
WIDTH = 28
MOST_VIEWS = 8  # the most that are measured, spread over all that are given
ROUNDS = 5  # runs of each configuration on each view
WORTHWHILE = 0.97  # the largest share of the time after a change that is worth making
ROUGHER = 1.02  # the largest ratio of two roughnesses that count as equal


def add_parser(commands: Any) -> None:
    """Add `tune` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "tune",
        help="find the fastest settings that lose nothing on your own frames",
        description="Measures, on your frames, how long each optional stage of the detector takes "
        "and how many corners it gains; prints a table; and writes the fastest "
        "settings that find as much as the most complete ones. Missed corners are "
        "counted against --grid. Extra corners are detections where the grid of the "
        "most complete settings has no node. Roughness is the RMS distance of the "
        "corners from the positions that their neighbours in the grid predict: a "
        "smaller one means a more accurate refinement.",
    )
    parser.add_argument(
        "frames", nargs="+", metavar="FRAME", help="images, folders or videos, all of one size"
    )
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        required=True,
        help="rows and columns of corners of the pattern in each view",
    )
    parser.add_argument(
        "--out", metavar="TOML", default="cmp.toml", help="the settings to write; default: cmp.toml"
    )
    add_split(
        parser,
        help_="for frames that show two views: halves, or "
        "X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, left and right, px",
    )
    add_region(
        parser,
        help_="which of several patterns to use: X,Y,WIDTH,HEIGHT, px of the frame, or with "
        "--split X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, in the left and in the right view; corners "
        "outside are ignored in every frame",
    )
    add_full_scale(parser)
    add_max_pixels(parser)
    add_device(parser)
    parser.set_defaults(run=run)


class Frame(NamedTuple):
    """A view, its reference grid, and the regions in which detections do not count.

    ignored: (K, 2) points, px; detections near them do not count. region: (x0, y0, x1, y1), px;
    detections outside do not count. None is the whole view.
    """

    image: GreyImage
    grid: Grid
    cell: float
    ignored: NDArray[np.float64]
    region: Region | None = None


class Row(NamedTuple):
    """The results of a configuration over all frames, and its median time for one, ms."""

    name: str
    config: DetectorConfig
    missed: int
    extra: int
    roughness: float
    ms: float

    def loses(self, full: "Row") -> str:
        """Return its losses against the most complete row `full` as text; "" if it has none."""
        lost = []
        if self.missed > full.missed:
            lost.append("corners")
        if self.extra > full.extra:
            lost.append("certainty")
        if not self.roughness <= ROUGHER * full.roughness:
            lost.append("exactness")
        if self.config.refinement is None:
            lost.append("the grid")
        return ", ".join(lost)


def changes(full: DetectorConfig, cell: float) -> dict[str, Change]:
    """Return, by name, the ways to leave out or replace one stage of a configuration.

    full: the most complete configuration. cell: side of a cell, px.
    """
    found: dict[str, Change] = {
        "binary rings": lambda c: c.replace(detection=BinaryRings.for_cell(cell)),
        "no alignment check": lambda c: _harmonic(c, alignment=None),
        "no support check": lambda c: _harmonic(c, support=None),
        "EdgeLines": lambda c: c.replace(refinement=EdgeLines()),
        "Midlines": lambda c: c.replace(refinement=Midlines()),
        "no refinement": lambda c: c.replace(refinement=None),
    }
    if isinstance(full.detection, RingHarmonic) and full.detection.fine:
        found["no squeezed cells"] = lambda c: _harmonic(c, fine=False)
    if full.scale is not None:
        found["full size"] = lambda c: c.replace(scale=None)
    return found


def _harmonic(config: DetectorConfig, **changes: Any) -> DetectorConfig:
    """Return the configuration with changes to its RingHarmonic, if it has one."""
    if not isinstance(config.detection, RingHarmonic):
        return config
    return config.replace(detection=dataclasses.replace(config.detection, **changes))


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if arguments.split is None and arguments.mirror is not None:
        raise ConfigError("--mirror needs --split")
    check_suffix("--out", arguments.out, ".toml")
    paths = media.find_inputs(arguments.frames)
    check_files(paths, [arguments.out])
    tell_what_opencv_hides(paths)
    device = select_device(arguments.device)
    views = _views(arguments)
    full, frames = _reference(views, arguments.grid, device, arguments.full_scale)
    rows, columns = frames[0].image.shape
    total = len(frames) * arguments.grid[0] * arguments.grid[1]
    print(
        f"{counted(len(frames), 'view')} of {columns} x {rows} px, cells of "
        f"{frames[0].cell:.1f} px, {total} corners in all, on {device}"
    )
    ways = changes(full, frames[0].cell)
    with Progress(None, "configurations") as progress:
        named = {FULL: full, **{name: change(full) for name, change in ways.items()}}
        table = measure(named, frames, device, progress)
        chosen = cheapest(table, ways, frames, device, progress)
    print(f"{'settings':{WIDTH}}{'missed':>8}{'extra':>7}{'rough, px':>11}{'ms':>8}  loses")
    for row in table:
        print(_line(row, table[0]))
    print("the fastest settings that lose nothing:")
    print(_line(chosen, table[0]))
    chosen.config.save(arguments.out)
    print(f"wrote {shown(arguments.out)}")
    return 0


def _line(row: Row, full: Row) -> str:
    return (
        f"{row.name:{WIDTH}}{row.missed:8}{row.extra:7}{row.roughness:11.3f}{row.ms:8.2f}  "
        f"{row.loses(full) or '-'}"
    )


def _views(arguments: argparse.Namespace) -> list[tuple[GreyImage, Region | None]]:
    """Return at most MOST_VIEWS of the given views, spread over all of them.

    Raises ImageError if their sizes or types differ.
    """
    kept: list[tuple[GreyImage, Region | None]] = []
    step = 1
    for number, (view, region) in enumerate(_every_view(arguments)):
        first = kept[0][0] if kept else view
        if view.shape != first.shape or view.dtype != first.dtype:
            raise ImageError(
                f"views of {view.shape} {view.dtype} and {first.shape} {first.dtype}: "
                "give frames of one size and type"
            )
        if number % step == 0:
            kept.append((view, region))
        if len(kept) == 2 * MOST_VIEWS:
            kept, step = kept[::2], 2 * step
    chosen = np.linspace(0, len(kept) - 1, min(len(kept), MOST_VIEWS)).round().astype(int)
    return [kept[index] for index in chosen]


def _every_view(arguments: argparse.Namespace) -> Iterator[tuple[GreyImage, Region | None]]:
    for path in media.find_inputs(arguments.frames):
        for frame in media.read_frames(path, max_pixels=arguments.max_pixels):
            if frame.image is None:
                continue
            if arguments.split is None:
                (region,) = regions_in(arguments.region, whole(frame.image))
                yield frame.image, region
            else:
                split = split_of(arguments.split, arguments.mirror, frame.image.shape)
                regions = regions_in(arguments.region, *views_of(split))
                yield from zip(split(frame.image), regions, strict=True)


def _reference(
    views: Sequence[tuple[GreyImage, Region | None]],
    shape: tuple[int, int],
    device: Device,
    full_scale: int | None,
) -> tuple[DetectorConfig, list[Frame]]:
    """Return the most complete configuration, and the views in which it finds the pattern."""
    cells = []
    why = "there is no frame that can be read"
    for view, region in views:
        try:
            cell, _ = find_pattern(
                view, shape=shape, region=region, full_scale=full_scale, device=device
            )
            cells.append(cell)
        except GridError as error:
            why = one_line(error)
    if not cells:
        raise GridError(f"no frame shows the pattern: {why}")
    config = exact_config(float(np.median(cells)), full_scale)
    frames = []
    first = views[0][0]
    with Detector(shape=first.shape, dtype=first.dtype, config=config, device=device) as detector:
        for view, region in views:
            try:
                grid = detector.grid(view, shape=shape, region=region)[1]
            except GridError:
                continue
            if grid.valid.any():
                frames.append(Frame(view, grid, cell_of(grid), around(grid), region))
    if not frames:
        raise GridError("even with the most complete settings, no frame shows the pattern")
    if len(frames) < len(views):
        print(
            f"cmp-cl: {len(views) - len(frames)} views without the pattern are left out",
            file=sys.stderr,
        )
    return config, frames


def around(grid: Grid) -> NDArray[np.float64]:
    """Return the points where cell edges meet the surround, one cell beyond the grid, (K, 2) px."""
    xy = grid.xy.astype(np.float64)
    for axis in (0, 1):
        lines = np.moveaxis(xy, axis, 0)
        before, after = 2 * lines[:1] - lines[1:2], 2 * lines[-1:] - lines[-2:-1]
        xy = np.moveaxis(np.concatenate([before, lines, after]), 0, axis)
    outer = np.ones(xy.shape[:2], np.bool_)
    outer[1:-1, 1:-1] = False
    points = xy[outer]
    return points[np.isfinite(points).all(axis=1)]


def measure(
    configs: Mapping[str, DetectorConfig],
    frames: Sequence[Frame],
    device: Device,
    progress: Progress,
) -> list[Row]:
    """Run every configuration on every frame, timed in turns; the first turn is not timed."""
    image = frames[0].image
    times: dict[str, list[float]] = {name: [] for name in configs}
    answers: dict[str, list[tuple[int, int, NDArray[np.float64]]]] = {}
    with contextlib.ExitStack() as stack:
        detectors = {}
        for name, config in configs.items():
            detectors[name] = stack.enter_context(
                Detector(shape=image.shape, dtype=image.dtype, config=config, device=device)
            )
            answers[name] = [judge(detectors[name](frame.image).xy, frame) for frame in frames]
            progress.step()
        for _ in range(ROUNDS):
            for name, detector in detectors.items():
                for frame in frames:
                    start = time.perf_counter()
                    detector(frame.image)
                    times[name].append((time.perf_counter() - start) * 1e3)
    rows = []
    for name, config in configs.items():
        missed, extra, off = zip(*answers[name], strict=True)
        every = np.concatenate(off)
        roughness = float(np.sqrt(np.mean(every**2))) if len(every) else float("nan")
        ms = statistics.median(times[name])
        rows.append(Row(name, config, sum(missed), sum(extra), roughness, ms))
    return rows


def judge(xy: NDArray[np.float32], frame: Frame) -> tuple[int, int, NDArray[np.float64]]:
    """Count the missed and the extra corners of a frame; return the others' distances, (K,) px.

    xy: (N, 2) detections, px. A distance is from the position that the neighbours predict.
    """
    if frame.region is not None:
        low, high = frame.region[:2], frame.region[2:]
        xy = xy[((xy >= low) & (xy <= high)).all(axis=1)]
    valid = frame.grid.valid
    index = np.argwhere(valid)
    partner = scoring.match(xy, frame.grid.xy[valid], scoring.reach(frame.cell))
    hit = partner >= 0
    rest = xy[~hit].astype(np.float64)
    away = np.linalg.norm(rest[:, None] - frame.ignored, axis=2)
    extra = int(np.count_nonzero(away.min(axis=1, initial=np.inf) > frame.cell / 2))
    at = np.full(valid.shape, complex(np.nan, np.nan))
    row, column = index[partner[hit]].T
    at[row, column] = xy[hit, 0] + 1j * xy[hit, 1]
    predicted, weight = predict(at, row, column)
    off = np.abs(at[row, column] - predicted)[weight >= STRONG]
    return valid.size - int(np.count_nonzero(hit)), extra, off


def cheapest(
    table: Sequence[Row],
    ways: Mapping[str, Change],
    frames: Sequence[Frame],
    device: Device,
    progress: Progress,
) -> Row:
    """Return the most complete row with every change that saves time and loses nothing.

    The changes are added in the order of the time that each saves alone. Each is measured beside
    the settings without it.
    """
    full = table[0]
    good = [row for row in table[1:] if not row.loses(full) and row.ms < WORTHWHILE * full.ms]
    current = full
    for row in sorted(good, key=lambda row: row.ms):
        config = ways[row.name](current.config)
        name = row.name if current.name == FULL else f"{current.name}, {row.name}"
        before, after = measure(
            {current.name: current.config, name: config}, frames, device, progress
        )
        if not after.loses(full) and after.ms < WORTHWHILE * before.ms:
            current = after
    return current
