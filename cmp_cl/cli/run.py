"""`cmp-cl run`: a recording or a live camera to the series of its deformation fields."""

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Generator
from typing import Any

from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_split,
    check_files,
    grid_shape,
    split_of,
)
from cmp_cl.cli.messages import Progress, counted, one_line, shown, tell
from cmp_cl.cli.running import results, sources
from cmp_cl.cli.running.pipeline import Pace, ahead
from cmp_cl.cli.running.results import Results
from cmp_cl.cli.running.stopping import Stop, handled, ignore
from cmp_cl.config import DetectorConfig
from cmp_cl.errors import CmpClError, ConfigError, GridError
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.media import Frame
from cmp_cl.media.cameras import Pairs, Source
from cmp_cl.opencl.device import Device, select_device
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
    group.add_argument(
        "--track",
        action="store_true",
        help="where no border of the pattern is in view, continue the numbers of the previous "
        "frame; it must move by less than half a cell from frame to frame, and from rest to the "
        "first one",
    )
    results.add_arguments(parser.add_argument_group("output"))
    group = parser.add_argument_group("rarely needed")
    add_split(group)
    group.add_argument("--config", metavar="TOML", help="settings of the detector")
    add_full_scale(group)
    add_device(group)
    parser.epilog = "docs/formats.md lists the arrays of a series."
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    _check(arguments)
    config = None if arguments.config is None else DetectorConfig.load(arguments.config)
    rig = None if arguments.stereo is None else StereoRig.load(arguments.stereo)
    device = select_device(arguments.device)
    source, stop = sources.opened(arguments), Stop()
    check_files([*source.paths, arguments.config, arguments.stereo], results.outputs(arguments))
    rest, frames = sources.at_rest(source, arguments.rest_frame)
    failed: list[Exception] = []
    with contextlib.ExitStack() as stack:
        stack.enter_context(handled(stop))
        measure = _measurement(arguments, source, rest, config, rig, device)
        stack.enter_context(measure)
        _tell_doubts(arguments.rest_frame, measure)
        settings = {
            "source": source.name,
            "rest_frame": str(arguments.rest_frame),
            "device": str(device),
            "configuration": repr(config) if config else "for the cells seen at rest",
        }
        in_air = rig is not None and rig.window is None
        found = stack.enter_context(
            Results(
                arguments, measure, settings=settings, period_ms=source.period_ms, in_air=in_air
            )
        )
        pace = Pace("the camera" if source.live else "decoding", "measuring", "writing")
        try:
            _flow(arguments.rest_frame, source, rest, frames, measure, found, pace, stop)
        except (CmpClError, OSError) as error:
            if isinstance(error, BrokenPipeError) or not found.frames:
                raise  # the reader of a pipe has gone, or there is nothing to keep
            failed.append(error)
        if stop.name and not found.frames:  # an older series stays
            raise KeyboardInterrupt
        pace.stages[-1].work(found.complete)
        speed = f"{pace.line(found.frames)}; measured on {device}"
        pictures = found.pictures()
    report = sys.stderr if arguments.out == "-" else sys.stdout
    stopped = f"stopped by {stop.name}; " if stop.name else ""
    alone = ""
    if isinstance(source, Pairs) and any(source.alone):
        left, right = source.alone
        alone = f"; {left} left and {right} right frames without a partner"
    print(f"{stopped}wrote {shown(arguments.out)}: {found.line()}; {speed}{alone}", file=report)
    for picture in pictures:
        print(f"wrote {shown(picture)}", file=report)
    if found.ambiguous:
        tell(_about_ambiguous(found.ambiguous, track=arguments.track))
    failed += [found.error] if found.error is not None else []
    if failed:
        tell("; ".join(map(one_line, failed)))
        return 2
    return 130 if stop.name and not source.live else 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if the options do not fit together."""
    if arguments.rest_frame < 0:
        raise ConfigError(f"--rest-frame must be 0 or more, not {arguments.rest_frame}")
    sources.check(arguments)
    results.check(arguments)
    if arguments.out == "-" and sys.__stdout__ is None:
        raise ConfigError("--out - needs standard output, which is closed")


def _measurement(
    arguments: argparse.Namespace,
    source: Source | Pairs,
    rest: GreyImage,
    config: DetectorConfig | None,
    rig: StereoRig | None,
    device: Device,
) -> OneView | TwoViews:
    """Return the measurement of frames against this frame at rest.

    Raises GridError if it shows no pattern.
    """
    full_scale, hint = arguments.full_scale, ""
    if full_scale is None and (config is None or config.full_scale is None):
        full_scale = source.full_scale
    search: Any = {
        "shape": arguments.grid,
        "config": config,
        "full_scale": full_scale,
        "device": device,
        "track": arguments.track,
        "strain": arguments.strain,
    }
    try:
        if rig is None:
            hint = "; frames of two views need --stereo"
            return OneView(rest, cell=arguments.cell, **search)
        return TwoViews(rest, rig, split_of(arguments, rest.shape), **search)
    except GridError as error:
        at_rest = f"frame {arguments.rest_frame}, the frame at rest"
        raise GridError(f"{at_rest}: {error}{hint}") from error


def _flow(
    at_rest: int,
    source: Source | Pairs,
    rest: GreyImage,
    frames: Generator[Frame, None, None],
    measure: OneView | TwoViews,
    found: Results,
    pace: Pace,
    stop: Stop,
) -> None:
    """Measure each frame, while the next are decoded and those before are written.

    Whatever ends it, all that was measured is written.
    """
    decoding, measuring, writing = pace.stages

    def measured(frames: Generator[Frame, None, None]) -> Generator[tuple[Frame, Measured | None]]:
        for frame in frames:
            image, result = frame.image, None
            if stop.name:
                return
            if image is None or (image.shape, image.dtype) != (rest.shape, rest.dtype):
                measure.skip()
            else:
                result = measuring.work(measure, image)
                if frame.index == at_rest:  # the others have its numbers
                    result = dataclasses.replace(result, ambiguous=False)
            yield frame, result

    with (
        contextlib.closing(ahead(decoding.each(frames))) as decoded,
        contextlib.closing(ahead(measured(decoded))) as results,
        Progress(source.total, "frames") as progress,
    ):
        try:
            for frame, result in results:
                progress.step(pace.limit)
                if result is not None:
                    writing.work(found.write, frame, result)
                    continue
                found.left_out += 1
                if found.left_out <= _LINES_OF_BROKEN:
                    why = sources.why_left_out(frame, rest, live=source.live)
                    progress.tell(why)
        finally:
            ignore()  # no signal stops the end of what is written


def _about_ambiguous(count: int, *, track: bool) -> str:
    """Return what it means that the numbering of so many frames is ambiguous, and what to do."""
    cure = "show a border of the pattern in every frame"
    if not track:
        cure += (
            ", or give --track if it moves by less than half a cell from frame to frame, which "
            "continues the numbers of the frame before"
        )
    return (
        f"in {counted(count, 'frame')} no border of the pattern decides which node is which: all "
        "displacements of such a frame may be wrong by whole cells, so trust none of them (the "
        f"array `ambiguous` says which frames); {cure}"
    )


def _tell_doubts(number: int, measure: OneView | TwoViews) -> None:
    """Print the doubts about the frame at rest, whose number that is."""
    if isinstance(measure, OneView):
        views = {"": measure.rest_grid}
    else:
        views = dict(zip(("the left view: ", "the right view: "), measure.rest_grids, strict=True))
    for view, grid in views.items():
        for doubt in grid.doubts:
            tell(f"frame {number}, the frame at rest: {view}{doubt}")
