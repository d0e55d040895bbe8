"""`cmp-cl run`: a recording or a live camera to the series of its deformation fields."""

import argparse
import contextlib
import dataclasses
import re
import sys
import time
from pathlib import Path
from typing import Any, Self

from cmp_cl.cameras import CameraSettings, Source
from cmp_cl.cli import derived, display
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_region,
    add_split,
    check_files,
    check_suffix,
    grid_shape,
    positive_number,
    regions_in,
    split_of,
    views_of,
    whole,
)
from cmp_cl.cli.messages import counted, one_line, shown
from cmp_cl.cli.progress import Progress
from cmp_cl.cli.sources import PAIR_WITHIN, Pairs, at_rest, because
from cmp_cl.cli.stopping import Stop, handled, ignore
from cmp_cl.config import DetectorConfig
from cmp_cl.errors import CmpClError, ConfigError, GridError
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.media import Frame
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.series import SERIES_SUFFIXES, Description, SeriesWriter
from cmp_cl.space import StereoRig

_LINES_OF_BROKEN = 8  # broken frames that are reported one by one; the others are only counted


def add_parser(commands: Any) -> None:
    """Add `run` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "run",
        help="measure the deformation in every frame of a recording or of a live camera",
        description="Numbers the corners of the pattern in every frame as in the frame at rest, "
        "and writes their displacements as a series: in the image, or with --stereo in space. "
        "Frames that cannot be read, or that a camera misses, are left out and counted; in frames "
        "without the pattern all nodes are missing. Ctrl-C ends the run and saves what has been "
        "measured.",
    )
    group = parser.add_argument_group("input")
    group.add_argument(
        "source",
        metavar="SOURCE",
        nargs="?",
        help="video, folder of images, image, .mcap, number of a camera, device such as "
        "/dev/video0, or address such as rtsp://camera/stream",
    )
    group.add_argument(
        "--stereo",
        metavar="YAML",
        help="the calibration of two views; SOURCE shows both in each frame",
    )
    group.add_argument(
        "--left", metavar="SOURCE", help="with --stereo: the left view, in place of SOURCE"
    )
    group.add_argument("--right", metavar="SOURCE", help="the right view")
    group.add_argument(
        "--rest-frame",
        metavar="N",
        type=int,
        default=0,
        help="number of the frame at rest, from 0; a camera's frames before it are dropped",
    )
    group = parser.add_argument_group("pattern")
    group.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        help="rows and columns of its corners; default: those seen at rest",
    )
    add_region(
        group,
        help_="which of several patterns: X,Y,WIDTH,HEIGHT, px of the frame; with --stereo two "
        "of them with a colon between, left and right",
    )
    group.add_argument(
        "--track",
        action="store_true",
        help="where no border of the pattern is in view, continue the numbers of the previous "
        "frame; it must move by less than half a cell from frame to frame, and from rest to the "
        "first one",
    )
    group = parser.add_argument_group("output")
    group.add_argument(
        "--out",
        metavar="FILE",
        required=True,
        help="the series: .npz, .h5, .csv, .pvd (ParaView), .mcap (ROS 2), or - for JSON lines on "
        "standard output; until it is complete, and after a kill, it is FILE.part",
    )
    derived.add_arguments(group)
    display.add_arguments(parser.add_argument_group("pictures"))
    group = parser.add_argument_group("speed")
    add_device(group)
    group = parser.add_argument_group("settings of a camera, a device or an address")
    group.add_argument(
        "--camera-size", metavar="WIDTHxHEIGHT", type=_camera_size, help="size of the frames, px"
    )
    group.add_argument(
        "--camera-fps", metavar="FPS", type=positive_number, help="frames per second"
    )
    group.add_argument(
        "--exposure", metavar="VALUE", type=float, help="exposure time, in the driver's units"
    )
    group.add_argument(
        "--pixel-format", metavar="FOUR", help="four letters, such as GREY, MJPG, YUYV"
    )
    group = parser.add_argument_group("rarely needed")
    add_split(
        group,
        help_="where the two views are in the frame: halves (the default), or "
        "X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, left and right, px",
    )
    group.add_argument(
        "--pair-within",
        metavar="MS",
        type=float,
        help="largest time between the frames of --left and --right that are paired, ms; default: "
        f"half the interval between frames, or {PAIR_WITHIN:g} if that is unknown",
    )
    group.add_argument("--raw", action="store_true", help="do not apply the lattice filter")
    group.add_argument("--config", metavar="TOML", help="settings of the detector")
    add_full_scale(group)
    parser.epilog = "docs/formats.md lists the arrays of a series."
    parser.set_defaults(run=run)


def _camera_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(match[1]), int(match[2])


class _Tally:
    """The counts of the measured frames, for the line at the end."""

    def __init__(self) -> None:
        self.frames = self.empty = self.broken = self.ambiguous = 0
        self._nodes = 0
        self._fewest: int | None = None
        self._ms = 0.0
        self._largest, self._where = 0.0, 0

    def add(self, number: int, measured: Measured, ms: float) -> None:
        self.frames += 1
        self._ms += ms
        if not measured.nodes:
            self.empty += 1
            return
        self.ambiguous += measured.ambiguous
        self._nodes += measured.nodes
        self._fewest = min(measured.nodes, self._fewest or measured.nodes)
        if measured.largest > self._largest:
            self._largest, self._where = measured.largest, number

    def line(self, nodes: int, unit: str, device: str) -> str:
        """Return the line. nodes: of the pattern. unit: of the displacement. device: its name."""
        parts = [counted(self.frames, "frame")]
        if self._fewest is not None:
            mean = self._nodes / (self.frames - self.empty)
            parts.append(f"{mean:.1f} of {nodes} nodes on average, at least {self._fewest}")
            parts.append(f"moved by up to {self._largest:.3g} {unit} (frame {self._where})")
        if self.empty:
            parts.append(f"{self.empty} without the pattern")
        if self.ambiguous:
            parts.append(f"{self.ambiguous} whose numbers may be wrong")
        if self.broken:
            parts.append(f"{self.broken} left out")
        if self.frames:
            parts.append(f"{self._ms / self.frames:.0f} ms each on {device}")
        return "; ".join(parts)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Settings:
    """The arguments, checked, and what they name, loaded."""

    arguments: argparse.Namespace
    source: Source | Pairs
    device: Device
    config: DetectorConfig | None
    rig: StereoRig | None

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> Self:
        if arguments.rest_frame < 0:
            raise ConfigError(f"--rest-frame must be 0 or more, not {arguments.rest_frame}")
        _check_source(arguments)
        derived.check(arguments)
        if arguments.stereo is None and (arguments.split or arguments.mirror):
            raise ConfigError("--split and --mirror need --stereo")
        out = None if arguments.out == "-" else arguments.out
        check_suffix("--out", out, *SERIES_SUFFIXES)
        if out is None and sys.__stdout__ is None:
            raise ConfigError("--out - needs standard output, which is closed")
        display.check(arguments)
        config = None if arguments.config is None else DetectorConfig.load(arguments.config)
        rig = None if arguments.stereo is None else StereoRig.load(arguments.stereo)
        device = select_device(arguments.device)
        source = _source(arguments)
        check_files(
            [*source.paths, arguments.config, arguments.stereo],
            [out, *display.outputs(arguments)],
        )
        return cls(arguments=arguments, source=source, device=device, config=config, rig=rig)

    def description(self, unit: str) -> Description:
        """Return the description that is stored in the series; unit: of the lengths."""
        lengths = [raw + name for raw in ("", "raw_") for name in ("rest", "displacement", "sigma")]
        views = ("xy",) if self.rig is None else ("left", "right")
        pixels = [view + when for view in views for when in ("", "_rest")]
        units = {
            **dict.fromkeys(lengths, unit),
            **dict.fromkeys(pixels, "px"),
            **derived.units(unit),
        }
        settings = {
            "source": self.source.name,
            "rest_frame": str(self.arguments.rest_frame),
            "device": str(self.device),
            "configuration": repr(self.config) if self.config else "for the cells seen at rest",
        }
        if self.source.start_ns is not None:
            settings["start_ns"] = str(self.source.start_ns)
        return Description(units=units, settings=settings)

    def measurement(self, rest: GreyImage) -> OneView | TwoViews:
        """Return the measurement of frames against this frame at rest.

        Raises GridError if it shows no pattern.
        """
        asked, hint = self.arguments, ""
        full_scale = asked.full_scale
        if full_scale is None and (self.config is None or self.config.full_scale is None):
            full_scale = self.source.full_scale
        search: Any = {
            "shape": asked.grid,
            "config": self.config,
            "full_scale": full_scale,
            "device": self.device,
            "track": asked.track,
            "raw": asked.raw,
            "strain": asked.strain,
        }
        try:
            if self.rig is None:
                hint = "; --region picks one of several patterns; frames of two views need --stereo"
                (region,) = regions_in(asked.region, whole(rest))
                if asked.cell is not None:
                    search |= {"cell": asked.cell, "unit": asked.unit or "mm"}
                return OneView(rest, region=region, **search)
            split = split_of(asked.split or "halves", asked.mirror, rest.shape)
            one, two = views_of(split)
            if isinstance(self.source, Pairs):  # regions are in the two frames
                two = ((0, 0, *two[0][2:]), two[1])
            left, right = regions_in(asked.region, one, two)
            return TwoViews(rest, self.rig, split, regions=(left, right), **search)
        except GridError as error:
            raise GridError(
                f"frame {asked.rest_frame}, the frame at rest: {error}{hint}"
            ) from error


def _source(arguments: argparse.Namespace) -> Source | Pairs:
    """Open the source; raises ConfigError if camera settings are given for a file."""
    camera = CameraSettings(
        size=arguments.camera_size,
        fps=arguments.camera_fps,
        exposure=arguments.exposure,
        fourcc=arguments.pixel_format,
    )
    source: Source | Pairs
    if arguments.left is not None:
        source = Pairs(arguments, camera)
    else:
        source = Source(arguments.source, camera, from_start=True)
    if camera != CameraSettings() and not source.live:
        raise ConfigError(f"{shown(source.name)} is not a camera, so it takes no camera settings")
    return source


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    settings = _Settings.of(arguments)
    source = settings.source
    rest, frames = at_rest(source, arguments.rest_frame)
    tally, stop = _Tally(), Stop()
    ended: Exception | None = None  # what ended the run before its last frame
    with contextlib.ExitStack() as stack:
        stack.enter_context(handled(stop))
        measure = settings.measurement(rest)
        stack.enter_context(measure)
        _tell_doubts(arguments.rest_frame, measure)
        pictures = stack.enter_context(
            display.Display(arguments, measure.constants["rest"], measure.unit, source.period_ms)
        )
        description = settings.description(measure.unit)
        constants = measure.constants | derived.constants(arguments)
        series = stack.enter_context(
            SeriesWriter(arguments.out, description=description, **constants)
        )
        _tell_earlier(series.earlier)
        stack.callback(ignore)  # no signal stops the closing of the series
        progress = stack.enter_context(Progress(source.total, "frames"))
        try:
            for frame in stack.enter_context(contextlib.closing(frames)):
                if stop.name:
                    break
                progress.step()
                image = frame.image
                if image is None or (image.shape, image.dtype) != (rest.shape, rest.dtype):
                    tally.broken += 1
                    measure.skip()
                    if tally.broken <= _LINES_OF_BROKEN:
                        progress.say(
                            f"cmp-cl: {_why_broken(frame, rest, live=source.live)}", sys.stderr
                        )
                    continue
                start = time.perf_counter()
                measured = measure(image)
                arrays = derived.arrays_of(measured, arguments)
                spent = (time.perf_counter() - start) * 1e3
                if frame.index == arguments.rest_frame:  # the numbers are those of this frame
                    measured = dataclasses.replace(measured, ambiguous=False)
                series.append(
                    index=frame.index,
                    time_ms=frame.time_ms,
                    ambiguous=measured.ambiguous,
                    **arrays,
                )
                tally.add(frame.index, measured, spent)
                pictures.frame(frame, measured)
        except (CmpClError, OSError) as error:
            if isinstance(error, BrokenPipeError) or not tally.frames:
                raise  # the reader of a pipe has gone, or there is nothing to keep
            ended = error
        if stop.name and not tally.frames:  # an older series stays
            raise KeyboardInterrupt
    report = sys.stderr if arguments.out == "-" else sys.stdout
    stopped = f"stopped by {stop.name}; " if stop.name else ""
    line = tally.line(measure.nodes, measure.unit, str(settings.device))
    alone = source.alone() if isinstance(source, Pairs) else ""
    print(f"{stopped}wrote {shown(arguments.out)}: {line}{alone}", file=report)
    for written in display.outputs(arguments):
        if written is not None and tally.frames and pictures.error is None:
            print(f"wrote {shown(written)}", file=report)
    if tally.ambiguous:
        print(f"cmp-cl: {_about_ambiguous(tally.ambiguous, arguments)}", file=sys.stderr)
    failed = [error for error in (ended, pictures.error) if error is not None]
    if failed:
        print(f"cmp-cl: {'; '.join(map(one_line, failed))}", file=sys.stderr)
        return 2
    return 130 if stop.name and not source.live else 0


def _about_ambiguous(count: int, arguments: argparse.Namespace) -> str:
    """Return what it means that the numbering of so many frames is ambiguous, and what to do."""
    cure = "show a border of the pattern in every frame"
    if not arguments.track:
        cure += (
            ", or give --track if it moves by less than half a cell from frame to frame, which "
            "continues the numbers of the frame before"
        )
    return (
        f"in {counted(count, 'frame')} no border of the pattern decides which node is which: all "
        "displacements of such a frame may be wrong by whole cells, so trust none of them (the "
        f"array `ambiguous` says which frames); {cure}"
    )


def _tell_earlier(parts: list[Path]) -> None:
    """Print which parts of a series an earlier run has left."""
    for part in parts:
        print(
            f"cmp-cl: {shown(part)} is of a run that was killed, or that still goes on, and is "
            "kept: it holds all frames up to then; delete it if you need none of them",
            file=sys.stderr,
        )


def _tell_doubts(number: int, measure: OneView | TwoViews) -> None:
    """Print the doubts about the frame at rest, whose number that is."""
    if isinstance(measure, OneView):
        views = {"": measure.rest_grid}
    else:
        views = dict(zip(("the left view: ", "the right view: "), measure.rest_grids, strict=True))
    for view, grid in views.items():
        for doubt in grid.doubts:
            print(f"cmp-cl: frame {number}, the frame at rest: {view}{doubt}", file=sys.stderr)


def _why_broken(frame: Frame, rest: GreyImage, *, live: bool) -> str:
    if frame.image is None and live:
        return (
            f"frame {frame.index} is missing: the camera did not deliver it, or frames come faster "
            "than they are measured"
        )
    if frame.image is None:
        return f"frame {frame.index} cannot be read and is skipped{because(frame)}"
    rows, columns = frame.image.shape
    return (
        f"frame {frame.index} is {columns} x {rows} px of {frame.image.dtype}, the frame at rest "
        f"is {rest.shape[1]} x {rest.shape[0]} of {rest.dtype}; it is left out"
    )


def _check_source(arguments: argparse.Namespace) -> None:
    two = arguments.left is not None or arguments.right is not None
    if two == (arguments.source is not None):
        raise ConfigError("give SOURCE, or --left and --right")
    if two and (arguments.left is None or arguments.right is None or arguments.stereo is None):
        raise ConfigError("--left and --right need each other, and --stereo")
    if two and (arguments.split or arguments.mirror):
        raise ConfigError("--split and --mirror are for frames that show both views")
    if arguments.pair_within is not None and not (two and arguments.pair_within >= 0):
        raise ConfigError("--pair-within needs --left and --right, and at least 0 ms")
