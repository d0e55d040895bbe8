"""Images and videos are read here, as grey; images are written whole or not at all.

Videos are read by PyAV if it is installed (the extra `video`), else by OpenCV. PyAV knows the
time of each frame and its size, keeps the levels of 10 to 16 bits, and refuses damaged frames.
OpenCV reduces all videos to 8 bits, and scales frames of another size to that of the first.
"""

import contextlib
import dataclasses
import glob
import importlib.util
import math
import os
import re
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError, check_kind, check_positive
from cmp_cl.files import check_path, suffix_of, write_bytes
from cmp_cl.files import write_csv as write_csv  # a public name of this module
from cmp_cl.image import GreyImage
from cmp_cl.image_size import page_sizes

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".pnm", ".ppm"}
    | {".tif", ".tiff", ".webp"}
)
SUFFIXES_OF_16_BITS = frozenset({".jp2", ".pgm", ".png", ".pnm", ".tif", ".tiff"})
VIDEO_SUFFIXES = frozenset(
    {".3gp", ".asf", ".avi", ".flv", ".m4v", ".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg"}
    | {".mpg", ".mts", ".mxf", ".ogv", ".ts", ".webm", ".wmv", ".y4m"}
)
MAX_PIXELS = 1 << 28  # of an image, unless the caller allows more
_MAX_PIPED = 1 << 28  # bytes of an image that comes through a pipe
_MAX_SAID = 1 << 12  # bytes of a codec's messages

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


