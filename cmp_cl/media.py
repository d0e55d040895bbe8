"""Images, videos and tables: read as grey, written whole or not at all."""

import contextlib
import csv
import dataclasses
import os
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError
from cmp_cl.files import write_bytes
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
MAX_PIXELS = 1 << 28  # of an image, unless a caller says more
_MAX_PIPED = 1 << 28  # bytes of an image that comes through a pipe
_MAX_SAID = 1 << 12  # bytes of what a codec says

LONGEST_GAP = 250  # frames


def write_image(path: str | PathLike[str], image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write an image in the format of the suffix, whole or not at all.

    image: (H, W) or (H, W, 3) BGR. Raises ImageError for a suffix that is no image's or
    holds no such pixels, OSError where the folder is missing or not writable.
    """
    known = IMAGE_SUFFIXES if image.dtype == np.uint8 else SUFFIXES_OF_16_BITS
    written = Path(path).suffix.lower() in known
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
    """The files to read: folders replaced by the images and videos in them, by name.

    Raises FileNotFoundError for a path that is not there and for a folder without any.
    """
    found: list[Path] = []
    for name in paths:
        path = Path(name)
        if not os.fspath(name):
            raise FileNotFoundError("there is no file ''")
        if path.is_dir():
            inside = [
                entry
                for entry in sorted(path.iterdir())
                if entry.suffix.lower() in IMAGE_SUFFIXES | VIDEO_SUFFIXES and entry.is_file()
            ]
            if not inside:
                raise FileNotFoundError(f"no image and no video in the folder {str(path)!r}")
            found += inside
        elif path.exists():
            found.append(path)
        else:
            raise FileNotFoundError(f"there is no file {str(path)!r}")
    return found


def is_video(path: str | PathLike[str]) -> bool:
    """Whether the name is one of a video."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES


def read_image(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> GreyImage:
    """Read an image file as (H, W) uint8 or uint16; colour becomes grey as cv2.imread does it.

    Of a file with several pages it is the first. Raises ImageError where the file cannot be
    read, is damaged, has more pixels than that, or is no image of 8 or 16 bits.
    """
    return next(read_pages(path, max_pixels=max_pixels))


def read_pages(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Iterator[GreyImage]:
    """Read the pages of an image file (a TIFF stack, say) one by one, each as `read_image`."""
    return decoded_pages(_bytes_of(path), path, max_pixels=max_pixels)


def decoded_pages(
    data: NDArray[np.uint8], path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS
) -> Iterator[GreyImage]:
    """Decode the pages of an image from its bytes, as `read_pages`; path names it in messages."""
    try:
        sizes = page_sizes(data.data)
    except ValueError as error:
        raise ImageError(f"{str(path)!r} is no image that OpenCV can read: {error}") from error
    number = 0
    while sizes is None or number < len(sizes):
        if sizes is not None:
            _check_size(path, sizes[number], max_pixels)
        page, said = _decoded(data, number)
        if page is None and sizes is None and number:
            return
        if page is None or _tells_damage(said):
            what = "is no image that OpenCV can read" if page is None else "is damaged"
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
    """The bytes of a file as they are asked for, or what comes from a pipe."""
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
    raise ImageError(f"{str(path)!r} is no file")


def _decoded(data: NDArray[np.uint8], page: int) -> tuple[NDArray[Any] | None, str]:
    """A page, None where it cannot be decoded, and what the codec has said of it."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    pages: Sequence[NDArray[Any]] = ()
    with _codec_messages() as said:
        if data.size:
            with contextlib.suppress(cv2.error):
                pages = cv2.imdecodemulti(data, flags, range=(page, page + 1))[1]
    return (pages[0] if pages else None), "; ".join(said)


def _tells_damage(said: str) -> bool:
    """Whether a codec that gave an image speaks of damage: libjpeg goes on after any."""
    return "Corrupt JPEG data" in said or "Premature end of JPEG" in said


def _check_size(path: str | PathLike[str], size: tuple[int, int], most: int) -> None:
    width, height = size
    if width * height > most:
        raise ImageError(
            f"{str(path)!r} has {width} x {height} pixels, more than the limit of {most}; "
            "--max-pixels, or max_pixels=, raises it"
        )


_catching = False


@contextlib.contextmanager
def codec_messages_caught() -> Iterator[None]:
    """Catch what codecs write to stderr, and take damage that they tell for an error.

    It is for a process that has stderr to itself, a command: while an image is decoded,
    whatever is written there is caught.
    """
    global _catching
    before, _catching = _catching, True
    try:
        yield
    finally:
        _catching = before


@contextlib.contextmanager
def _codec_messages() -> Iterator[list[str]]:
    """The lines that codecs write to stderr in the block, where these are caught."""
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
    """One picture of a file.

    index: its number in the file, from 0.
    image: (H, W) uint8 or uint16, or None where a frame of a video is broken.
    """

    index: int
    image: GreyImage | None


def read_frames(path: str | PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Iterator[Frame]:
    """Read the frames of a video, or the pages of an image; colour becomes grey.

    A video ends before its stated number of frames where `LONGEST_GAP` of them in a row
    cannot be read. Raises ImageError where the file cannot be read, is neither an image nor a
    video, or has more pixels in a frame than that.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path, max_pixels=max_pixels)):
            yield Frame(index, page)
        return
    with _opened(path) as capture:
        width, height = (
            int(capture.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        _check_size(path, (width, height), max_pixels)
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        index = gap = 0
        while gap < LONGEST_GAP:
            with _codec_messages() as said:
                read, picture = capture.read()
            read = read and not _tells_damage("; ".join(said))
            if not read and index >= count:
                return
            gap = 0 if read else gap + 1
            yield Frame(index, _grey(picture) if read else None)
            index += 1


def count_frames(path: str | PathLike[str]) -> int | None:
    """The number of frames that a video states, None for an image or where it states none."""
    if not is_video(path):
        return None
    with _opened(path) as capture:
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    return int(count) if 0 < count < 2**31 else None


def frame_rate(path: str | PathLike[str]) -> float | None:
    """Frames per second that a video states, None for an image or where it states none."""
    if not is_video(path):
        return None
    with _opened(path) as capture:
        rate = capture.get(cv2.CAP_PROP_FPS)
    return float(rate) if 0 < rate < 1e6 else None


def read_camera(number: int) -> Iterator[Frame]:
    """The frames of the camera of that number, as they come; colour becomes grey.

    Ends where `LONGEST_GAP` frames in a row do not come. Raises ImageError where there is no
    such camera.
    """
    capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise ImageError(f"there is no camera {number} that OpenCV can open")
        index = gap = 0
        while gap < LONGEST_GAP:
            read, picture = capture.read()
            gap = 0 if read else gap + 1
            yield Frame(index, _grey(picture) if read else None)
            index += 1
    finally:
        capture.release()


@contextlib.contextmanager
def _opened(path: str | PathLike[str]) -> Iterator[cv2.VideoCapture]:
    _check_readable(path)
    # An absolute path is never taken for an address or for a pipeline of commands.
    capture = cv2.VideoCapture(os.path.abspath(path))
    try:
        if not capture.isOpened():
            raise ImageError(f"{str(path)!r} is no video that OpenCV can read")
        yield capture
    finally:
        capture.release()


def _check_readable(path: str | PathLike[str]) -> None:
    try:
        with open(path, "rb"):
            pass
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error


def _grey(frame: NDArray[Any]) -> GreyImage:
    return cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY).astype(np.uint8) if frame.ndim == 3 else frame


def write_csv(
    path: str | PathLike[str], columns: Iterable[str], rows: Iterable[Iterable[object]]
) -> None:
    """Write a table with its header, whole or not at all; raises OSError."""
    write_bytes(path, csv_bytes([columns, *rows]))


def csv_bytes(rows: Iterable[Iterable[object]]) -> bytes:
    """Rows as CSV in UTF-8."""
    text = StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")
