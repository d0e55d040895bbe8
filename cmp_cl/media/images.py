"""Images, read and written by OpenCV, and the files that a name stands for."""

import glob
import os
import re
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError, check_kind
from cmp_cl.files import write_bytes
from cmp_cl.image import GreyImage

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
_MOST_BYTES = 1 << 30  # of an image file


def write_image(path: str | PathLike[str], image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write an image in the format of the suffix, whole or not at all.

    image: (H, W) or (H, W, 3) BGR. Raises ImageError if the suffix is not that of an image format,
        or the format cannot hold such pixels; OSError if the folder is missing or not writable.
    """
    check_kind("image", image, np.ndarray, ImageError)
    known = IMAGE_SUFFIXES if image.dtype == np.uint8 else _OF_16_BITS
    written = Path(path).suffix.lower() in known and image.dtype in (np.uint8, np.uint16)
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

    It reads the first of several pages, and rotates the image as its EXIF tag says. Raises
    ImageError if the file cannot be read, is damaged, has over 1 GiB or more pixels than OpenCV's
    limit, or is not an image of 8 or 16 bits.
    """
    return _decoded(path, 1)[0]


def read_pages(path: str | PathLike[str]) -> list[GreyImage]:
    """Read all pages of an image file as `read_image` does; only a TIFF has several.

    Of a TIFF that is cut off the pages before the cut are read.
    """
    return _decoded(path, None)


def _decoded(path: str | PathLike[str], count: int | None) -> list[GreyImage]:
    """Return the first `count` pages of an image file, all if that is None."""
    name = repr(str(path))
    try:
        if os.path.getsize(path) > _MOST_BYTES:
            raise ImageError(f"{name} has over {_MOST_BYTES} bytes, too many for an image")
        data = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ImageError(f"cannot read {name}: {error.strerror}") from error
    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
    some: dict[str, Any] = {} if count is None else {"range": (0, count)}
    pages: Sequence[Any] = ()
    why = ""
    try:
        pages = cv2.imdecodemulti(data, how, **some)[1]
    except cv2.error as error:
        why = f": {error.err}"
    if not pages and Path(path).suffix.lower() in VIDEO_SUFFIXES:
        raise ImageError(f"{name} is a video: give images")
    if not pages:
        raise ImageError(f"{name} is not an image that OpenCV can read, or is damaged{why}")
    for page in pages:
        if page.dtype not in (np.uint8, np.uint16):
            raise ImageError(
                f"{name} holds {page.dtype} pixels, expected 8 or 16 bits without sign; scale it "
                "and save it as PNG"
            )
    return list(pages)


def find_inputs(paths: Sequence[str | PathLike[str]]) -> list[Path]:
    """Return the files to read: folders are replaced by the images and videos in them, by name.

    Numbers in names count: 9.png comes before 10.png. Hidden files of a folder are left out. A name
    with `*`, `?` or `[` that is not a file is a pattern, because some shells do not expand it.

    Raises FileNotFoundError if a path does not exist, or a folder holds no image and no video.
    """
    found: list[Path] = []
    for name in paths:
        path = Path(name)
        if os.path.isdir(name):
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


def _by_number(path: Path) -> list[str | int]:
    """Return the name in parts, texts and numbers in turn, by which 9.png sorts before 10.png."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [int(part) if place % 2 else part for place, part in enumerate(parts)]
