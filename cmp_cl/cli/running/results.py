"""Where the frames of `cmp-cl run` go: the series, the pictures, the live view, the last line."""

import contextlib
import math
import statistics
import time
from collections import deque
from typing import Any

from cmp_cl.cli.messages import counted, shown, tell
from cmp_cl.closing import Closing
from cmp_cl.errors import CmpClError
from cmp_cl.measure import Measured, Measurement
from cmp_cl.media import Frame
from cmp_cl.series import SeriesWriter
from cmp_cl.viz import Moment, save_figure, sheet_figure
from cmp_cl.viz.live import LiveView
from cmp_cl.viz.moments import Summary
from cmp_cl.viz.overlays import moved_overlay
from cmp_cl.viz.video import VideoFile

_RATED = 30  # frames over which the frame rate of the live view is told
_USUAL_RATE = 25.0  # pictures a second of a video whose frames have no times


class Results(Closing):
    """Takes the measured frames.

    series: what to write. pictures: the names of a sheet and of a video, or none. show: whether
    there is a live view. settings: what the series says of the run. period_ms: time between frames,
    NaN if unknown.

    ambiguous, misfit, left_out: numbers of frames. error: why a picture was not written, else None.
    """

    def __init__(
        self,
        measure: Measurement,
        series: str,
        pictures: list[str],
        *,
        show: bool,
        settings: dict[str, str],
        period_ms: float,
    ) -> None:
        self._unit, self._of_pattern, self._pictures = measure.unit, measure.nodes, pictures
        self.ambiguous = self.misfit = self.left_out = 0
        self._nodes: list[int] = []  # that were measured in each frame
        self._summary = Summary()
        self._times: deque[float] = deque(maxlen=_RATED)
        self.error: Exception | None = None
        self._video: VideoFile | None = None
        self._live: LiveView | None = None
        with contextlib.ExitStack() as stack:
            if pictures:
                fps = _USUAL_RATE if math.isnan(period_ms) else 1e3 / period_ms
                self._video = stack.enter_context(VideoFile(pictures[1], fps=fps))
            self._series = stack.enter_context(
                SeriesWriter(series, settings=settings, **measure.constants)
            )
            if show:
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

    def write(self, frame: Frame, measured: Measured, *, ambiguous: bool) -> None:
        """Write a frame, then count it and draw it. ambiguous: whether its numbers may be wrong."""
        self._series.append(
            index=frame.index, time_ms=frame.time_ms, ambiguous=ambiguous, **measured.arrays
        )
        self._nodes.append(measured.nodes)
        self.ambiguous += ambiguous and measured.nodes > 0
        self.misfit += measured.misfit
        moment = Moment.of(
            measured.field, frame.index, frame.time_ms, doubtful=ambiguous or measured.misfit
        )
        self._summary.add(moment)
        self._draw(measured, moment)

    def _draw(self, measured: Measured, moment: Moment) -> None:
        """Add a frame to the video, and show it; without one of them the run goes on."""
        self._times.append(time.perf_counter())
        top = self._summary.top
        clock = "" if math.isnan(moment.time_ms) else f"  {moment.time_ms / 1e3:.3f} s"
        text = f"frame {moment.index}{clock}  {measured.nodes} nodes"
        text += ", all may be wrong" if moment.doubtful else ""

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
        try:
            self._video.close()
            save_figure(self._pictures[0], sheet_figure(self._summary.moment, self._summary))
        except (OSError, CmpClError) as error:
            self.error = error
        return [] if self.error else self._pictures

    def close(self) -> None:
        self._files.close()

    def __exit__(self, *raised: Any) -> None:
        self._files.__exit__(*raised)

    def line(self, lengths: str) -> str:
        """Return the counts as text. lengths: what is to be known of the displacements."""
        parts = [counted(self.frames, "frame")]
        seen = [count for count in self._nodes if count]
        if seen and self._summary.moment is not None:
            mean = f"{statistics.fmean(seen):.1f} of {self._of_pattern}"
            parts.append(f"{mean} nodes on average, at least {min(seen)}")
            doubt = ", all of which may be wrong" if self._summary.moment.doubtful else ""
            where = f"(frame {self._summary.moment.index}{doubt})"
            parts.append(f"moved by up to {self._summary.top:.3g} {self._unit} {where}{lengths}")
        for count, what in (
            (self.frames - len(seen), "without the pattern"),
            (self.ambiguous, "whose numbers may be wrong"),
            (self.misfit, "that the rig does not fit"),
            (self.left_out, "left out"),
        ):
            if count:
                parts.append(f"{count} {what}")
        return "; ".join(parts)
