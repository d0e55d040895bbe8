"""A video of pictures, written by PyAV as H.264."""

import contextlib
import sys
from fractions import Fraction
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import extra
from cmp_cl.files import check_target, whole_file


class VideoFile(Closing):
    """Writes a video picture by picture, whole or not at all; use it in a with statement.

    path: .mp4. fps: pictures per second. Without a picture no file appears. Raises ConfigError
    without PyAV, OSError if the folder is missing, not writable or full.
    """

    def __init__(self, path: str | PathLike[str], *, fps: float) -> None:
        with extra("plot", "a video"):
            import av
        self._av, self._path = av, check_target(path)
        self._rate = Fraction(fps).limit_denominator(1001)
        self._files = contextlib.ExitStack()
        self._container: Any = None
        self._stream: Any = None

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Add a picture (H, W, 3), BGR, of one size; an odd last row or column is left out."""
        rows, columns = (side - side % 2 for side in picture.shape[:2])
        with self._removed_on_error():
            if self._stream is None:
                file = self._files.enter_context(whole_file(self._path))
                self._container = self._files.enter_context(self._av.open(file, "w", format="mp4"))
                self._stream = self._container.add_stream("h264", rate=self._rate)
                self._stream.width, self._stream.height = columns, rows
                self._stream.pix_fmt = "yuv420p"
                self._stream.options = {"preset": "veryfast", "crf": "18"}
            frame = np.ascontiguousarray(picture[:rows, :columns])
            self._write(self._av.VideoFrame.from_ndarray(frame, format="bgr24"))

    def _write(self, frame: Any) -> None:
        """Write a frame; None ends the stream."""
        for packet in self._stream.encode(frame):
            self._container.mux(packet)

    @contextlib.contextmanager
    def _removed_on_error(self) -> Any:
        try:
            yield
        except BaseException as error:
            self._discard()
            of_ffmpeg = isinstance(error, ValueError | self._av.FFmpegError)
            if of_ffmpeg and not isinstance(error, OSError):  # it lacks the codec, or room for it
                raise OSError(f"no video can be written to {str(self._path)!r}: {error}") from error
            raise

    def _discard(self) -> None:
        """Remove the video after the exception that is being handled."""
        self._stream = None
        with contextlib.suppress(self._av.FFmpegError):
            self._files.__exit__(*sys.exc_info())

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None:
            self._discard()
        self.close()

    def close(self) -> None:
        """Finish the video; closing again does nothing. Raises OSError if the disk is full."""
        if self._stream is None:
            return
        with self._removed_on_error():
            self._write(None)
            self._stream = None
            self._files.close()
