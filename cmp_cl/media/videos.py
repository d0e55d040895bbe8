"""Videos, read by PyAV, and the frames of any file."""

import contextlib
import dataclasses
import math
import os
import warnings
import zlib
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
_REORDERED = 16  # frames by which H.264 and H.265 may store one before its turn
_DAMAGED, _AFTER = "", "it builds on a damaged frame"
_FOOTER, _WITHOUT_CRC = 8, 3  # bytes at the end of a slice of FFV1 (RFC 9043, 4.9)
# Its checksum takes the bits of a byte from the other end than zlib, and begins with 0.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ALL_ONES = 2**32 - 1

_INTERLACED = (
    "{!r} is interlaced: every second line is of another moment, so that corners that move are "
    "wrong; deinterlace it first, for example by ffmpeg -i IN -vf bwdif=send_frame OUT"
)

_Timed = tuple[GreyImage | None, float, str]


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
    """Return whether the suffix of a path is that of a video."""
    return suffix_of(path) in VIDEO_SUFFIXES


def read_frames(path: str | PathLike[str]) -> Iterator[Frame]:
    """Read the frames of a video, or the pages of an image; colour becomes grey.

    Frames of more than 8 bits are uint16 with the levels of the file, such as 0 to 4095 for 12 bits
    (colour models other than grey and YUV are stretched to 16 bits). Frames that cannot be decoded,
    those that build on such a frame, and those that the file promises and does not hold, because
    it is cut off, come without an image; it ends early if 250 in a row cannot be decoded. Raises
    ImageError if the file cannot be read, or is neither an image nor a video; ConfigError if PyAV
    is not installed.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path)):
            yield Frame(index, page)
        return
    index = gap = 0
    end_ms = math.nan
    with _container(path) as (container, stream):
        for image, time_ms, why in _timed_frames(container, stream):
            gap = gap + 1 if image is None and why == _DAMAGED else 0
            end_ms = time_ms
            yield Frame(index, image, time_ms, why)
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
        stream = next(iter(container.streams.video), None)
        if stream is None or stream.codec_context is None:
            raise ImageError(f"{str(path)!r} has no video of a codec that PyAV knows")
        yield container, stream


def _timed_frames(container: Any, stream: Any) -> Iterator[_Timed]:
    """Yield the frames in turn: each image, its time, ms, and why there is no image.

    After damage there is none up to a frame that begins anew. A packet whose frame a decoder then
    leaves out is a frame without an image.
    """
    due: dict[float, str] = {}  # times of packets, and why their frames have no image after damage
    broken, last_ms = False, math.nan  # time of the last damage
    interlaced = False
    for stamp_ms, frames in _decoded(container, stream):
        if frames is None:
            broken, last_ms = True, stamp_ms
        why = _DAMAGED if frames is None else _AFTER
        if not math.isnan(stamp_ms):
            due[stamp_ms] = why
        elif frames is None:
            yield None, stamp_ms, why
        for frame in frames or ():
            time_ms = _ms(frame.pts, frame)
            if frame.interlaced_frame and not interlaced:
                interlaced = True
                warnings.warn(_INTERLACED.format(container.name), stacklevel=2)
            yield from _overdue(due, time_ms, told=broken)
            why = due.pop(time_ms, _AFTER)
            if frame.is_corrupt:
                why, last_ms = _DAMAGED, time_ms
            anew = frame.key_frame and not time_ms < last_ms
            broken = why == _DAMAGED or (broken and not anew)
            yield (None, time_ms, why) if broken else (_upright(frame), time_ms, "")
        if len(due) > _REORDERED:
            yield from _overdue(due, sorted(due)[-_REORDERED], told=broken)
    yield from _overdue(due, math.inf, told=broken)


def _overdue(due: dict[float, str], before_ms: float, *, told: bool) -> Iterator[_Timed]:
    """Remove the frames that are due before a time, since they come no more; yield them if told."""
    for time_ms in sorted(each for each in due if each < before_ms):
        why = due.pop(time_ms)
        if told:
            yield None, time_ms, why


def _decoded(container: Any, stream: Any) -> Iterator[tuple[float, list[Any] | None]]:
    """Yield the time of each packet, ms, and the frames that it completes, None if it is damaged.

    Frames come in order of time, packets in the order of decoding.
    """
    import av

    damage = (av.FFmpegError, OSError, ValueError)
    codec = stream.codec_context
    codec.options = {"err_detect": "crccheck+explode"}
    # In several threads most decoders tell of damage late or never.
    stream.thread_type = "SLICE" if codec.name == "ffv1" else "NONE"
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
        frames = None
        if codec.name != "ffv1" or not codec.extradata or _is_whole(bytes(packet)):
            with contextlib.suppress(*damage):
                frames = packet.decode()
        yield _ms(packet.dts if packet.pts is None else packet.pts, packet), frames


def _ms(stamp: int | None, of: Any) -> float:
    """Return a time stamp of a packet or frame, ms; NaN if it has none."""
    if stamp is None or of.time_base is None:
        return math.nan
    return float(1000 * stamp * of.time_base)


def _is_whole(packet: bytes) -> bool:
    """Return whether all slices of a packet of FFV1 have their checksums, if it has any: PyAV
    shows a damaged one as it was in the frame before."""
    if not packet or _slices(packet, _WITHOUT_CRC):
        return True
    slices = _slices(packet, _FOOTER)
    return bool(slices) and all(
        zlib.crc32(each.translate(_REVERSED), _ALL_ONES) == _ALL_ONES for each in slices
    )


def _slices(packet: bytes, footer: int) -> list[bytes]:
    """Return the slices of a packet of FFV1, each with its size in its footer; [] if they do not
    fill it."""
    slices, end = [], len(packet)
    while end > 0:
        size = int.from_bytes(packet[end - footer : end - footer + 3]) + footer
        slices.append(packet[max(end - size, 0) : end])
        end -= size
    return [] if end else slices


def _upright(frame: Any) -> GreyImage:
    """Return the grey levels of a frame of PyAV, upright, as its display matrix says."""
    grey, matrix = _luma(frame), frame.side_data.get("DISPLAYMATRIX")
    if matrix is not None:
        xx, xy, _, yx, yy = np.frombuffer(matrix, np.int32)[:5]  # of (x, y) before this matrix
        if abs(xy) > abs(xx):
            grey, xx, yy = grey.T, yx, xy
        grey = grey[:: -1 if yy < 0 else 1, :: -1 if xx < 0 else 1]
    return cast(GreyImage, np.ascontiguousarray(grey))


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
