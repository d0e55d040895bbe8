"""Images and videos are read here, as grey; images are written whole or not at all.

Images are read by OpenCV. Videos are read by PyAV (the extra `video`), which knows the time of each
frame and its size, keeps the levels of 10 to 16 bits, and refuses damaged frames. Both come
upright: photographs as their EXIF tag says, videos as their display matrix does.
"""

import contextlib
import dataclasses
import glob
import math
import os
import re
import stat
import struct
from collections.abc import Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError, check_kind
from cmp_cl.extras import extra
from cmp_cl.files import check_path, suffix_of, write_bytes
from cmp_cl.files import write_csv as write_csv  # a public name of this module
from cmp_cl.image import GreyImage

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".pnm", ".ppm"}
    | {".tif", ".tiff", ".webp"}
)
SUFFIXES_OF_16_BITS = frozenset({".jp2", ".pgm", ".png", ".pnm", ".tif", ".tiff"})
VIDEO_SUFFIXES = frozenset(  # a GIF is read as a video: it may have several frames
    {".264", ".265", ".3gp", ".asf", ".avi", ".flv", ".gif", ".h264", ".h265", ".hevc", ".m4v"}
    | {".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts"}
    | {".webm", ".wmv", ".y4m"}
)
# Demuxers of FFmpeg that read one file. Lists of other files, such as ffconcat, are not among them.
_DEMUXERS = (
    "asf,avi,flv,gif,h264,hevc,jpeg_pipe,m4v,matroska,mjpeg,mov,mpeg,mpegts,mpegvideo,mxf,ogg,"
    "yuv4mpegpipe"
)
_MOST_PIXELS = 1 << 28  # of a frame of a video
_MOST_PIPED = 1 << 28  # bytes of an image that comes through a pipe
_BLOCK = 1 << 26  # px of the pages of a stack that are decoded at once
_HEAD = 4096  # bytes
_MOST_PAGES = 1 << 20  # those of libtiff
_PLANAR = ("gray", "yuv")  # pixel formats of PyAV whose first plane is the grey levels

LONGEST_GAP = 250  # frames


