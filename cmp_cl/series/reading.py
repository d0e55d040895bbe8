"""Recordings read back: .npz and HDF5."""

import os
import struct
import zipfile
import zlib
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.extras import extra

_DAMAGE = (  # what reading a damaged zip, .npy or HDF5 raises
    *(OSError, ValueError, KeyError, EOFError, OverflowError, MemoryError, RuntimeError),
    *(AttributeError, TypeError, struct.error, zipfile.BadZipFile, zlib.error),
)
_MOST_UNPACKED = 1100  # bytes of a byte in the file: deflate's best is 1032


def read_series(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of a recording by name: `index`, `time_ms`, constants, and (F, ...) frames.

    Of an HDF5 file that still grows, or whose writer was killed, it is what is there so far.

    Raises ConfigError on a suffix other than .npz, .h5 and .hdf5, FieldError where the file
    cannot be read or is no recording.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ConfigError(f"{str(path)!r}: a series to read must end in .npz, .h5 or .hdf5")
    if not Path(path).is_file():
        raise FieldError(f"there is no file {str(path)!r}")
    try:
        found = _npz(path) if suffix == ".npz" else _hdf5(path)
    except _DAMAGE as error:
        raise FieldError(f"{str(path)!r} is no series that can be read: {error}") from error
    if "index" not in found:
        raise FieldError(f"{str(path)!r} holds no series: it has no array `index`")
    return found


def _npz(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def _hdf5(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    with _opened(path) as file:
        frames = len(file["index"]) if "index" in file else 0
        found: dict[str, NDArray[Any]] = {}
        most = _MOST_UNPACKED * os.path.getsize(path)
        if sum(dataset.nbytes for dataset in file.values()) > most:
            raise ValueError("it says to hold more than it can")
        for name, dataset in file.items():
            if dataset.dtype.kind == "O":
                found[name] = np.array(dataset.asstr()[()])
            elif dataset.maxshape[:1] == (None,):
                found[name] = dataset[:frames]
            else:
                found[name] = dataset[()]
        return found


def _opened(path: str | PathLike[str]) -> Any:
    """Open the file as HDF5, beside its writer where that is open or was killed.

    Only then in the mode for that, in which HDF5 waits ever longer for damaged parts to become
    whole.
    """
    with extra("hdf5", "HDF5"):
        import h5py
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "already open for" not in str(error):
            raise
    return h5py.File(path, "r", libver="latest", swmr=True)
