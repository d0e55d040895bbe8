"""`cmp-cl run`: a recording or a live camera to the series of its deformation fields."""

import argparse
import contextlib
import dataclasses
import os
import re
import sys
import time
from pathlib import Path
from typing import Any, Self

import numpy as np

from cmp_cl.cameras import CameraSettings, Source
from cmp_cl.cli import derived
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
from cmp_cl.errors import ConfigError, GridError
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.media import Frame
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.series import SERIES_SUFFIXES, Description, SeriesWriter
from cmp_cl.space import StereoRig
from cmp_cl.viz import RerunLog
from cmp_cl.viz.video import OverlayVideo

_LINES_OF_BROKEN = 8  # broken frames that are reported one by one; the others are only counted


def add_parser(commands: Any) -> None:
    """Add `run` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "run",
        help="measure the deformation in every frame of a recording or of a live camera",
        description="Numbers the corners of the pattern in every frame as in the frame at rest, "
        "and writes the results as a series. With --stereo each frame shows two "
        "views, and the series holds the displacement of every node in space; without "
        "it, the positions in the image. Each frame is compared only with the frame "
        "at rest, unless --track is given. Frames that cannot be read, or that "
        "a camera misses, are left out and counted; in frames without the pattern all nodes "
        "are missing. Ctrl-C ends the run and saves what has been measured.",
    )
    parser.add_argument(
        "source",
        metavar="SOURCE",
        nargs="?",
        help="video, folder of images, image, .mcap, number of a camera, device such as "
        "/dev/video0, or address such as rtsp://camera/stream",
    )
    parser.add_argument(
        "--left",
        metavar="SOURCE",
        help="with --stereo and --right: the left view, instead of SOURCE; frames are paired by "
        "their time stamps, or in order if they have none, and those without a partner are "
        "counted",
    )
    parser.add_argument("--right", metavar="SOURCE", help="the right view")
    parser.add_argument(
        "--pair-within",
        metavar="MS",
        type=float,
        help="largest difference between the time stamps of a pair, ms; default: half the "
        f"interval between frames, or {PAIR_WITHIN:g} if that is unknown",
    )
    camera = parser.add_argument_group("settings of a camera, a device or an address")
    camera.add_argument(
        "--camera-size", metavar="WIDTHxHEIGHT", type=_camera_size, help="size of the frames, px"
    )
    camera.add_argument(
        "--camera-fps", metavar="FPS", type=positive_number, help="frames per second"
    )
    camera.add_argument(
        "--exposure", metavar="VALUE", type=float, help="exposure time, in the driver's units"
    )
    camera.add_argument(
        "--pixel-format", metavar="FOUR", help="four letters, such as GREY, MJPG, YUYV"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        required=True,
        help="the series: .npz (numpy.load), .h5 (HDF5), .csv, .pvd (ParaView), .mcap "
        "(ROS 2), or - for JSON lines on standard output; while it is written, and after a kill, "
        "it is FILE.part; see below",
    )
    parser.add_argument("--stereo", metavar="YAML", help="the calibration of the two views")
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        help="rows and columns of corners of the pattern; default: those seen at rest",
    )
    parser.add_argument(
        "--rest-frame",
        metavar="N",
        type=int,
        default=0,
        help="number of the frame at rest, from 0; with a camera, the frames before it are dropped",
    )
    parser.add_argument(
        "--track",
        action="store_true",
        help="where the numbering is ambiguous, because no border of the pattern is in view, "
        "continue that of the previous frame; the pattern as a whole must move by less than "
        "half a cell from the frame at rest to the first, and from frame to frame",
    )
    add_split(
        parser,
        help_="with --stereo, where the two views are in the frame: halves (the default), or "
        "X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, left and right, px",
    )
    add_region(
        parser,
        help_="which of several patterns to use: X,Y,WIDTH,HEIGHT, px of the frame, or with "
        "--stereo X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, in the left and in the right view; corners "
        "outside are ignored in every frame",
    )
    derived.add_arguments(parser)
    parser.add_argument(
        "--raw",
        action="store_true",
        help="do not apply the lattice filter; default: displacements are filtered, and the "
        "series holds the raw ones too",
    )
    parser.add_argument(
        "--overlay",
        metavar="MP4",
        help="write one annotated video, .mp4, .mkv or .avi (the left view)",
    )
    viewer = parser.add_mutually_exclusive_group()
    viewer.add_argument(
        "--rerun", metavar="RRD", help="record for the Rerun viewer (the left view)"
    )
    viewer.add_argument(
        "--show",
        action="store_true",
        help="open the Rerun viewer and show each frame in it as it is measured (the left view)",
    )
    parser.add_argument(
        "--config",
        metavar="TOML",
        help="settings of the detector; default: the most complete ones for the cell size at rest",
    )
    add_full_scale(parser)
    add_device(parser)
    parser.epilog = (
        "For F frames of R x C nodes, the series holds index (F,), time_ms (F,) (NaN where the "
        "source has no clock), ambiguous (F,) (whether the numbering may be wrong), unit, rest "
        "(R, C, K), displacement (F, R, C, K), sigma, status and source (F, R, C), with K = 2, and "
        "with --stereo 3. The detected positions are xy (F, R, C, 2), px, or left and right, and "
        "at rest xy_rest, or left_rest and right_rest. filtered says whether the lattice filter is "
        "on; then raw_rest, raw_displacement and raw_sigma are its input. --strain adds strain (F, "
        "R, C, 3: E11, E22, E12, in the plane along x and y, in space along the rows and across "
        "them), principal (F, R, C, 2) and direction (F, R, C), rad, each with _sigma. --contact "
        "adds depth, depth_sigma, normal, contact, contact_area and contact_depth. --cell adds "
        "homography (3, 3)."
    )
    parser.set_defaults(run=run)


def _camera_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size such as 1280x720")
    return int(match[1]), int(match[2])


class _Tally:
    """The counts of the measured frames, for the line at the end."""

    def __init__(self, *, track: bool) -> None:
        self._track = track
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
            hint = "" if self._track else " (--track continues those of the frame before)"
            parts.append(f"{self.ambiguous} with ambiguous numbers{hint}")
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
        check_suffix("--overlay", arguments.overlay, ".mp4")
        check_suffix("--rerun", arguments.rerun, ".rrd")
        if arguments.show:
            _check_display()
        config = None if arguments.config is None else DetectorConfig.load(arguments.config)
        rig = None if arguments.stereo is None else StereoRig.load(arguments.stereo)
        device = select_device(arguments.device)
        source = _source(arguments)
        check_files(
            [*source.paths, arguments.config, arguments.stereo],
            [out, arguments.overlay, arguments.rerun],
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
    tally, stop, display = _Tally(track=arguments.track), Stop(), _Display(settings)
    full: OSError | None = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(handled(stop))
        measure = settings.measurement(rest)
        stack.enter_context(measure)
        _tell_doubts(arguments.rest_frame, measure)
        stack.enter_context(display)
        description = settings.description(measure.unit)
        constants = measure.constants | derived.constants(arguments)
        series = stack.enter_context(
            SeriesWriter(arguments.out, description=description, **constants)
        )
        _tell_earlier(series.earlier)
        stack.callback(ignore)  # no signal stops the closing of the series
        progress = stack.enter_context(Progress(source.total, "frames"))
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
            measured, arrays = derived.derived(measure(image), arguments)
            spent = (time.perf_counter() - start) * 1e3
            if frame.index == arguments.rest_frame:  # the numbers are those of this frame
                measured = dataclasses.replace(measured, ambiguous=False)
            try:
                series.append(
                    index=frame.index,
                    time_ms=frame.time_ms,
                    ambiguous=measured.ambiguous,
                    **arrays,
                )
            except BrokenPipeError:  # the reader has gone
                raise
            except OSError as error:
                full = error
                break
            tally.add(frame.index, measured, spent)
            display.frame(frame, measured)
        if stop.name and not tally.frames:  # an older series stays
            raise KeyboardInterrupt
    report = sys.stderr if arguments.out == "-" else sys.stdout
    if full is None or tally.frames:
        ended = f"stopped by {stop.name}; " if stop.name else ""
        line = tally.line(measure.nodes, measure.unit, str(settings.device))
        alone = source.alone() if isinstance(source, Pairs) else ""
        print(f"{ended}wrote {shown(arguments.out)}: {line}{alone}", file=report)
    for written in (arguments.overlay, arguments.rerun):
        if written is not None and display.error is None:
            print(f"wrote {shown(written)}", file=report)
    failed = [error for error in (full, display.error) if error is not None]
    if failed:
        print(f"cmp-cl: {'; '.join(map(one_line, failed))}", file=sys.stderr)
        return 2
    return 130 if stop.name and not source.live else 0


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


class _Display(contextlib.AbstractContextManager["_Display"]):
    """Writes the Rerun recording and the annotated video, and feeds the viewer, as requested.

    If one of them cannot be written, the run continues. error: the reason, else None.
    """

    def __init__(self, settings: _Settings) -> None:
        self._settings = settings
        self._log: RerunLog | None = None
        self._overlay: OverlayVideo | None = None
        self.error: OSError | None = None

    def __enter__(self) -> Self:
        asked, rig = self._settings.arguments, self._settings.rig
        if asked.overlay is not None:
            period_ms = self._settings.source.period_ms
            fps = 25.0 if np.isnan(period_ms) else 1e3 / period_ms
            self._overlay = OverlayVideo(asked.overlay, fps=fps, unit=rig.unit if rig else "px")
        if asked.rerun is None and not asked.show:
            return self
        option = "--show" if asked.show else "--rerun"
        try:
            self._log = RerunLog(asked.rerun)
        except ImportError as error:
            raise ConfigError(f"{option} needs rerun-sdk: pip install 'cmp-cl[view]'") from error
        except RuntimeError as error:
            raise ConfigError(f"{option}: {str(error).strip().splitlines()[0]}") from error
        return self

    def __exit__(self, *_: object) -> None:
        for writer in (self._log, self._overlay):
            try:
                if writer is not None:
                    writer.close()
            except OSError as error:
                self.error = error

    def frame(self, frame: Frame, measured: Measured) -> None:
        """Add a frame."""
        if self.error is not None:
            return
        image, grid = measured.views[0], measured.grids[0]
        field = measured.field
        try:
            if self._log is not None:
                self._log.frame(
                    index=frame.index,
                    time_ms=frame.time_ms,
                    image=image,
                    grid=grid,
                    field=None if measured.points is None else field,
                )
            if self._overlay is not None:
                time_s = "" if np.isnan(frame.time_ms) else f"  {frame.time_ms / 1e3:.3f} s"
                text = f"frame {frame.index}{time_s}  {measured.nodes} nodes"
                self._overlay.frame(
                    image, grid, np.linalg.norm(field.displacement, axis=2), text=text
                )
        except OSError as error:
            self.error = error


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


def _check_display() -> None:
    """Raise ConfigError if no window can be opened."""
    displays = "DISPLAY", "WAYLAND_DISPLAY"
    if sys.platform.startswith("linux") and not any(map(os.environ.get, displays)):
        raise ConfigError(
            "--show needs a display, and there is none; --rerun FILE.rrd records to a file instead"
        )
