"""Images, read and written by OpenCV, and the files that a name stands for."""

import glob
import os
import re
from collections.abc import Iterator, Sequence
from decimal import Decimal
from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError
from cmp_cl.files import suffix_of, write_bytes
from cmp_cl.image import AnyImage, GreyImage

IMAGE_SUFFIXES = frozenset(
    {".bmp", ".jp2", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff"}
    | {".webp"}
)
VIDEO_SUFFIXES = frozenset(  # a GIF is read as a video: it may have several frames
    {".264", ".265", ".3gp", ".asf", ".avi", ".flv", ".gif", ".h264", ".h265", ".hevc", ".m4v"}
    | {".mjpeg", ".mjpg", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".ogv", ".ts"}
    | {".webm", ".wmv", ".y4m"}
)
_OF_16_BITS = frozenset({".jp2", ".pgm", ".png", ".pnm", ".tif", ".tiff"})
# A JPEG, a BMP, a PBM to PPM, and a PNG of grey levels, or of colours of which none is transparent
_WITHOUT_ALPHA = re.compile(rb"\xff\xd8|BM|P|\x89PNG.{21}(\x00|\x02(?!.*tRNS))", re.DOTALL)
_HEAD = 1 << 20  # bytes; what a PNG says before its pixels
_MOST_BYTES = 1 << 30  # of an image file
_BLOCK = 1 << 26  # px of the pages that are decoded at once: OpenCV repeats all earlier ones
_MOST_OVER_WHITE = 10**9 // 9  # bytes of a grey image: OpenCV has all four channels twice beside it


def write_image(path: str | PathLike[str], image: AnyImage) -> None:
    """Write an image in the format of the suffix, whole or not at all.

    image: (H, W) or (H, W, 3) BGR. Raises ImageError if the suffix is not that of an image format,
        or the format cannot hold such pixels; OSError if the folder is missing or not writable.
    """
    known = IMAGE_SUFFIXES if image.dtype == np.uint8 else _OF_16_BITS
    written = suffix_of(path) in known and image.dtype in (np.uint8, np.uint16)
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


def read_image(path: str | PathLike[str]) -> GreyImage:
    """Read an image file as (H, W) uint8 or uint16; colour becomes grey as cv2.imread does it.

    It reads the first of several pages, rotates the image as its EXIF tag says, and puts what is
    transparent on white, but not in images of over 111 MB. Raises ImageError if the file cannot be
    read, is damaged, has more pixels than OpenCV's limit (2**27, unless the variable
    OPENCV_IO_MAX_IMAGE_PIXELS is set before cmp_cl is imported), or is not an image of 8 or 16
    bits.
    """
    return next(read_pages(path))


def read_pages(path: str | PathLike[str]) -> Iterator[GreyImage]:
    """Read the pages of an image file one by one, as `read_image` does; only a TIFF has several.

    Of an animation the first image is read, because OpenCV repeats a WebP without end. Of a TIFF
    that is cut off, the pages before the cut are read. The first page says whether any is
    transparent.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        raise ImageError(f"{str(path)!r} is a folder or a device, not the file of an image")
    try:
        if os.path.getsize(path) > _MOST_BYTES:
            raise ImageError(f"{str(path)!r} has over {_MOST_BYTES} bytes, too many for an image")
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ImageError(f"cannot read {str(path)!r}: {error.strerror}") from error
    first, pages = 0, _decoded(data, path, 0, 1)
    count = max(1, _BLOCK // max(pages[0].size, 1))
    is_tiff = data[:2].tobytes() in (b"II", b"MM")
    alpha = _has_alpha(pages[0], data)
    while pages:
        for number, page in enumerate(pages, first):
            yield _over_white(page, data, number) if alpha else page
        first += len(pages)
        pages = _decoded(data, path, first, count) if is_tiff else []


def _decoded(
    data: NDArray[np.uint8], path: str | PathLike[str], first: int, count: int
) -> list[GreyImage]:
    """Decode at most `count` pages of an image file, from the page `first`; path: for messages.

    Raises ImageError if there is no first page, or as `read_image`.
    """
    pages: Sequence[GreyImage] = ()
    try:
        if _has_chunks(data):
            how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
            pages = cv2.imdecodemulti(data, how, range=(first, first + count))[1]  # type: ignore[assignment]
    except cv2.error as error:
        if "MAX_IMAGE" in str(error):
            raise ImageError(
                f"{str(path)!r} has more pixels than OpenCV's limit; the variable "
                "OPENCV_IO_MAX_IMAGE_PIXELS raises it"
            ) from error
    if not first and not pages:
        raise ImageError(f"{str(path)!r} is not an image that OpenCV can read, or is damaged")
    for page in pages:
        if page.dtype not in (np.uint8, np.uint16):
            raise ImageError(
                f"{str(path)!r} holds {page.dtype} pixels, expected 8 or 16 bits without sign; "
                "scale it and save it as PNG"
            )
    return list(pages)


def _has_chunks(data: NDArray[np.uint8]) -> bool:
    """Return whether all chunks of a PNG are in the file, which may go on after them; True for
    other formats.

    A chunk is its length, a name, that many bytes, and a sum. OpenCV allocates any length.
    """
    if data[:1].tobytes() != b"\x89":
        return True
    place, name = 8, b""
    while place + 12 <= data.size and name != b"IEND":
        name = data[place + 4 : place + 8].tobytes()
        place += 12 + int.from_bytes(data[place : place + 4].tobytes())
    return place <= data.size and name == b"IEND"


def _has_alpha(grey: GreyImage, data: NDArray[np.uint8]) -> bool:
    """Return whether the first page of a file may be transparent; grey: this page."""
    head = data[:_HEAD].tobytes().partition(b"IDAT")[0]
    if grey.nbytes > _MOST_OVER_WHITE or _WITHOUT_ALPHA.match(head):
        return False
    full = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    return full is not None and full.shape == (*grey.shape, 4)


def _over_white(grey: GreyImage, data: NDArray[np.uint8], page: int) -> GreyImage:
    """Return a page of a file with alpha over a white ground."""
    full = cv2.imdecodemulti(data, cv2.IMREAD_UNCHANGED, range=(page, page + 1))[1]
    if not full or full[0].shape != (*grey.shape, 4):
        return grey
    white = np.iinfo(grey.dtype).max
    for row, pixels in zip(grey, full[0], strict=True):  # a whole image of floats is too large
        alpha = pixels[:, 3] / np.float32(white)
        row[:] = np.rint(row * alpha + white * (1 - alpha))
    return grey


def find_inputs(paths: Sequence[str | PathLike[str]]) -> list[Path]:
    """Return the files to read: folders are replaced by the images and videos in them, by name.

    Numbers in names count: 9.png comes before 10.png, and times in seconds since 1970 may have
    fractions. Hidden files of a folder are left out. A name
    with `*`, `?` or `[` that is not a file is a pattern, because some shells do not expand it.

    Raises FileNotFoundError if a path does not exist, or a folder holds no image and no video.
    """
    found: list[Path] = []
    for name in paths:
        path = Path(name)
        if os.path.isdir(name):  # "" is none
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
        elif os.path.exists(name):
            found.append(path)
        elif matches := glob.glob(os.fspath(name)):
            found += sorted(map(Path, matches), key=_by_number)
        else:
            raise FileNotFoundError(f"there is no file {os.fspath(name)!r}")
    return found


def numbers_of(paths: Sequence[Path]) -> list[int]:
    """Return the numbers of files that are numbered one by one; none for files of other names, such
    as those of times."""
    named = [re.fullmatch(r"(.*?)(\d+)(\D*)", path.stem) for path in paths]
    if len({each and (each[1], each[3]) for each in named}) != 1:
        return []
    numbers = [int(each[2]) for each in named if each]
    steps = np.diff(numbers)
    return numbers if (steps > 0).all() and 2 * (steps == 1).sum() > len(steps) else []


def _by_number(path: Path) -> list[str | Decimal]:
    """Return the name in parts, texts and numbers in turn, by which 9.png sorts before 10.png.

    Only what follows the seconds since 1970 is a fraction: 1.10.png comes after 1.9.png.
    """
    parts = re.split(r"([0-9]{10,}\.[0-9]+|[0-9]+)", path.as_posix())
    return [Decimal(part) if place % 2 else part for place, part in enumerate(parts)]
