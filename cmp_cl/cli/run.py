"""`cmp-cl run`: a recording or a live camera to the series of its deformation fields."""

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any, Self

from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
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
from cmp_cl.cli.messages import Progress, counted, one_line, shown
from cmp_cl.cli.running import derived, display, sources
from cmp_cl.cli.running.pipeline import Behind, Pace, ahead
from cmp_cl.cli.running.stopping import Stop, handled, ignore
from cmp_cl.config import DetectorConfig
from cmp_cl.errors import CmpClError, ConfigError, GridError
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Source
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
    sources.add_arguments(group)
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
    sources.add_camera_arguments(group)
    group = parser.add_argument_group("rarely needed")
    add_split(
        group,
        help_="where the two views are in the frame: halves (the default), or "
        "X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, left and right, of one size, px",
    )
    group.add_argument("--config", metavar="TOML", help="settings of the detector")
    add_full_scale(group)
    parser.epilog = "docs/formats.md lists the arrays of a series."
    parser.set_defaults(run=run)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Settings:
    """The arguments, checked, and what they name, loaded."""

    arguments: argparse.Namespace
    source: Source | sources.Pairs
    device: Device
    config: DetectorConfig | None
    rig: StereoRig | None

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> Self:
        if arguments.rest_frame < 0:
            raise ConfigError(f"--rest-frame must be 0 or more, not {arguments.rest_frame}")
        sources.check(arguments)
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
        source = sources.opened(arguments)
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
            **dict.fromkeys([*lengths, "bias_sigma"], unit),
            **dict.fromkeys(pixels, "px"),
            **derived.units(unit),
        }
        settings = {
            "source": self.source.name,
            "rest_frame": str(self.arguments.rest_frame),
            "device": str(self.device),
            "configuration": repr(self.config) if self.config else "for the cells seen at rest",
        }
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
            if isinstance(self.source, sources.Pairs):  # regions are in the two frames
                two = ((0, 0, *two[0][2:]), two[1])
            left, right = regions_in(asked.region, one, two)
            return TwoViews(rest, self.rig, split, regions=(left, right), **search)
        except GridError as error:
            raise GridError(
                f"frame {asked.rest_frame}, the frame at rest: {error}{hint}"
            ) from error


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    settings = _Settings.of(arguments)
    source, stop = settings.source, Stop()
    rest, frames = sources.at_rest(source, arguments.rest_frame)
    failed: list[Exception] = []
    with contextlib.ExitStack() as stack:
        stack.enter_context(handled(stop))
        measure = settings.measurement(rest)
        stack.enter_context(measure)
        _tell_doubts(arguments.rest_frame, measure)
        sinks = _Sinks(settings, measure, stack)
        pace = Pace("the camera" if source.live else "decoding", "measuring", "writing")
        try:
            _flow(settings, rest, frames, measure, sinks, pace, stop)
        except (CmpClError, OSError) as error:
            if isinstance(error, BrokenPipeError) or not sinks.frames:
                raise  # the reader of a pipe has gone, or there is nothing to keep
            failed.append(error)
        if stop.name and not sinks.frames:  # an older series stays
            raise KeyboardInterrupt
        pace.stages[-1].work(sinks.complete)
        speed = f"{pace.line(sinks.frames)}; measured on {settings.device}"
    report = sys.stderr if arguments.out == "-" else sys.stdout
    stopped = f"stopped by {stop.name}; " if stop.name else ""
    alone = source.alone() if isinstance(source, sources.Pairs) else ""
    print(f"{stopped}wrote {shown(arguments.out)}: {sinks.line()}; {speed}{alone}", file=report)
    if sinks.pictures.error is not None:
        failed.append(sinks.pictures.error)
    elif sinks.frames:
        for written in filter(None, display.outputs(arguments)):
            print(f"wrote {shown(written)}", file=report)
    if sinks.ambiguous:
        print(f"cmp-cl: {_about_ambiguous(sinks.ambiguous, arguments)}", file=sys.stderr)
    if failed:
        print(f"cmp-cl: {'; '.join(map(one_line, failed))}", file=sys.stderr)
        return 2
    return 130 if stop.name and not source.live else 0


