"""The pictures that `cmp-cl run` makes while it measures: a sheet, a video, and Rerun's viewer."""

import argparse
import collections
import math
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from cmp_cl.closing import Closing
from cmp_cl.errors import CmpClError, ConfigError
from cmp_cl.measure import Measured
from cmp_cl.media import Frame
from cmp_cl.viz import RerunLog, save_figure
from cmp_cl.viz.plots import Summary, new_figure, sheet_figure
from cmp_cl.viz.video import OverlayVideo

_RATED = 30  # frames over which the frame rate is told


def add_arguments(group: Any) -> None:
    """Add the options --plot, --show and --rerun to a group of an argparse parser."""
    group.add_argument(
        "--plot",
        metavar="NAME",
        help="write NAME.png, a sheet of maps and curves, and NAME.mp4, the annotated video of the "
        "(left) view; a NAME that ends in .png or .mp4 is that one alone",
    )
    viewer = group.add_mutually_exclusive_group()
    viewer.add_argument(
        "--show",
        action="store_true",
        help="show each frame in the Rerun viewer as it is measured, with nodes coloured by "
        "displacement, their number, and the frame rate",
    )
    viewer.add_argument("--rerun", metavar="RRD", help="record the same to a file for that viewer")


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for a file name of another kind, or if no window can be opened."""
    if arguments.rerun is not None and Path(arguments.rerun).suffix.lower() != ".rrd":
        raise ConfigError(f"--rerun {arguments.rerun} must end in .rrd")
    suffix = Path(arguments.plot or "").suffix.lower()
    if suffix in (".gif", ".avi", ".mkv", ".jpg", ".jpeg", ".pdf", ".svg"):
        raise ConfigError(f"--plot {arguments.plot} must end in .png or .mp4, or in neither")
    displays = "DISPLAY", "WAYLAND_DISPLAY"
    linux = sys.platform.startswith("linux")
    if arguments.show and linux and not any(map(os.environ.get, displays)):
        raise ConfigError(
            "--show needs a display, and there is none; --rerun FILE.rrd records to a file instead"
        )


def outputs(arguments: argparse.Namespace) -> tuple[str | None, str | None, str | None]:
    """Return the files that the options name, None for those that were not asked for: the sheet,
    the video, the recording."""
    name = arguments.plot
    if name is None:
        return None, None, arguments.rerun
    suffix = Path(name).suffix.lower()
    sheet = None if suffix == ".mp4" else name if suffix == ".png" else f"{name}.png"
    video = None if suffix == ".png" else name if suffix == ".mp4" else f"{name}.mp4"
    return sheet, video, arguments.rerun


class Display(Closing):
    """Writes the sheet, the annotated video and the Rerun recording, and feeds the viewer, as
    requested.

    rest: positions at rest, (R, C, 2 or 3) in `unit`. period_ms: time between frames, NaN if
    unknown. If one of them cannot be written, the run continues. error: the reason, else None.

    Raises ConfigError if an extra is missing, OSError.
    """

    def __init__(
        self, arguments: argparse.Namespace, rest: Any, unit: str, period_ms: float
    ) -> None:
        self.error: Exception | None = None
        self._sheet, video, recording = outputs(arguments)
        self._summary: Summary | None = None
        self._video: OverlayVideo | None = None
        self._log: RerunLog | None = None
        self._unit = unit
        self._times: collections.deque[float] = collections.deque(maxlen=_RATED)
        if self._sheet is not None:
            new_figure((1, 1))  # matplotlib is missed now, not after the recording
            self._summary = Summary(np.asarray(rest, np.float64), unit)
        if video is not None:
            fps = 25.0 if math.isnan(period_ms) else 1e3 / period_ms
            self._video = OverlayVideo(video, fps=fps, unit=unit)
        if recording is not None or arguments.show:
            option = "--show" if arguments.show else "--rerun"
            try:
                self._log = RerunLog(recording)
            except ImportError as error:
                raise ConfigError(
                    f"{option} needs rerun-sdk: pip install 'cmp-cl[view]'"
                ) from error
            except RuntimeError as error:
                raise ConfigError(f"{option}: {str(error).strip().splitlines()[0]}") from error

    def frame(self, frame: Frame, measured: Measured) -> None:
        """Add a frame."""
        if self.error is not None:
            return
        field, image, grid = measured.field, measured.views[0], measured.grids[0]
        if self._summary is not None:
            self._summary.add(frame.index, frame.time_ms, field.displacement, field.sigma)
        moved = np.linalg.norm(field.displacement, axis=2)
        self._times.append(time.perf_counter())
        try:
            if self._log is not None:
                self._log.frame(
                    index=frame.index,
                    time_ms=frame.time_ms,
                    image=image,
                    grid=grid,
                    field=None if measured.rig is None else field,
                    moved=moved,
                    unit=self._unit,
                    rate=self._rate(),
                )
            if self._video is not None:
                time_s = "" if math.isnan(frame.time_ms) else f"  {frame.time_ms / 1e3:.3f} s"
                text = f"frame {frame.index}{time_s}  {measured.nodes} nodes"
                self._video.frame(image, grid, moved, text=text)
        except OSError as error:
            self.error = error

    def _rate(self) -> float:
        """Return the frames per second of the latest frames, NaN before the second one."""
        spent = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / spent if spent else math.nan

    def close(self) -> None:
        """Finish the files; what fails is in `error`."""
        for closing in (self._log, self._video):
            try:
                if closing is not None:
                    closing.close()
            except OSError as error:
                self.error = error
        summary = self._summary
        if self._sheet is not None and summary is not None and summary.moment is not None:
            try:
                save_figure(self._sheet, sheet_figure(summary.moment, summary))
            except (OSError, CmpClError) as error:
                self.error = error