def read_image(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> GreyImage:
    """Read an image file as (H, W) uint8 or uint16; colour becomes grey as cv2.imread does it.

    It reads the first of several pages, and rotates the image as its EXIF tag says. Raises
    ImageError if the file cannot be read, is damaged, has more than `max_pixels` pixels, or is not
    an image of 8 or 16 bits.
    """
    return next(read_pages(path, max_pixels=max_pixels))


def read_pages(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Iterator[GreyImage]:
    """Read the pages of an image file, such as a TIFF stack, one by one; the arguments are those of
    `read_image`. Of an animation, such as a GIF, it reads only the first image."""
    return decoded_pages(_bytes_of(path), path, max_pixels=max_pixels)


def decoded_pages(
    data: NDArray[np.uint8], path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS
) -> Iterator[GreyImage]:
    """Decode the pages of an image from its bytes, as `read_pages`; path names it in messages."""
    if not data.size:
        raise ImageError(f"{str(path)!r} is empty")
    try:
        sizes = page_sizes(data.data)
    except ValueError as error:
        raise ImageError(f"{str(path)!r} is not an image that OpenCV can read: {error}") from error
    number = 0
    while sizes is None or number < len(sizes):
        if sizes is not None:
            _check_size(path, sizes[number], max_pixels)
        page, said = _decoded(data, number)
        if page is None and sizes is None and number:
            return
        if page is None or _tells_damage(said):
            what = "is not an image that OpenCV can read" if page is None else "is damaged"
            raise ImageError(f"{str(path)!r} {what}{f': {said}' if said else ''}")
        if page.dtype not in (np.uint8, np.uint16):
            raise ImageError(
                f"{str(path)!r} holds {page.dtype} pixels, expected 8 or 16 bits without sign; "
                "scale it and save it as PNG"
            )
        _check_size(path, (page.shape[1], page.shape[0]), max_pixels)
        yield page
        number += 1


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
                data = file.read(_MAX_PIPED + 1)
            if len(data) <= _MAX_PIPED:
                return np.frombuffer(data, np.uint8)
            raise ImageError(f"over {_MAX_PIPED} bytes come from {str(path)!r}; save it as a file")
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error
    raise ImageError(f"{str(path)!r} is not a file")


def _decoded(data: NDArray[np.uint8], page: int) -> tuple[NDArray[Any] | None, str]:
    """Decode a page, None if that fails; return the codec's messages too."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    pages: Sequence[NDArray[Any]] = ()
    with _codec_messages() as said, contextlib.suppress(cv2.error):
        pages = cv2.imdecodemulti(data, flags, range=(page, page + 1))[1]
    return (pages[0] if pages else None), "; ".join(said)


def _tells_damage(said: str) -> bool:
    """Return whether a codec reports damage although it gave an image, as libjpeg does."""
    return "Corrupt JPEG data" in said or "Premature end of JPEG" in said


def _check_size(path: str | PathLike[str], size: tuple[int, int], most: int) -> None:
    check_positive("max_pixels", most, ImageError)
    width, height = size
    if width * height > most:
        raise ImageError(
            f"{str(path)!r} has {width} x {height} pixels, more than the limit of {most}; "
            f"max_pixels={width * height} raises it"
        )


_catching = False


@contextlib.contextmanager
def codec_messages_caught() -> Iterator[None]:
    """Catch the messages of codecs on stderr, and treat reported damage as an error.

    It is for a command, whose process owns stderr: everything written there while an image is
    decoded is caught.
    """
    global _catching
    before, _catching = _catching, True
    try:
        yield
    finally:
        _catching = before


@contextlib.contextmanager
def _codec_messages() -> Iterator[list[str]]:
    """Catch the lines that codecs write to stderr within the block, if the system allows it."""
    lines: list[str] = []
    if not _catching:
        yield lines
        return
    sys.stderr.flush()
    before = os.dup(2)
    try:
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), 2)
            try:
                yield lines
            finally:
                os.dup2(before, 2)
                file.seek(0)
                text = file.read(_MAX_SAID).decode("utf-8", "replace")
                lines += [line.strip() for line in text.splitlines() if line.strip()][:4]
    finally:
        os.close(before)


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One image of a file or a camera.

    index: its number there, from 0.
    image: (H, W) uint8 or uint16, or None if it cannot be read.
    time_ms: the time of a camera's frame or in the video, or from its frame rate if PyAV is not
        installed; NaN if unknown.
    why: why a file of a folder gives no image; "" if it is not known.
    """

    index: int
    image: GreyImage | None
    time_ms: float = math.nan
    why: str = ""


def read_frames(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Iterator[Frame]:
    """Read the frames of a video, or the pages of an image; colour becomes grey.

    With PyAV, frames of more than 8 bits are uint16 with the levels of the file, such as 0 to 4095
    for 12 bits (colour models other than grey and YUV are stretched to 16 bits). A video ends early
    if `LONGEST_GAP` frames in a row cannot be read. Raises ImageError if the file cannot be read,
    is neither an image nor a video, or has more than `max_pixels` pixels in a frame.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path, max_pixels=max_pixels)):
            yield Frame(index, page)
        return
    frames = _by_pyav(path, max_pixels) if has_pyav() else _by_opencv(path, max_pixels)
    count = count_frames(path) or 0
    index = gap = 0
    for image, time_ms in frames:
        gap = 0 if image is not None else gap + 1
        yield Frame(index, image, time_ms)
        index += 1
        if gap == LONGEST_GAP:
            return
    while index < count and gap < LONGEST_GAP:
        yield Frame(index, None)
        index, gap = index + 1, gap + 1


def has_pyav() -> bool:
    """Return whether PyAV is installed."""
    return importlib.util.find_spec("av") is not None


_Timed = tuple[GreyImage | None, float]  # a frame, None if it is broken, and its time in ms


def _by_opencv(path: str | PathLike[str], max_pixels: int) -> Iterator[_Timed]:
    """Yield the frames up to the last readable one; unreadable ones before it are None."""
    rate = frame_rate(path)
    with _opened(path) as capture:
        width, height = (
            int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        _check_size(path, (width, height), max_pixels)
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        index = 0
        while True:
            with _codec_messages() as said:
                read, picture = capture.read()
            read = read and not _tells_damage("; ".join(said))
            if not read and index >= count:
                return
            yield (
                (grey_of(picture) if read else None),
                math.nan if rate is None else 1e3 * index / rate,
            )
            index += 1


def _by_pyav(path: str | PathLike[str], max_pixels: int) -> Iterator[_Timed]:
    """Yield the frames of all packets; an unreadable packet gives None."""
    import av

    with _container(path) as (container, stream):
        context = stream.codec_context
        _check_size(path, (context.width, context.height), max_pixels)
        most = 2 * max_pixels + (1 << 16)  # decoders count whole blocks
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
                broken = frame.is_corrupt or frame.width * frame.height > max_pixels
                yield None if broken else _luma(frame), _time_of(frame)


def _time_of(frame: Any) -> float:
    return math.nan if frame.time is None else float(frame.time) * 1e3


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
    import av

    _check_readable(path)
    try:
        container = av.open(os.path.abspath(path))  # so that it is not taken for an address
    except (av.FFmpegError, OSError, ValueError) as error:
        raise ImageError(f"{str(path)!r} is not a video that PyAV can read") from error
    with container:
        if not container.streams.video:
            raise ImageError(f"{str(path)!r} has no video")
        yield container, container.streams.video[0]


def full_scale(path: str | PathLike[str]) -> int | None:
    """Return the largest grey level of a video of 9 to 15 bits, such as 4095; None for all others.

    Only PyAV knows it.
    """
    if not (is_video(path) and has_pyav()):
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
    if has_pyav():
        with _container(path) as (_, stream):
            return int(stream.frames) or None
    with _opened(path) as capture:
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    return int(count) if 0 < count < 2**31 else None


def frame_rate(path: str | PathLike[str]) -> float | None:
    """Return the frames per second of a video; None for an image, or if it states none."""
    if not is_video(path):
        return None
    if has_pyav():
        with _container(path) as (_, stream):
            rate = float(stream.average_rate or 0)
    else:
        with _opened(path) as capture:
            rate = capture.get(cv2.CAP_PROP_FPS)
    return rate if 0 < rate < 1e6 else None


@contextlib.contextmanager
def _opened(path: str | PathLike[str]) -> Iterator[cv2.VideoCapture]:
    _check_readable(path)
    # An absolute path is never taken for an address or for a pipeline of commands.
    capture = cv2.VideoCapture(os.path.abspath(path))
    try:
        if not capture.isOpened():
            raise ImageError(f"{str(path)!r} is not a video that OpenCV can read")
        yield capture
    finally:
        capture.release()


def _check_readable(path: str | PathLike[str]) -> None:
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error


def grey_of(frame: NDArray[Any]) -> GreyImage:
    """Return a frame that OpenCV captured, in BGR or raw, as (H, W); raises ImageError."""
    if frame.ndim == 3 and frame.shape[2] == 3:
        return np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.uint8)
    if frame.size != math.prod(frame.shape[:2]):
        raise ImageError(f"OpenCV delivers frames of shape {frame.shape}, neither grey nor BGR")
    return np.ascontiguousarray(frame.reshape(frame.shape[:2]))
