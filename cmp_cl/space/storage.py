"""Files of OpenCV's FileStorage: read with limits on their size and nesting, written to memory."""

from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.files import check_path

_MAX_FILE = 1 << 20  # bytes
_MAX_NUMBERS = 484  # entries of the largest matrix, a covariance of 22 parameters
_MOST_NESTED = 4000  # OpenCV's parsers recurse, and overflow the stack from some 20 000 levels on
_OPENING = (b"[", b"{", b"<", b"- ", b"-\t", b"-\n")


def open_storage(path: str | PathLike[str]) -> cv2.FileStorage:
    """Open a file at `path` of OpenCV's FileStorage; raises CalibrationError if that fails."""
    check_path(path, CalibrationError)
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MAX_FILE + 1)
        if len(data) > _MAX_FILE:
            raise CalibrationError(f"{path}: over {_MAX_FILE} bytes, no calibration file")
        check_nesting(data, path)
        return cv2.FileStorage(
            data.decode("utf-8"), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        )
    except OSError as error:
        why = error.strerror
        raise CalibrationError(f"cannot read the calibration {str(path)!r}: {why}") from error
    except UnicodeDecodeError as error:
        raise CalibrationError(
            f"cannot read the calibration {str(path)!r}: it is not text in UTF-8"
        ) from error
    except (cv2.error, SystemError) as error:
        raise CalibrationError(f"{path}: neither YAML, XML nor JSON as OpenCV writes it") from error


def new_storage(form: int = cv2.FILE_STORAGE_FORMAT_YAML) -> cv2.FileStorage:
    """Return an empty storage in memory; form: of OpenCV's FILE_STORAGE_FORMAT, YAML or JSON."""
    suffix = ".json" if form == cv2.FILE_STORAGE_FORMAT_JSON else ".yml"
    return cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | form)


def yaml_text(storage: cv2.FileStorage) -> str:
    """Return what was written to a storage, under the head that OpenCV 4 and OpenCV 5 read."""
    return "%YAML:1.0\n" + storage.releaseAndGetString().split("\n", 1)[1]


def read_matrix(
    storage: cv2.FileStorage, key: str, path: str | PathLike[str]
) -> NDArray[np.float64] | None:
    """Read a matrix of at most _MAX_NUMBERS entries; None if the key is missing.

    storage: the open file. path: its name, for messages. Raises CalibrationError if the entry is
        damaged, larger, or not a matrix.
    """
    node = storage.getNode(key)
    if node.empty():
        return None
    try:
        size = node.getNode("rows").real() * node.getNode("cols").real() if node.isMap() else np.inf
        if size <= _MAX_NUMBERS:
            return np.array(node.mat(), np.float64)
    except (cv2.error, ValueError) as error:
        raise CalibrationError(f"{path}: {key} is a damaged matrix: {error}") from error
    raise CalibrationError(f"{path}: {key} must be a small matrix (!!opencv-matrix)")


def check_nesting(data: bytes, path: str | PathLike[str]) -> None:
    """Raise CalibrationError if a YAML, JSON or XML file may be nested too deeply to parse.

    data: the bytes of the file. path: its name, for messages. It counts all characters that may
        open a level, even in strings. A rig has about a dozen.
    """
    levels = sum(data.count(opening) for opening in _OPENING)
    if levels > _MOST_NESTED:
        raise CalibrationError(
            f"{path}: over {_MOST_NESTED} brackets, tags or dashes, no calibration file"
        )
