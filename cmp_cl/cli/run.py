"""`cmp-cl run`: measure the deformation in every frame of a recording or of a live camera."""

import argparse
import contextlib
import re
import sys
import time
from collections.abc import Generator

from cmp_cl.cli.arguments import (
    add,
    add_device,
    add_full_scale,
    add_split,
    check_files,
    check_split,
    check_suffix,
    grid_shape,
    positive_number,
    split_of,
)
from cmp_cl.cli.messages import counted, one_line, shown, tell
from cmp_cl.cli.running.recording import Recording, missing_numbers
from cmp_cl.cli.running.results import Results
from cmp_cl.cli.running.stopping import Stop, handled, ignore
from cmp_cl.config import DetectorConfig
from cmp_cl.errors import CmpClError, ConfigError, GridError
from cmp_cl.measure import Measured, OneView, Settings, TwoViews
from cmp_cl.media import Frame
from cmp_cl.media.ahead import Ahead
from cmp_cl.media.cameras import Pairs, Source
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.series import SERIES_SUFFIXES
from cmp_cl.space import StereoRig
from cmp_cl.viz.plots import new_figure

_AHEAD = 4  # the most frames that wait to be measured, and to be written
_UNEVEN = 0.005  # of the side of a cell, that is told
_LINES_OF_BROKEN = 8  # broken frames that are reported one by one; the others are only counted


