"""Where the frames of `cmp-cl run` go: the series, the pictures, the live view, the last line."""

import argparse
import contextlib
import math
import statistics
import time
from collections import deque
from typing import Any

from cmp_cl.cli.arguments import check_suffix, positive_number
from cmp_cl.cli.messages import counted, shown, tell
from cmp_cl.closing import Closing
from cmp_cl.errors import CmpClError, ConfigError
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.media import Frame
from cmp_cl.series import SERIES_SUFFIXES, SeriesWriter
from cmp_cl.viz import Moment, save_figure, sheet_figure
from cmp_cl.viz.live import LiveView
from cmp_cl.viz.moments import Summary
from cmp_cl.viz.overlays import moved_overlay
from cmp_cl.viz.plots import new_figure
from cmp_cl.viz.video import VideoFile

_RATED = 30  # frames over which the frame rate of the live view is told
_USUAL_RATE = 25.0  # pictures a second of a video whose frames have no times


def add_arguments(group: Any) -> None:
    """Add the options of what is written and shown to a group of an argparse parser."""
    group.add_argument(
        "--out",
        metavar="FILE",
        required=True,
        help="the series: .npz, .h5, .csv, .pvd (ParaView), .mcap (ROS 2), or - for JSON lines on "
        "standard output; until it is complete, and after a kill, it is FILE.part",
    )
    group.add_argument(
        "--cell",
        metavar="SIDE",
        type=positive_number,
        help="for one view of a flat pattern: side of its cells at rest, mm; lengths are then mm "
        "in its plane",
    )
    group.add_argument(
        "--strain",
        action="store_true",
        help="add the Green-Lagrange strain of each node, the principal strains and their "
        "direction, each with its sigma; with one view in the plane, with two in the surface",
    )
    group.add_argument(
        "--plot",
        metavar="NAME",
        help="write NAME.png, a sheet of maps and curves, and NAME.mp4, the annotated video of the "
        "(left) view",
    )
    group.add_argument(
        "--show",
        action="store_true",
        help="show the annotated (left) view live in a browser, at an address that is printed",
    )


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if these options do not fit together."""
    if arguments.out != "-":
        check_suffix("--out", arguments.out, *SERIES_SUFFIXES)
    if arguments.cell is not None and arguments.stereo is not None:
        raise ConfigError(
            "--cell is for one view; with --stereo, the calibration gives the unit of length"
        )
    if arguments.plot is not None:
        new_figure((1, 1))  # matplotlib is missed now, not after the recording


def outputs(arguments: argparse.Namespace) -> list[str]:
    """Return the files to write."""
    plot = [] if arguments.plot is None else [f"{arguments.plot}.png", f"{arguments.plot}.mp4"]
    return plot if arguments.out == "-" else [arguments.out, *plot]


class Results(Closing):
    """Takes the measured frames.

    settings: what the series says of the run. period_ms: time between frames, NaN if unknown.
    in_air: whether a window would be missed without a word.
    ambiguous, left_out: numbers of frames. error: why a picture was not written, else None.
    """

    def __init__(
        self,
        arguments: argparse.Namespace,
        measure: OneView | TwoViews,
        *,
        settings: dict[str, str],
        period_ms: float,
        in_air: bool,
    ) -> None:
        self._in_air = in_air
        self._arguments, self._unit, self._of_pattern = arguments, measure.unit, measure.nodes
        self.ambiguous = self.left_out = 0
        self._nodes: list[int] = []  # that were measured in each frame
        self._summary = Summary()
        self._times: deque[float] = deque(maxlen=_RATED)
        self.error: Exception | None = None
        self._video: VideoFile | None = None
        self._live: LiveView | None = None
        with contextlib.ExitStack() as stack:
            if arguments.plot is not None:
                fps = _USUAL_RATE if math.isnan(period_ms) else 1e3 / period_ms
                self._video = stack.enter_context(VideoFile(f"{arguments.plot}.mp4", fps=fps))
            self._series = stack.enter_context(
                SeriesWriter(arguments.out, settings=settings, **measure.constants)
            )
            if arguments.show:
                self._live = stack.enter_context(LiveView())
                tell(f"the live view is at {self._live.address}: open it in a browser")
            self._files = stack.pop_all()
        for part in self._series.earlier:
            tell(
                f"{shown(part)} is of a run that was killed, or that still goes on, and is kept: "
                "it holds all frames up to then; delete it if you need none of them"
            )

    @property
    def frames(self) -> int:
        """Return the number of frames so far."""
        return len(self._nodes)

    def write(self, frame: Frame, measured: Measured) -> None:
        """Write a frame, then count it and draw it."""
        self._series.append(
            index=frame.index,
            time_ms=frame.time_ms,
            ambiguous=measured.ambiguous,
            **measured.arrays,
        )
        self._nodes.append(measured.nodes)
        self.ambiguous += measured.ambiguous and measured.nodes > 0
        moment = Moment.of(measured.field, frame.index, frame.time_ms)
        self._summary.add(moment)
        self._draw(measured, moment)

    def _draw(self, measured: Measured, moment: Moment) -> None:
        """Add a frame to the video, and show it; without one of them the run goes on."""
        self._times.append(time.perf_counter())
        top = self._summary.top
        clock = "" if math.isnan(moment.time_ms) else f"  {moment.time_ms / 1e3:.3f} s"
        text = f"frame {moment.index}{clock}  {measured.nodes} nodes"

        def picture(text: str = text) -> Any:
            return moved_overlay(
                measured.views[0],
                measured.grids[0],
                moment.moved,
                top=top,
                unit=moment.unit,
                text=text,
            )

        if self._live is not None:
            spent = self._times[-1] - self._times[0]
            rate = f"  {(len(self._times) - 1) / spent:.1f} frames/s" if spent else ""
            self._live.show(lambda: picture(text + rate))
        if self._video is not None and self.error is None:
            try:
                self._video.add(picture())
            except (OSError, CmpClError) as error:
                self.error = error

    def complete(self) -> None:
        """Make the file of the series, if it has a frame."""
        if self.frames:
            self._series.close()

    def pictures(self) -> list[str]:
        """Finish the sheet and the video; return their names. What fails is in `error`."""
        if self._video is None or self._summary.moment is None:
            return []
        sheet, video = outputs(self._arguments)[-2:]
        try:
            self._video.close()
            save_figure(sheet, sheet_figure(self._summary.moment, self._summary))
        except (OSError, CmpClError) as error:
            self.error = error
        return [] if self.error else [sheet, video]

    def close(self) -> None:
        self._files.close()

    def __exit__(self, *raised: Any) -> None:
        self._files.__exit__(*raised)

    def line(self) -> str:
        """Return the counts as text."""
        parts = [counted(self.frames, "frame")]
        seen = [count for count in self._nodes if count]
        if seen and self._summary.moment is not None:
            mean = f"{statistics.fmean(seen):.1f} of {self._of_pattern}"
            parts.append(f"{mean} nodes on average, at least {min(seen)}")
            where = f"(frame {self._summary.moment.index})"
            moved = f"moved by up to {self._summary.top:.3g} {self._unit} {where}"
            if self._unit == "px":
                moved += " in the image: --stereo or --cell give lengths"
            if self._in_air:
                moved += ", depth as in air: calibrate --window is for acrylic or gel"
            parts.append(moved)
        for count, what in (
            (self.frames - len(seen), "without the pattern"),
            (self.ambiguous, "whose numbers may be wrong"),
            (self.left_out, "left out"),
        ):
            if count:
                parts.append(f"{count} {what}")
        return "; ".join(parts)
