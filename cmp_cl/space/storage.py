"""Rigs in files of OpenCV's FileStorage: read with a limit on their size, written whole."""

import itertools
import math
import re
import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.files import write_text
from cmp_cl.space.window import Window

_MAX_FILE = 1 << 20  # bytes
_MAX_LISTS = 4000  # maps, lists and tags: OpenCV's reader has no bound on how deep they lie
_MAX_NUMBERS = 676  # entries of the largest matrix, a covariance of 26 parameters
_NEEDED = {
    "K1": ("K1", "M1", "cameraMatrix1"),
    "D1": ("D1", "distCoeffs1"),
    "K2": ("K2", "M2", "cameraMatrix2"),
    "D2": ("D2", "distCoeffs2"),
    "R": ("R",),
    "T": ("T",),
}
_MATRICES = _NEEDED | {"covariance": ("covariance",)}
_KEYS = [
    *itertools.chain.from_iterable(_MATRICES.values()),
    *("unit", "window_normal", "window_distance", "window_layers", "window_index"),
]


def read_rig(path: str | PathLike[str]) -> dict[str, Any]:
    """Return what the file of a rig holds, by the names of `StereoRig`'s arguments.

    Without a unit it warns. Raises CalibrationError if the file cannot be read, or a camera is
    missing, contradicts itself or is a fisheye.
    """
    found: dict[str, Any] = {}
    storage = _open_storage(path)
    for name, aliases in _MATRICES.items():
        for alias in aliases:
            value = _read_matrix(storage, alias, path)
            if value is None:
                continue
            if name in found and not np.array_equal(found[name], value):
                raise CalibrationError(f"{path}: {alias} contradicts {name}")
            found[name] = value
    if "fisheye" in (storage.getNode(name).string() for name in ("lens1", "lens2")):
        raise CalibrationError(
            f"{path}: a camera is a fisheye, and a rig of two views takes none; calibrate it "
            "with --lens rational"
        )
    missing = [" or ".join(_NEEDED[name]) for name in _NEEDED if name not in found]
    if missing:
        raise CalibrationError(f"{path}: no {'; no '.join(missing)}; a rig has two cameras")
    window, unit = _read_window(storage, path), storage.getNode("unit")
    if window is not None:
        found["window"] = window
    if unit.isString():
        found["unit"] = unit.string()
    elif not unit.empty():
        raise CalibrationError(f"{path}: unit must be a word such as mm")
    else:
        warnings.warn(
            f"{path}: no unit, so T is taken to be in mm; add a line unit: mm", stacklevel=3
        )
    return found


def _open_storage(path: str | PathLike[str]) -> cv2.FileStorage:
    """Open a file at `path` of OpenCV's FileStorage.

    Raises CalibrationError if that fails, or if a key of a rig is in the file twice: OpenCV would
    read one of them without saying which.
    """
    try:
        with Path(path).open("rb") as file:
            data = file.read(_MAX_FILE + 1)
        if len(data) > _MAX_FILE:
            raise CalibrationError(f"{path}: over {_MAX_FILE} bytes, no calibration file")
        text = data.decode("utf-8")
        for key in _KEYS:
            if len(re.findall(rf'^{key}\s*:|"{key}"\s*:|<{key}[\s>]', text, re.MULTILINE)) > 1:
                raise CalibrationError(f"{path}: {key} is given twice; remove one of them")
        if len(re.findall(r"[\[{<:]|-\s", text)) > _MAX_LISTS:
            raise CalibrationError(f"{path}: over {_MAX_LISTS} lists, no calibration file")
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        storage.getNode("K1")  # it raises if the file is no map of names
        return storage
    except OSError as error:
        why = error.strerror
        raise CalibrationError(f"cannot read the calibration {str(path)!r}: {why}") from error
    except (UnicodeDecodeError, cv2.error, SystemError) as error:
        raise CalibrationError(f"{path}: neither YAML, XML nor JSON as OpenCV writes it") from error