DESCRIPTION = """\
Numbers the corners of the pattern in every frame as in the frame at rest, and writes their
displacements as a series: in the image, or with --stereo in space. Frames that cannot be read, or
that a camera misses, are left out and counted; in frames without the pattern all nodes are
missing. Ctrl-C ends the run and saves what has been measured. docs/formats.md lists the arrays of
a series.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("input")
    what = (
        "video, folder of images, image, number of a camera, device such as /dev/video0, or "
        "address such as rtsp://camera/stream"
    )
    add(group, "source SOURCE", what, nargs="?")
    what = "the calibration of two views; SOURCE shows both in each frame"
    add(group, "--stereo YAML", what)
    add(group, "--left SOURCE", "with --stereo: the left view, in place of SOURCE")
    add(group, "--right SOURCE", "the right view")
    what = (
        "a setting of the camera, given once for each, such as frame_width=1280, frame_height=720, "
        "fps=60, fourcc=MJPG or exposure=50: a property CAP_PROP_NAME of OpenCV"
    )
    add(group, "--set NAME=VALUE", what, type=_setting, action="append", default=[])
    what = "number of the frame at rest, from 0; a camera's frames before it are dropped"
    add(group, "--rest-frame N", what, type=int, default=0)
    group = parser.add_argument_group("pattern")
    what = "rows and columns of its corners; default: those seen at rest"
    add(group, "--grid ROWSxCOLUMNS", what, type=grid_shape)
    what = (
        "where no border of the pattern is in view, continue the numbers of the previous frame; it "
        "must move by less than half a cell from frame to frame, and from rest to the first one"
    )
    add(group, "--track", what)
    group = parser.add_argument_group("output")
    what = (
        "the series: .npz, .h5, .csv, .pvd (ParaView), .mcap (ROS 2), or - for JSON lines on "
        "standard output; until it is complete, and after a kill, it is FILE.part"
    )
    add(group, "--out FILE", what, required=True)
    what = (
        "for one view of a flat pattern: side of its cells at rest, mm; lengths are then mm in its "
        "plane"
    )
    add(group, "--cell SIDE", what, type=positive_number)
    what = (
        "add the Green-Lagrange strain of each node, the principal strains and their direction, "
        "each with its sigma; with one view in the plane, with two in the surface"
    )
    add(group, "--strain", what)
    what = (
        "write NAME.png, a sheet of maps and curves, and NAME.mp4, the annotated video of the "
        "(left) view"
    )
    add(group, "--plot NAME", what)
    what = "show the annotated (left) view live in a browser, at an address that is printed"
    add(group, "--show", what)
    group = parser.add_argument_group("rarely needed")
    add_split(group)
    add(group, "--config TOML", "settings of the detector")
    add_full_scale(group)
    add_device(group)


def _setting(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE such as fps=60")
    return name, value


def run(arguments: argparse.Namespace) -> int:
    _check(arguments)
    config = None if arguments.config is None else DetectorConfig.load(arguments.config)
    rig = None if arguments.stereo is None else StereoRig.load(arguments.stereo)
    device = select_device(arguments.device)
    names = [arguments.source] if arguments.left is None else [arguments.left, arguments.right]
    sources = [Source(name, dict(arguments.set)) for name in names]
    source, stop = sources[0] if len(sources) == 1 else Pairs(*sources), Stop()
    plot = re.sub(r"\.(png|mp4)$", "", arguments.plot or "")
    pictures = [f"{plot}{suffix}" for suffix in (".png", ".mp4") if plot]
    series = [] if arguments.out == "-" else [arguments.out]
    check_files([*source.paths, arguments.config, arguments.stereo], [*series, *pictures])
    recording = Recording(source, arguments.rest_frame)
    for each in sources:
        if missing := missing_numbers(each.paths):
            tell(
                f"{counted(missing, 'number')} missing between {shown(each.paths[0].name)} and "
                f"{shown(each.paths[-1].name)}: frames and their `index` count the files"
            )
    settings = {
        "source": source.name,
        "rest_frame": str(arguments.rest_frame),
        "device": str(device),
        "configuration": repr(config) if config else "for the cells seen at rest",
    }
    ended_by: Exception | None = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(handled(stop))
        measure = _measurement(arguments, recording, config, rig, device)
        stack.enter_context(measure)
        found = Results(
            measure,
            arguments.out,
            pictures,
            show=arguments.show,
            settings=settings,
            period_ms=source.period_ms,
        )
        stack.enter_context(found)
        start = time.perf_counter()
        try:
            _flow(recording, measure, found, stop)
        except (CmpClError, OSError) as error:
            if isinstance(error, BrokenPipeError) or not found.frames:
                raise  # the reader of a pipe has gone, or there is nothing to keep
            ended_by = error
        if stop.name and not found.frames:  # an older series stays
            raise KeyboardInterrupt
        found.complete()
        rate = found.frames / (time.perf_counter() - start)
        pictures = found.pictures()
    lengths = "" if rig or arguments.cell else " in the image: --stereo or --cell give lengths"
    if rig and rig.window is None:
        lengths = ", depth as in air: calibrate --window is for acrylic or gel"
    said = f"{found.line(lengths)}; {rate:.3g} frames a second; measured on {device}"
    if isinstance(source, Pairs) and any(source.alone):
        left, right = source.alone
        said += f"; {left} left and {right} right frames without a partner"
    report = sys.stderr if arguments.out == "-" else sys.stdout
    stopped = f"stopped by {stop.name}; " if stop.name else ""
    print(f"{stopped}wrote {shown(arguments.out)}: {said}", file=report)
    for picture in pictures:
        print(f"wrote {shown(picture)}", file=report)
    if found.ambiguous:
        track = ", or give --track if it moves by less than half a cell from frame to frame"
        tell(
            f"in {counted(found.ambiguous, 'frame')} nothing decides which node is which: all "
            "displacements of such a frame may be wrong by whole cells, trust none of them (the "
            "array `ambiguous` says which frames). A pattern without a border in view, or that "
            "jumped by cells and looks the same turned by half, leaves this open: show a border of "
            f"the pattern in every frame{'' if arguments.track else track}"
        )
    if found.misfit:
        tell(
            f"in {counted(found.misfit, 'frame')} the rig no longer fits as it did at rest: a "
            "camera or a mirror may have moved, and all displacements of such a frame may be wrong "
            "(the array `misfit` says which frames); calibrate again, and record a new frame at "
            "rest"
        )
    if isinstance(source, Pairs) and not source.live and any(source.after):
        tell(
            f"one recording goes on for {counted(max(source.after), 'frame')} after the other. "
            "Times count from the start of each file: if the cameras did not start together, the "
            "views of a pair are of different moments, and depths of what moves are wrong"
        )
    failed = [one_line(error) for error in (ended_by, found.error) if error is not None]
    if failed:
        tell("; ".join(failed))
        return 2
    return 130 if stop.name and not source.live else 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if the options do not fit together, or need what is not installed."""
    two = arguments.left is not None and arguments.right is not None
    one = arguments.source is not None and arguments.left is None and arguments.right is None
    if not one and not (two and arguments.source is None and arguments.stereo is not None):
        raise ConfigError("give SOURCE, or --left and --right with --stereo")
    check_split(arguments, both=arguments.stereo is not None and not two)
    if arguments.rest_frame < 0:
        raise ConfigError(f"--rest-frame must be 0 or more, not {arguments.rest_frame}")
    if arguments.cell is not None and arguments.stereo is not None:
        raise ConfigError(
            "--cell is for one view; with --stereo, the calibration gives the unit of length"
        )
    if arguments.out != "-":
        check_suffix("--out", arguments.out, *SERIES_SUFFIXES)
    elif sys.__stdout__ is None:
        raise ConfigError("--out - needs standard output, which is closed")
    if arguments.plot is not None:
        new_figure((1, 1))  # matplotlib is missed now, not after the recording


