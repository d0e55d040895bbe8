"""The pictures that `cmp-cl run` makes while it measures: a sheet, a video, and a live view."""

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
from cmp_cl.viz import Viewer, save_figure, sheet_figure
from cmp_cl.viz.moments import Summary
from cmp_cl.viz.plots import new_figure
from cmp_cl.viz.video import OverlayVideo

_RATED = 30  # frames over which the frame rate is told


def add_arguments(group: Any) -> None:
    """Add the options --plot and --show to a group of an argparse parser."""
    group.add_argument(
        "--plot",
        metavar="NAME",
        help="write NAME.png, a sheet of maps and curves, and NAME.mp4, the annotated video of the "
        "(left) view; a NAME that ends in .png or .mp4 is that one alone",
    )
    group.add_argument(
        "--show",
        action="store_true",
        help="show each frame in the Rerun viewer as it is measured, with nodes coloured by "
        "displacement, their number, and the frame rate",
    )


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for a file name of another kind, or if no window can be opened."""
    suffix = Path(arguments.plot or "").suffix.lower()
    if suffix in (".gif", ".avi", ".mkv", ".jpg", ".jpeg", ".pdf", ".svg"):
        raise ConfigError(f"--plot {arguments.plot} must end in .png or .mp4, or in neither")
    displays = "DISPLAY", "WAYLAND_DISPLAY"
    linux = sys.platform.startswith("linux")
    if arguments.show and linux and not any(map(os.environ.get, displays)):
        raise ConfigError(
            "--show needs a display, and there is none; --plot NAME.mp4 writes a video instead"
        )


def outputs(arguments: argparse.Namespace) -> tuple[str | None, str | None]:
    """Return the sheet and the video that --plot names, None for what was not asked for."""
    name = arguments.plot
    if name is None:
        return None, None
    suffix = Path(name).suffix.lower()
    sheet = None if suffix == ".mp4" else name if suffix == ".png" else f"{name}.png"
    video = None if suffix == ".png" else name if suffix == ".mp4" else f"{name}.mp4"
    return sheet, video


class Display(Closing):
    """Writes the sheet and the annotated video, and feeds the viewer, as requested.

    rest: positions at rest, (R, C, 2 or 3) in `unit`. period_ms: time between frames, NaN if
    unknown. If one of them cannot be written, the run continues. error: the reason, else None.

    Raises ConfigError if an extra is missing, OSError.
    """

    def __init__(
        self, arguments: argparse.Namespace, rest: Any, unit: str, period_ms: float
    ) -> None:
        self.error: Exception | None = None
        self._sheet, video = outputs(arguments)
        self._summary: Summary | None = None
        self._video: OverlayVideo | None = None
        self._times: collections.deque[float] = collections.deque(maxlen=_RATED)
        if self._sheet is not None:
            new_figure((1, 1))  # matplotlib is missed now, not after the recording
            self._summary = Summary(np.asarray(rest, np.float64), unit)
        if video is not None:
            fps = 25.0 if math.isnan(period_ms) else 1e3 / period_ms
            self._video = OverlayVideo(video, fps=fps, unit=unit)
        self._viewer = Viewer() if arguments.show else None

    def frame(self, frame: Frame, measured: Measured) -> None:
        """Add a frame."""
        if self.error is not None:
            return
        field, image, grid = measured.field, measured.views[0], measured.grids[0]
        if self._summary is not None:
            self._summary.add(frame.index, frame.time_ms, field.displacement, field.sigma)
        if self._viewer is not None:
            self._viewer.frame(
                index=frame.index,
                time_ms=frame.time_ms,
                image=image,
                grid=grid,
                field=field,
                rate=self._rate(),
            )
        if self._video is not None:
            time_s = "" if math.isnan(frame.time_ms) else f"  {frame.time_ms / 1e3:.3f} s"
            text = f"frame {frame.index}{time_s}  {measured.nodes} nodes"
            moved = np.linalg.norm(field.displacement, axis=2)
            try:
                self._video.frame(image, grid, moved, text=text)
            except OSError as error:
                self.error = error

    def _rate(self) -> float:
        """Return the frames per second of the latest frames, NaN at the first one."""
        self._times.append(time.perf_counter())
        spent = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / spent if spent else math.nan

    def close(self) -> None:
        """Finish the files; what fails is in `error`."""
        try:
            if self._viewer is not None:
                self._viewer.close()
            if self._video is not None:
                self._video.close()
            if self._sheet is not None and self._summary and self._summary.moment is not None:
                save_figure(self._sheet, sheet_figure(self._summary.moment, self._summary))
        except (OSError, CmpClError) as error:
            self.error = error