def write_image(path: str | PathLike[str], image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write an image in the format of the suffix, whole or not at all.

    image: (H, W) or (H, W, 3) BGR. Raises ImageError if the suffix is not that of an image format,
        or the format cannot hold such pixels; OSError if the folder is missing or not writable.
    """
    check_kind("image", image, np.ndarray, ImageError)
    known = IMAGE_SUFFIXES if image.dtype == np.uint8 else SUFFIXES_OF_16_BITS
    written = suffix_of(path, ImageError) in known and image.dtype in (np.uint8, np.uint16)
    if written:
        try:
            written, data = cv2.imencode(Path(path).suffix, image)
        except cv2.error:
            written = False
    if not written:
        raise ImageError(
            f"cannot write {image.dtype} pixels of shape {image.shape} to {str(path)!r}; "
            "the suffix names the format, .png takes 8 and 16 bits"
        )
    write_bytes(path, data.tobytes())


def find_inputs(paths: Sequence[str | PathLike[str]]) -> list[Path]:
    """Return the files to read: folders are replaced by the images and videos in them, by name.

    Numbers in names count: 9.png comes before 10.png. Hidden files of a folder are left out. A name
    with `*`, `?` or `[` that is not a file is a pattern, because some shells do not expand it.

    Raises FileNotFoundError if a path does not exist, or a folder holds no image and no video.
    """
    if isinstance(paths, str | PathLike):
        raise FileNotFoundError(f"paths must be several names of files, not {os.fspath(paths)!r}")
    if not isinstance(paths, Iterable):
        raise FileNotFoundError(f"paths must be several names of files, not {paths!r}")
    found: list[Path] = []
    for name in paths:
        check_path(name, FileNotFoundError)
        path = Path(name)
        if path.is_dir():
            inside = [
                entry
                for entry in sorted(path.iterdir(), key=_by_number)
                if entry.suffix.lower() in IMAGE_SUFFIXES | VIDEO_SUFFIXES
                and not entry.name.startswith(".")
                and entry.is_file()
            ]
            if not inside:
                raise FileNotFoundError(f"no image and no video in the folder {str(path)!r}")
            found += inside
        elif path.exists():
            found.append(path)
        elif matches := glob.glob(str(path)):
            found += sorted(map(Path, matches), key=_by_number)
        else:
            raise FileNotFoundError(f"there is no file {os.fspath(name)!r}")
    return found


def _by_number(path: Path) -> list[str | int]:
    """Return the name in parts, texts and numbers in turn, by which 9.png sorts before 10.png."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [int(part) if place % 2 else part for place, part in enumerate(parts)]


def is_video(path: str | PathLike[str]) -> bool:
    """Return whether the suffix of a path is that of a video; raises ImageError for no path."""
    return suffix_of(path, ImageError) in VIDEO_SUFFIXES


def read_image(path: str | PathLike[str]) -> GreyImage:
    """Read an image file as (H, W) uint8 or uint16; colour becomes grey as cv2.imread does it.

    It reads the first of several pages, and rotates the image as its EXIF tag says. What is
    transparent becomes white. Raises ImageError if the file cannot be read, is damaged, has more
    pixels than OpenCV's limit (2**28, unless the variable OPENCV_IO_MAX_IMAGE_PIXELS is set before
    cmp_cl is imported), or is not an image of 8 or 16 bits.
    """
    return next(read_pages(path))


def read_pages(path: str | PathLike[str]) -> Iterator[GreyImage]:
    """Read the pages of an image file one by one, as `read_image` does.

    Only a TIFF has several. Raises ImageError on an animation, of which OpenCV gives one image.
    """
    return decoded_pages(_bytes_of(path), path)


def decoded_pages(data: NDArray[np.uint8], path: str | PathLike[str]) -> Iterator[GreyImage]:
    """Decode the pages of an image from its bytes, as `read_pages`; path names it in messages."""
    if not data.size:
        raise ImageError(f"{str(path)!r} is empty")
    head = bytes(data[:_HEAD])
    if b"ANIM" in head[:64] or b"acTL" in head.partition(b"IDAT")[0]:
        raise ImageError(
            f"{str(path)!r} is an animation, and OpenCV reads one image of it; save it as a GIF or "
            "a video"
        )
    promised = _promised_pages(data)
    first, count = 0, 1
    while pages := _decoded(data, path, first, count):
        yield from pages
        first += len(pages)
        if first >= promised or len(pages) < count:
            break
        count = max(1, _BLOCK // pages[0].size)  # OpenCV passes over all earlier pages again
    if not first:
        raise ImageError(f"{str(path)!r} is not an image that OpenCV can read, or is damaged")
    if first < promised:
        raise ImageError(f"{str(path)!r} is damaged or cut off: it has no page {first}, from 0")


def _promised_pages(data: NDArray[np.uint8]) -> int:
    """Return how many pages the directories of a TIFF lead to, 1 for another image.

    OpenCV does not report a page that is missing. A directory is its number of entries, the
    entries, and the place of the next one.
    """
    head = bytes(data[:4])
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or head[2:] not in (b"*\0", b"\0*", b"+\0", b"\0+"):
        return 1
    big = b"+" in head
    place, entries, size = ("Q", "Q", 20) if big else ("I", "H", 12)
    seen: set[int] = set()
    with contextlib.suppress(struct.error, OverflowError):  # it ends within a directory
        (next_one,) = struct.unpack_from(order + place, data.data, 8 if big else 4)
        while next_one and next_one not in seen and len(seen) < _MOST_PAGES:
            seen.add(next_one)
            (count,) = struct.unpack_from(order + entries, data.data, next_one)
            after = next_one + struct.calcsize(f"={entries}") + size * count
            (next_one,) = struct.unpack_from(order + place, data.data, after)
    return len(seen)


def _decoded(
    data: NDArray[np.uint8], path: str | PathLike[str], first: int, count: int
) -> list[GreyImage]:
    """Decode at most `count` pages as grey, from the page `first`; [] if that fails."""
    grey = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    try:
        pages: Any = cv2.imdecodemulti(data, grey, range=(first, first + count))[1]
    except cv2.error as error:
        if "MAX_IMAGE" not in str(error):
            return []
        raise ImageError(
            f"{str(path)!r} has more pixels than OpenCV's limit; the variable "
            "OPENCV_IO_MAX_IMAGE_PIXELS raises it"
        ) from error
    for page in pages:
        if page.dtype not in (np.uint8, np.uint16):
            raise ImageError(
                f"{str(path)!r} holds {page.dtype} pixels, expected 8 or 16 bits without sign; "
                "scale it and save it as PNG"
            )
    if _may_be_transparent(bytes(data[:_HEAD])) and any(not page.all() for page in pages):
        flags = cv2.IMREAD_UNCHANGED
        full = cv2.imdecodemulti(data, flags, range=(first, first + len(pages)))[1]
        return [_over_white(page, each) for page, each in zip(pages, full, strict=True)]
    return list(pages)


def _may_be_transparent(head: bytes) -> bool:
    if head.startswith(b"\x89PNG"):
        return head[25] in (4, 6) or b"tRNS" in head  # the colour types with alpha
    return not head.startswith((b"\xff\xd8", b"BM", b"P"))  # JPEG, BMP, PNM


def _over_white(grey: GreyImage, full: NDArray[Any]) -> GreyImage:
    """Return an image over a white ground; full: the same with its alpha, if it has one."""
    if full.ndim != 3 or full.shape[2] != 4 or full.shape[:2] != grey.shape:
        return grey
    white = np.iinfo(grey.dtype).max
    alpha = full[..., 3] / np.float32(white)
    over: Any = np.rint(grey * alpha + white * (1 - alpha)).astype(grey.dtype)
    return cast(GreyImage, over)


def _bytes_of(path: str | PathLike[str]) -> NDArray[np.uint8]:
    """Return the bytes of a file, mapped into memory, or those that come through a pipe."""
    check_path(path, ImageError)
    try:
        kind = os.stat(path).st_mode
        if stat.S_ISREG(kind):
            empty = not os.path.getsize(path)
            return np.empty(0, np.uint8) if empty else np.memmap(path, np.uint8, mode="r")
        if stat.S_ISFIFO(kind):
            with open(path, "rb") as file:
                data = file.read(_MOST_PIPED + 1)
            if len(data) <= _MOST_PIPED:
                return np.frombuffer(data, np.uint8)
            raise ImageError(f"over {_MOST_PIPED} bytes come from {str(path)!r}; save it as a file")
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error
    raise ImageError(f"{str(path)!r} is not a file")


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


def read_frames(path: str | PathLike[str]) -> Iterator[Frame]:
    """Read the frames of a video, or the pages of an image; colour becomes grey.

    Frames of more than 8 bits are uint16 with the levels of the file, such as 0 to 4095 for 12 bits
    (colour models other than grey and YUV are stretched to 16 bits). Frames that the file promises
    and does not hold, because it is cut off, come without an image; it ends early if `LONGEST_GAP`
    frames in a row cannot be read. Raises ImageError if the file cannot be read, is neither an
    image nor a video, or is too large; ConfigError if PyAV is not installed.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path)):
            yield Frame(index, page)
        return
    index = gap = 0
    end_ms = math.nan
    with _container(path) as (container, stream):
        for image, time_ms in _timed_frames(path, container, stream):
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
    """Return how many frames a file promises beyond those that were read, the last at `end_ms`."""
    if stream.frames:
        return max(0, int(stream.frames) - count)
    rate = float(stream.average_rate or 0)
    known = container.format.name.startswith("matroska") and container.duration is not None
    if not known or math.isnan(end_ms):  # other durations are estimates
        return 0
    if len(container.streams) > 1:
        end_ms += 1e3  # sound may go on
    return max(0, int((container.duration / 1e3 - end_ms) * rate / 1e3 - 0.5))


def _timed_frames(
    path: str | PathLike[str], container: Any, stream: Any
) -> Iterator[tuple[GreyImage | None, float]]:
    """Yield the frames of all packets and their times, ms; an unreadable packet gives None."""
    import av

    context = stream.codec_context
    if context.width * context.height > _MOST_PIXELS:
        raise ImageError(
            f"{str(path)!r} has {context.width} x {context.height} pixels, more than the limit of "
            f"{_MOST_PIXELS}"
        )
    most = 2 * _MOST_PIXELS  # decoders count whole blocks
    context.options = {"err_detect": "crccheck+explode", "max_pixels": str(most)}
    stream.thread_type = "SLICE"  # with a thread per frame, damage would be reported late
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except (av.FFmpegError, OSError, ValueError):  # the file ends within a packet
            return
        if packet is None:
            return
        try:
            frames = packet.decode()
        except (av.FFmpegError, OSError, ValueError):
            yield None, math.nan
            continue
        for frame in frames:
            broken = frame.is_corrupt or frame.width * frame.height > _MOST_PIXELS
            time_ms = math.nan if frame.time is None else float(frame.time) * 1e3
            yield None if broken else _upright(frame), time_ms


def _upright(frame: Any) -> GreyImage:
    """Return the grey levels of a frame of PyAV, rotated as its display matrix says."""
    quarters = round(frame.rotation / 90)
    return cast(GreyImage, np.ascontiguousarray(np.rot90(_luma(frame), quarters)))


def _luma(frame: Any) -> GreyImage:
    """Return the grey levels of a frame of PyAV."""
    name = frame.format.name
    if _bits(frame.format) <= 8:
        return np.asarray(frame.reformat(format="gray").to_ndarray(), np.uint8, order="C")
    if not (name.startswith(_PLANAR) and name.endswith("le")):
        return np.asarray(frame.reformat(format="gray16le").to_ndarray(), np.uint16, order="C")
    plane = frame.planes[0]  # unconverted, because a conversion would dither
    rows = np.frombuffer(plane, "<u2").reshape(plane.height, plane.line_size // 2)
    return rows[:, : plane.width].astype(np.uint16)


def _bits(pixels: Any) -> int:
    """Return the bits of the deepest component of a pixel format of PyAV."""
    return max((int(part.bits) for part in pixels.components), default=8)


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
            f"{str(path)!r} is not a video that PyAV can read; a list of other files is none"
        ) from error
    with container:
        if not container.streams.video:
            raise ImageError(f"{str(path)!r} has no video")
        stream = container.streams.video[0]
        if stream.codec_context is None:
            raise ImageError(f"{str(path)!r} has a codec that PyAV does not know")
        yield container, stream


def full_scale(path: str | PathLike[str]) -> int | None:
    """Return the largest grey level of a video of 9 to 15 bits, such as 4095; None for all others.

    It raises what `read_frames` does, as do `count_frames` and `frame_rate`.
    """
    if not is_video(path):
        return None
    with _container(path) as (_, stream):
        pixels = stream.codec_context.format
        name = "" if pixels is None else str(pixels.name)
        bits = 8 if pixels is None else _bits(pixels)
    return 2**bits - 1 if 8 < bits < 16 and name.startswith(_PLANAR) else None


def count_frames(path: str | PathLike[str]) -> int | None:
    """Return the number of frames that a video states; None for an image, or if it states none."""
    if not is_video(path):
        return None
    with _container(path) as (_, stream):
        return int(stream.frames) or None


def frame_rate(path: str | PathLike[str]) -> float | None:
    """Return the frames per second of a video; None for an image, or if it states none."""
    if not is_video(path):
        return None
    with _container(path) as (_, stream):
        rate = float(stream.average_rate or 0)
    return rate if 0 < rate < 1e6 else None


def grey_of(frame: NDArray[Any]) -> GreyImage:
    """Return a frame that OpenCV captured, in BGR or raw, as (H, W); raises ImageError."""
    if frame.ndim == 3 and frame.shape[2] == 3:
        return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    if frame.size != math.prod(frame.shape[:2]):
        raise ImageError(f"OpenCV delivers frames of shape {frame.shape}, neither grey nor BGR")
    return np.ascontiguousarray(frame.reshape(frame.shape[:2]))
