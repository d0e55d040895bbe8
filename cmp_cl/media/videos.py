"""Videos, read by PyAV, and the frames of any file."""

import contextlib
import dataclasses
import math
import os
from collections.abc import Iterator
from os import PathLike
from typing import Any, NamedTuple, cast

import numpy as np

from cmp_cl.errors import ImageError, extra
from cmp_cl.files import suffix_of
from cmp_cl.image import GreyImage
from cmp_cl.media.images import VIDEO_SUFFIXES, read_pages

LONGEST_GAP = 250  # frames in a row that cannot be read, after which a video or a camera has ended
_DEMUXERS = (  # real containers: others, such as ffconcat, are lists of files that are followed
    "asf,avi,flv,gif,h264,hevc,jpeg_pipe,m4v,matroska,mjpeg,mov,mpeg,mpegts,mpegvideo,mxf,ogg,"
    "yuv4mpegpipe"
)
_PLANAR = ("gray", "yuv")  # pixel formats of PyAV whose first plane is the grey levels


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One image of a file or a camera.

    index: its number there, from 0.
    image: (H, W) uint8 or uint16, or None if it cannot be read.
    time_ms: the time of a camera's frame or in the video; NaN if unknown.
    why: why there is no image; "" if it is not known.
    """

    index: int
    image: GreyImage | None
    time_ms: float = math.nan
    why: str = ""


class VideoInfo(NamedTuple):
    """What a video states, None for what it does not; all are None for an image.

    frames: their number. rate: frames per second. full_scale: the largest grey level of 9 to 15
    bits, such as 4095 for 12.
    """

    frames: int | None = None
    rate: float | None = None
    full_scale: int | None = None


def is_video(path: str | PathLike[str]) -> bool:
    """Return whether the suffix of a path is that of a video; raises ImageError for no path."""
    return suffix_of(path, ImageError) in VIDEO_SUFFIXES


def read_frames(path: str | PathLike[str]) -> Iterator[Frame]:
    """Read the frames of a video, or the pages of an image; colour becomes grey.

    Frames of more than 8 bits are uint16 with the levels of the file, such as 0 to 4095 for 12 bits
    (colour models other than grey and YUV are stretched to 16 bits). Frames that cannot be decoded,
    and those that the file promises and does not hold, because it is cut off, come without an
    image; it ends early if 250 in a row cannot be read. Raises ImageError if the file cannot be
    read, or is neither an image nor a video; ConfigError if PyAV is not installed.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path)):
            yield Frame(index, page)
        return
    index = gap = 0
    end_ms = math.nan
    with _container(path) as (container, stream):
        for image, time_ms in _timed_frames(container, stream):
            gap = 0 if image is not None else gap + 1
            end_ms = time_ms
            yield Frame(index, image, time_ms)
            index += 1
            if gap == LONGEST_GAP:
                return
        missing = _missing(container, stream, index, end_ms)
    for number in range(min(missing, LONGEST_GAP - gap)):
        yield Frame(index + number, None, why="the file is cut off")


def _missing(container: Any, stream: Any, count: int, end_ms: float) -> int:
    """Return how many frames a file promises beyond the `count` that were read.

    end_ms: the time of the last one. A Matroska promises no number of frames, but a duration.
    """
    if stream.frames:
        return max(0, int(stream.frames) - count)
    rate = float(stream.average_rate or 0)
    known = container.format.name.startswith("matroska") and container.duration is not None
    if not known or math.isnan(end_ms):  # other durations are estimates
        return 0
    if len(container.streams) > 1:
        end_ms += 1e3  # sound may go on
    return max(0, int((container.duration / 1e3 - end_ms) * rate / 1e3 - 0.5))


def video_info(path: str | PathLike[str]) -> VideoInfo:
    """Return what a video states; raises what `read_frames` does."""
    if not is_video(path):
        return VideoInfo()
    with _container(path) as (_, stream):
        pixels = stream.codec_context.format
        bits = 8 if pixels is None else _bits(pixels)
        deep = 8 < bits < 16 and str(pixels.name).startswith(_PLANAR)
        rate = float(stream.average_rate or 0)
        return VideoInfo(
            frames=int(stream.frames) or None,
            rate=rate if 0 < rate < 1e6 else None,
            full_scale=2**bits - 1 if deep else None,
        )


@contextlib.contextmanager
def _container(path: str | PathLike[str]) -> Iterator[tuple[Any, Any]]:
    """Open a video by PyAV, with its video stream."""
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error
    with extra("video", "reading a video"):
        import av
    options = {"format_whitelist": _DEMUXERS, "protocol_whitelist": "file"}
    try:  # an absolute path is not taken for an address
        container = av.open(os.path.abspath(path), options=options)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ImageError(
            f"{str(path)!r} is no video that PyAV can read: it is damaged, not yet complete, or a "
            "list of other files"
        ) from error
    with container:
        if not container.streams.video:
            raise ImageError(f"{str(path)!r} has no video")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise ImageError(f"{str(path)!r} has a codec that PyAV does not know")
        yield container, stream


def _timed_frames(container: Any, stream: Any) -> Iterator[tuple[GreyImage | None, float]]:
    """Yield the frames of all packets and their times, ms; an unreadable packet gives None."""
    import av

    damage = (av.FFmpegError, OSError, ValueError)
    stream.codec_context.options = {"err_detect": "crccheck+explode"}
    stream.thread_type = "SLICE"  # with a thread per frame, damage would be reported late
    codec = stream.codec_context
    if codec.name == "mjpeg" and str(codec.pix_fmt).startswith("yuv"):
        codec.flags |= av.codec.context.Flags.gray  # a fifth faster; no colour, the same grey
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except damage:  # the file ends within a packet
            return
        if packet is None:
            return
        try:
            frames = packet.decode()
        except damage:
            yield None, math.nan
            continue
        for frame in frames:
            time_ms = math.nan if frame.time is None else float(frame.time) * 1e3
            image: GreyImage | None = None
            if not frame.is_corrupt:  # upright, as its display matrix says
                turned = np.rot90(_luma(frame), round(frame.rotation / 90))
                image = cast(GreyImage, np.ascontiguousarray(turned))
            yield image, time_ms


def _luma(frame: Any) -> GreyImage:
    """Return the grey levels of a frame of PyAV."""
    name = frame.format.name
    if name.startswith("yuvj"):  # of all 256 levels, so that no conversion is needed
        return _levels(frame.planes[0], "u1")
    if _bits(frame.format) <= 8:
        return np.asarray(frame.reformat(format="gray").to_ndarray(), np.uint8, order="C")
    if not (name.startswith(_PLANAR) and name.endswith("le")):
        return np.asarray(frame.reformat(format="gray16le").to_ndarray(), np.uint16, order="C")
    return _levels(frame.planes[0], "<u2")  # unconverted, because a conversion would dither


def _levels(plane: Any, dtype: str) -> GreyImage:
    """Return a copy of a plane of PyAV."""
    rows = np.frombuffer(plane, dtype).reshape(plane.height, -1)
    return cast(GreyImage, rows[:, : plane.width].astype(dtype[-2:]))


def _bits(pixels: Any) -> int:
    """Return the bits of the deepest component of a pixel format of PyAV."""
    return max((int(part.bits) for part in pixels.components), default=8)
