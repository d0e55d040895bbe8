"""A gel and its cameras as a sensor: frames arrive in a thread, with the calls of PyTac3D."""

import atexit
import contextlib
import math
import threading
import time
from collections.abc import Callable, Generator, Mapping
from os import PathLike
from types import SimpleNamespace
from typing import Any

from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import ConfigError, FieldError, ImageError, check_range
from cmp_cl.field.field import frame_of_pytac3d
from cmp_cl.measure.measured import Measured
from cmp_cl.measure.two_views import TwoViews
from cmp_cl.media.ahead import Ahead
from cmp_cl.media.cameras import Source
from cmp_cl.opencl.device import Device
from cmp_cl.series import SeriesWriter, read_series
from cmp_cl.series.writer import check_series
from cmp_cl.space import BinocularSplit, StereoRig

Frame = dict[str, Any]
Callback = Callable[[Frame, Any], object]

_WARNINGS = "ambiguous", "misfit"  # of a frame: all of it may be wrong


class Frames(Closing):
    """Frames of a thread, of which the newest few wait to be taken, with the calls of PyTac3D.

    frames: makes them. recvCallback: is called in the thread with each frame and `callbackParam`.
    maxQSize: how many frames wait; older ones are dropped. Raises ConfigError if that is under 1.
    """

    def __init__(
        self,
        frames: Generator[Frame, None, None],
        recvCallback: Callback | None = None,
        maxQSize: int = 5,
        callbackParam: Any = None,
    ) -> None:
        check_range("maxQSize", maxQSize, 1, 10**6, kind=int)

        def told() -> Generator[Frame, None, None]:
            with contextlib.closing(frames):
                for frame in frames:
                    yield frame
                    if recvCallback is not None:
                        recvCallback(frame, callbackParam)

        self._newest = Ahead(told(), maxQSize, lossy=True)

    def getFrame(self, SN: str = "") -> Frame | None:
        """Return the oldest frame that waits, None if none does; raise what ended the loop.

        The dictionary is that of `DisplacementField.as_pytac3d`, with `ambiguous` and `misfit`,
        bool, of `Measured`: if one is True, all of the frame may be wrong, by whole cells. A replay
        has those that the series has. SN: ignored; a sensor is one.
        """
        del SN
        return self._newest.take(0)

    def waitForFrame(self, SN: str = "", timeout: float = math.inf) -> None:
        """Wait until a frame is there, as long as `timeout`, s.

        SN: ignored. Raises ImageError if none came or will come, or what ended the loop.
        """
        del SN
        if not self._newest.wait(timeout):
            if self._newest.ended:
                raise ImageError("the source has ended: there are no further frames")
            raise ImageError(f"no frame came within {timeout:g} s")

    def close(self) -> None:
        """End the loop and wait for it."""
        self._newest.close()


