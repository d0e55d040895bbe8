"""Images, videos and tables: read as grey, written whole or not at all."""

import contextlib
import csv
import dataclasses
import os
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

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".gif", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".pnm", ".ppm"}
    | {".tif", ".tiff", ".webp"}
)
SUFFIXES_OF_16_BITS = frozenset({".jp2", ".pgm", ".png", ".pnm", ".tif", ".tiff"})
VIDEO_SUFFIXES = frozenset(
    {".avi", ".m4v", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm", ".wmv"}
)

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


def read_image(path: str | PathLike[str]) -> GreyImage:
    """An image file as (H, W) uint8 or uint16; colour becomes grey as cv2.imread does it.

    Of a file with several pages it is the first. Raises ImageError where the file cannot be
    read or is no image of 8 or 16 bits.
    """
    return read_pages(path)[0]


def read_pages(path: str | PathLike[str]) -> list[GreyImage]:
    """The pages of an image file (a TIFF stack, say), each as `read_image` gives it."""
    _check_readable(path)
    data = np.frombuffer(Path(path).read_bytes(), np.uint8)
    pages: Sequence[NDArray[Any]] = ()
    if data.size:
        with contextlib.suppress(cv2.error):
            pages = cv2.imdecodemulti(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)[1]
    if not pages:
        raise ImageError(f"{str(path)!r} is no image that OpenCV can read")
    for page in pages:
        if page.dtype not in (np.uint8, np.uint16):
            raise ImageError(
                f"{str(path)!r} holds {page.dtype} pixels, expected 8 or 16 bits without sign; "
                "scale it and save it as PNG"
            )
    return list(pages)


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a file.

    index: its number in the file, from 0.
    image: (H, W) uint8 or uint16, or None where a frame of a video is broken.
    """

    index: int
    image: GreyImage | None


def read_frames(path: str | PathLike[str]) -> Iterator[Frame]:
    """The frames of a video, or the pages of an image; colour becomes grey.

    A video ends before its stated number of frames where `LONGEST_GAP` of them in a row
    cannot be read. Raises ImageError where the file cannot be read or is neither an image
    nor a video.
    """
    if not is_video(path):
        for index, page in enumerate(read_pages(path)):
            yield Frame(index, page)
        return
    with _opened(path) as capture:
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        index = gap = 0
        while gap < LONGEST_GAP:
            read, picture = capture.read()
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