def _flow(
    settings: _Settings,
    rest: GreyImage,
    frames: Generator[Frame, None, None],
    measure: OneView | TwoViews,
    sinks: "_Sinks",
    pace: Pace,
    stop: Stop,
) -> None:
    """Measure each frame, while the next are decoded and those before are written.

    Whatever ends it, all that was measured is written.
    """
    source = settings.source
    decoding, measuring, writing = pace.stages
    with (
        contextlib.closing(ahead(decoding, frames)) as decoded,
        Progress(source.total, "frames") as progress,
        Behind(writing) as behind,
    ):
        try:
            for frame in decoded:
                if stop.name:
                    return
                progress.step(pace.limit)
                image = frame.image
                if image is None or (image.shape, image.dtype) != (rest.shape, rest.dtype):
                    measure.skip()
                    sinks.left_out += 1
                    if sinks.left_out <= _LINES_OF_BROKEN:
                        why = sources.why_left_out(frame, rest, live=source.live)
                        progress.say(f"cmp-cl: {why}", sys.stderr)
                    continue
                measured = measuring.work(measure, image)
                if frame.index == settings.arguments.rest_frame:  # the others have its numbers
                    measured = dataclasses.replace(measured, ambiguous=False)
                behind(sinks.write, frame, measured)
        finally:
            ignore()  # no signal stops the writing of what is measured


class _Sinks:
    """Where measured frames go: the series, the pictures, and the counts of the last line.

    stack: closes the files. frames, ambiguous, left_out: numbers of frames.
    """

    def __init__(
        self, settings: _Settings, measure: OneView | TwoViews, stack: contextlib.ExitStack
    ) -> None:
        self._arguments = arguments = settings.arguments
        self._of_pattern, self._unit = measure.nodes, measure.unit
        self._in_air = settings.rig is not None and settings.rig.window is None
        self.pictures = stack.enter_context(
            display.Display(
                arguments, measure.constants["rest"], measure.unit, settings.source.period_ms
            )
        )
        self._series = stack.enter_context(
            SeriesWriter(
                arguments.out,
                description=settings.description(measure.unit),
                **(measure.constants | derived.constants(arguments)),
            )
        )
        _tell_earlier(self._series.earlier)
        self.frames = self.ambiguous = self.left_out = self._empty = 0
        self._nodes, self._fewest = 0, measure.nodes
        self._largest, self._where = 0.0, 0

    def write(self, frame: Frame, measured: Measured) -> None:
        """Write a frame, then count it."""
        self._series.append(
            index=frame.index,
            time_ms=frame.time_ms,
            ambiguous=measured.ambiguous,
            **derived.arrays_of(measured, self._arguments),
        )
        self.frames += 1
        if measured.nodes:
            self._nodes += measured.nodes
            self._fewest = min(self._fewest, measured.nodes)
            self.ambiguous += measured.ambiguous
        else:
            self._empty += 1
        if measured.largest > self._largest:
            self._largest, self._where = measured.largest, frame.index
        self.pictures.frame(frame, measured)

    def complete(self) -> None:
        """Make the file of the series, if it has a frame."""
        if self.frames:
            self._series.close()

    def line(self) -> str:
        """Return the counts as text."""
        parts = [counted(self.frames, "frame")]
        if self._nodes:
            mean = f"{self._nodes / (self.frames - self._empty):.1f} of {self._of_pattern}"
            parts.append(f"{mean} nodes on average, at least {self._fewest}")
            moved = f"moved by up to {self._largest:.3g} {self._unit} (frame {self._where})"
            if self._unit == "px":
                moved += " in the image: --stereo or --cell give lengths"
            if self._in_air:
                moved += ", depth as in air: calibrate --window is for acrylic or gel"
            parts.append(moved)
        for count, what in (
            (self._empty, "without the pattern"),
            (self.ambiguous, "whose numbers may be wrong"),
            (self.left_out, "left out"),
        ):
            if count:
                parts.append(f"{count} {what}")
        return "; ".join(parts)


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