class Sensor(Frames):
    """Measures the frames of a source in a thread, against its first frame or a later one.

    source: a camera's number, also as an int, a device, an address or a video, whose frames hold
        two views, see `cmp_cl.media.cameras.Source`. The gel is at rest in the first one.
    rig: the cameras, or the path of their file. split: the two views in a frame; None is halves.
    shape: (rows, columns) of the pattern's corners; None takes what is seen at rest.
    serial: the name of the sensor in its frames.
    device: as for `Detector`. The others are those of `Frames`.

    Of a camera no more than maxQSize frames wait to be measured either: if measuring or a callback
    takes longer than a frame, frames are missed, and those that come are new.

    Raises ConfigError, FileNotFoundError or ImageError for a source or a rig that cannot be opened.
    What happens in the thread is raised by `getFrame` and `waitForFrame`: GridError if the frame at
    rest shows no pattern, ImageError if a camera fails, what a callback raises.

        with Sensor("0", "rig.yaml", shape=(40, 40)) as sensor:
            sensor.waitForFrame()
            frame = sensor.getFrame()
            if frame and not (frame["ambiguous"] or frame["misfit"]):
                moved = frame["3D_Displacements"]
    """

    def __init__(
        self,
        source: str | int,
        rig: StereoRig | str | PathLike[str],
        *,
        split: BinocularSplit | None = None,
        shape: tuple[int, int] | None = None,
        serial: str = "",
        recvCallback: Callback | None = None,
        maxQSize: int = 5,
        callbackParam: Any = None,
        device: Device | str | None = None,
    ) -> None:
        name = str(source) if isinstance(source, int) else source
        self._source = Source(name, waiting=maxQSize)
        self._rig = rig if isinstance(rig, StereoRig) else StereoRig.load(rig)
        self._split, self._shape, self._device = split, shape, device
        self._serial = serial
        self._lock = threading.Lock()  # of the three below
        self._new_rest = True
        self._series: SeriesWriter | None = None
        self._path: str | PathLike[str] | None = None
        super().__init__(self._frames(), recvCallback, maxQSize, callbackParam)

    def calibrate(self, SN: str = "") -> None:
        """Take the next frame as the one at rest: nothing may touch the gel then.

        SN: ignored. Raises ConfigError while a series is recorded, which has one frame at rest.
        """
        del SN
        with self._lock:
            if self._path is not None or self._series is not None:
                raise ConfigError("stop recording first, record(None): a series has one rest")
            self._new_rest = True

    def record(self, path: str | PathLike[str] | None) -> None:
        """Write the frames from the next one on to a series, in the format of the suffix; after
        `calibrate`, from the frame at rest on.

        None ends it and completes the file, as the end of the process does. Raises ConfigError if
        one is being written already, ImageError if the source has ended, and what `SeriesWriter`
        does for a path.
        """
        with self._lock:
            if path is None:
                self._end_series()
            elif self._path is not None or self._series is not None:
                raise ConfigError("a series is being recorded; end it by record(None)")
            else:
                check_series(path)
                if self._newest.ended:
                    raise ImageError("the source has ended: there are no further frames")
                atexit.register(self.close)
            self._path = path

    @staticmethod
    def replay(path: str | PathLike[str], *, serial: str = "", **settings: Any) -> Frames:
        """Return the frames of a series, .npz or .h5, at their times after the first one.

        settings: recvCallback, maxQSize and callbackParam. Raises FieldError if the file is no
        series in space.
        """
        needed = "rest", "displacement", "time_ms", "unit"
        series = read_series(path, (*needed, *_WARNINGS))
        if not series.keys() >= set(needed) or series["rest"].shape[2] != 3:
            raise FieldError(
                f"{str(path)!r}: a sensor replays a series in space, of two views, with its unit"
            )
        return _Replay(series, serial, **settings)

    def close(self) -> None:
        """End the loop, complete the series, and release the device."""
        super().close()
        with self._lock:
            self._end_series()

    def _frames(self) -> Generator[Frame, None, None]:
        measure: TwoViews | None = None
        with contextlib.closing(self._source.frames()) as frames, contextlib.ExitStack() as opened:
            for frame in frames:
                if frame.image is None:
                    continue
                with self._lock:
                    again, self._new_rest = self._new_rest, False
                if again or measure is None:
                    opened.close()
                    split = self._split or BinocularSplit.halves(*frame.image.shape[::-1])
                    measure = TwoViews(
                        frame.image, self._rig, split, shape=self._shape, device=self._device
                    )
                    opened.enter_context(measure)
                    at_rest = frame.index
                measured = measure(frame.image)
                ambiguous = measured.ambiguous and frame.index != at_rest  # it has its own numbers
                self._keep(measure, measured, frame.index, frame.time_ms, ambiguous=ambiguous)
                field = measured.field.as_pytac3d(
                    serial=self._serial, index=frame.index, time_s=frame.time_ms / 1e3
                )
                yield {**field, "ambiguous": ambiguous, "misfit": measured.misfit}
        if self._source.live:
            raise ImageError(f"{self._source.name} delivers no frames any more: was it unplugged?")

    def _keep(
        self, measure: TwoViews, measured: Measured, index: int, time_ms: float, *, ambiguous: bool
    ) -> None:
        with self._lock:
            if self._path is not None and not self._new_rest:  # else measure has the old one
                self._series = SeriesWriter(self._path, settings=None, **measure.constants)
                self._path = None
            if self._series is not None:
                self._series.append(
                    index=index, time_ms=time_ms, ambiguous=ambiguous, **measured.arrays
                )

    def _end_series(self) -> None:
        atexit.unregister(self.close)
        self._path = None
        if self._series is not None:
            series, self._series = self._series, None
            series.close()


class _Replay(Frames):
    """The frames of a series, at their times."""

    def __init__(self, series: Mapping[str, NDArray[Any]], serial: str, **settings: Any) -> None:
        self._closing = threading.Event()
        super().__init__(self._frames(series, serial), **settings)

    def _frames(
        self, series: Mapping[str, NDArray[Any]], serial: str
    ) -> Generator[Frame, None, None]:
        start = math.nan  # of the clock of the series
        for number, (index, time_ms, moved) in enumerate(
            zip(series["index"], series["time_ms"], series["displacement"], strict=True)
        ):
            time_s = float(time_ms) / 1e3
            if math.isnan(start):
                start = time.monotonic() - time_s  # the first frame comes at once
            pause = start + time_s - time.monotonic()
            if pause > 0 and self._closing.wait(min(pause, threading.TIMEOUT_MAX)):
                return
            frame = frame_of_pytac3d(
                series["rest"],
                moved,
                str(series["unit"]),
                serial=serial,
                index=int(index),
                time_s=time_s,
            )
            known = [name for name in _WARNINGS if name in series]
            yield {**frame, **{name: bool(series[name][number]) for name in known}}

    def close(self) -> None:
        """End the loop, also in a pause, and wait for it."""
        self._closing.set()
        super().close()


def pytac3d(
    source: str | int, rig: StereoRig | str | PathLike[str], **settings: Any
) -> SimpleNamespace:
    """Return what stands for the module PyTac3D in a script that was written for it.

    source, rig, settings: of `Sensor`. In the script only the import changes:

        from cmp_cl.measure import pytac3d
        PyTac3D = pytac3d("0", "rig.yaml", shape=(40, 40), serial="gel-1")

    `PyTac3D.Sensor` takes recvCallback, maxQSize and callbackParam; its port is ignored. There are
    no forces in a frame: `frame.get("3D_Forces")` is None.
    """

    def sensor(
        recvCallback: Callback | None = None,
        port: int = 9988,
        maxQSize: int = 5,
        callbackParam: Any = None,
    ) -> Sensor:
        del port
        return Sensor(
            source,
            rig,
            recvCallback=recvCallback,
            maxQSize=maxQSize,
            callbackParam=callbackParam,
            **settings,
        )

    return SimpleNamespace(Sensor=sensor, PYTAC3D_VERSION="cmp_cl")