def _measurement(
    arguments: argparse.Namespace,
    recording: Recording,
    config: DetectorConfig | None,
    rig: StereoRig | None,
    device: Device,
) -> OneView | TwoViews:
    """Return the measurement of frames against the frame at rest, and tell the doubts about it.

    Raises GridError if it shows no pattern.
    """
    rest, full_scale, hint = recording.rest, arguments.full_scale, ""
    if full_scale is None and (config is None or config.full_scale is None):
        full_scale = recording.source.full_scale
    search: Settings = {
        "shape": arguments.grid,
        "config": config,
        "full_scale": full_scale,
        "device": device,
        "track": arguments.track,
        "strain": arguments.strain,
    }
    where = f"frame {recording.number}, the frame at rest"
    measure: OneView | TwoViews
    try:
        if rig is None:
            hint = "; frames of two views need --stereo"
            measure = OneView(rest, cell=arguments.cell, **search)
        else:
            measure = TwoViews(rest, rig, split_of(arguments, rest.shape), **search)
    except GridError as error:
        raise GridError(f"{where}: {error}{hint}") from error
    views = ("",) if rig is None else ("the left view: ", "the right view: ")
    for view, grid in zip(views, measure.rest_grids, strict=True):
        for doubt in grid.doubts:
            tell(f"{where}: {view}{doubt}")
    if isinstance(measure, OneView) and measure.uneven > _UNEVEN:
        tell(
            f"{where}: after perspective, cells are off from squares by {measure.uneven:.1%}: the "
            "lens bends the image, or the pattern is not flat; lengths and strains in mm are wrong "
            "by as much. If it is the lens, calibrate it and give frames of cv2.undistort"
        )
    return measure


def _flow(recording: Recording, measure: OneView | TwoViews, found: Results, stop: Stop) -> None:
    """Measure each frame while the next ones are decoded and the one before is written.

    Whatever ends it, all that was measured is written.
    """
    with Ahead(_measured(recording, measure, stop), _AHEAD) as results:
        try:
            for frame, measured in results:
                if measured is not None:
                    # The others have the numbers of the frame at rest.
                    ambiguous = measured.ambiguous and frame.index != recording.number
                    found.write(frame, measured, ambiguous=ambiguous)
                    if measured.differing:
                        tell(
                            f"frame {frame.index}: tracking had another corner for "
                            f"{counted(measured.differing, 'node')} than the numbers that an audit "
                            "found anew, which hold from here on; in the frames before, these "
                            "nodes may be wrong"
                        )
                    continue
                found.left_out += 1
                if found.left_out <= _LINES_OF_BROKEN:
                    tell(recording.why_left_out(frame))
        finally:
            ignore()  # no signal stops the end of what is written


def _measured(
    recording: Recording, measure: OneView | TwoViews, stop: Stop
) -> Generator[tuple[Frame, Measured | None], None, None]:
    """Yield each frame with what is measured in it, None if it is not like the frame at rest."""
    with Ahead(recording.frames, _AHEAD) as decoded:
        for frame in decoded:
            if stop.name:
                return
            if frame.image is None or recording.why_left_out(frame):
                measure.skip()
                yield frame, None
            else:
                yield frame, measure(frame.image)
