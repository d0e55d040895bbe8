"""The pictures that `cmp-cl run` makes while it measures: a video, and a live view."""

import argparse
import collections
import math
import os
import sys
import time
from typing import Any

import numpy as np

from cmp_cl.cli.arguments import check_suffix
from cmp_cl.closing import Closing
from cmp_cl.errors import CmpClError, ConfigError
from cmp_cl.measure import Measured
from cmp_cl.media import Frame
from cmp_cl.viz import Viewer
from cmp_cl.viz.video import OverlayVideo

_RATED = 30  # frames over which the frame rate is told


def add_arguments(group: Any) -> None:
    """Add the options --video and --show to a group of an argparse parser."""
    group.add_argument(
        "--video",
        metavar="MP4",
        help="write the annotated video of the (left) view: nodes coloured by displacement",
    )
    group.add_argument(
        "--show",
        action="store_true",
        help="show each frame in the Rerun viewer as it is measured, with nodes coloured by "
        "displacement, their number, and the frame rate",
    )


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for a file name of another kind, or if no window can be opened."""
    check_suffix("--video", arguments.video, ".mp4")
    displays = "DISPLAY", "WAYLAND_DISPLAY"
    linux = sys.platform.startswith("linux")
    if arguments.show and linux and not any(map(os.environ.get, displays)):
        raise ConfigError(
            "--show needs a display, and there is none; --video NAME.mp4 writes a video instead"
        )


class Display(Closing):
    """Writes the annotated video and feeds the viewer, as requested.

    unit: of the displacement. period_ms: time between frames, NaN if unknown. If the video cannot
    be written, the run continues. error: the reason, else None.

    Raises ConfigError if an extra is missing, OSError.
    """

    def __init__(self, arguments: argparse.Namespace, unit: str, period_ms: float) -> None:
        self.error: Exception | None = None
        self._video: OverlayVideo | None = None
        self._times: collections.deque[float] = collections.deque(maxlen=_RATED)
        if arguments.video is not None:
            fps = 25.0 if math.isnan(period_ms) else 1e3 / period_ms
            self._video = OverlayVideo(arguments.video, fps=fps, unit=unit)
        self._viewer = Viewer() if arguments.show else None

    def frame(self, frame: Frame, measured: Measured) -> None:
        """Add a frame."""
        if self.error is not None:
            return
        field, image, grid = measured.field, measured.views[0], measured.grids[0]
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
        """Finish the video; what fails is in `error`."""
        try:
            if self._viewer is not None:
                self._viewer.close()
            if self._video is not None:
                self._video.close()
        except (OSError, CmpClError) as error:
            self.error = error