def save_storage(
    path: str | PathLike[str], entries: Mapping[str, str | float | NDArray[Any]]
) -> None:
    """Write a file in YAML, whole or not at all, under the head that OpenCV 4 and 5 read."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in entries.items():
        storage.write(key, value.copy() if isinstance(value, np.ndarray) else value)
    write_text(path, "%YAML:1.0\n" + storage.releaseAndGetString().split("\n", 1)[1])


def _read_matrix(
    storage: cv2.FileStorage, key: str, path: str | PathLike[str]
) -> NDArray[np.float64] | None:
    """Read a matrix of at most _MAX_NUMBERS entries; None if the key is missing.

    OpenCV 5 writes a vector as !!opencv-nd-matrix, which has `sizes` in place of rows and cols.

    storage: the open file. path: its name, for messages. Raises CalibrationError if the entry is
        damaged, larger, not a matrix, or not of type d or f: OpenCV cuts the numbers of others.
    """
    node = storage.getNode(key)
    if node.empty():
        return None
    sizes = _sizes_of(node) if node.isMap() else []
    if not sizes or not all(size.isInt() for size in sizes):
        raise CalibrationError(f"{path}: {key} must be a small matrix (!!opencv-matrix)")
    kind = node.getNode("dt").string() if node.getNode("dt").isString() else ""
    if kind not in ("d", "f"):
        raise CalibrationError(f"{path}: {key} must have dt: d or f, not {kind!r}")
    # node.mat() of OpenCV 5.0 writes past its memory where an entry of the map is damaged.
    shape = [int(size.real()) for size in sizes]
    count, data = math.prod(shape), node.getNode("data")
    fits = min(shape) > 0 and count <= _MAX_NUMBERS
    if not fits or not data.isSeq() or data.size() != count:
        what = f"{' x '.join(map(str, shape))}, with {data.size()} entries"
        raise CalibrationError(f"{path}: {key} must be a small matrix, not {what}")
    entries = [data.at(i) for i in range(count)]
    if not all(entry.isReal() or entry.isInt() for entry in entries):
        raise CalibrationError(f"{path}: {key} has an entry that is no number")
    return np.array([entry.real() for entry in entries]).reshape(shape)


def _sizes_of(node: cv2.FileNode) -> list[cv2.FileNode]:
    several = node.getNode("sizes")
    if several.isInt():  # a single one in XML
        return [several]
    if several.isSeq():
        return [several.at(i) for i in range(several.size())]
    return [node.getNode(name) for name in ("rows", "cols")]


def last_entries(
    covariance: NDArray[np.float64] | None, window: Window | None, unit: str
) -> dict[str, str | float | NDArray[Any]]:
    """Return the entries of a rig behind its cameras: what is known beside them, and its unit."""
    entries: dict[str, str | float | NDArray[Any]] = {}
    if covariance is not None:
        entries["covariance"] = covariance
    if window is not None:
        entries |= {"window_normal": window.normal[:, None], "window_distance": window.distance}
        entries |= {"window_layers": np.array(window.layers)} if window.layers else {}
        entries["window_index"] = window.index
    return entries | {"unit": unit}


def _read_window(storage: cv2.FileStorage, path: str | PathLike[str]) -> Window | None:
    """Read a window; None if the file has none. Raises CalibrationError if it is not complete."""
    normal, layers = (_read_matrix(storage, f"window_{n}", path) for n in ("normal", "layers"))
    numbers = [storage.getNode(f"window_{name}") for name in ("distance", "index")]
    if normal is None and layers is None and all(node.empty() for node in numbers):
        return None
    if normal is None or not all(node.isReal() or node.isInt() for node in numbers):
        raise CalibrationError(
            f"{path}: a window needs window_normal, a matrix, window_distance and window_index, "
            "numbers"
        )
    distance, index = (node.real() for node in numbers)
    try:
        return Window(normal.ravel(), distance, [] if layers is None else layers.tolist(), index)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}") from error
