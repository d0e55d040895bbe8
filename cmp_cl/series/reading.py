"""Series read back: .npz and HDF5."""

import os
import struct
import subprocess
import sys
import zipfile
import zlib
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.extras import extra
from cmp_cl.files import suffix_of

_DAMAGE = (  # raised on reading a damaged zip, .npy or HDF5
    *(OSError, ValueError, KeyError, EOFError, OverflowError, MemoryError, RuntimeError),
    *(AttributeError, TypeError, struct.error, zipfile.BadZipFile, zlib.error),
)
_LONGEST_READ = 30.0  # s, for a growing file; more is allowed for its size at
_LEAST_RATE = 10e6  # bytes a second
_MOST_UNPACKED = 1100  # unpacked bytes for each byte of the file; deflate reaches 1032


def read_series(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    From an HDF5 file that still grows, or whose writer was killed, it reads the frames so far.

    Raises ConfigError on a suffix other than .npz, .h5 and .hdf5, FieldError if the file
    cannot be read or is no series.
    """
    suffix = suffix_of(path, ConfigError)
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ConfigError(f"{str(path)!r}: the name of a series must end in .npz, .h5 or .hdf5")
    if not Path(path).is_file():
        raise FieldError(f"there is no file {str(path)!r}")
    try:
        found = _npz(path) if suffix == ".npz" else _hdf5(path)
    except _DAMAGE as error:
        raise FieldError(f"{str(path)!r} is not a series that can be read: {error}") from error
    if "index" not in found:
        raise FieldError(f"{str(path)!r} holds no series: it has no array `index`")
    return found


def _npz(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    with open(path, "rb") as file:
        if not zipfile.is_zipfile(file):
            raise ValueError("it is not an .npz, or is cut off")
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}


def _hdf5(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    with extra("hdf5", "HDF5"):
        import h5py
    try:
        with h5py.File(path, "r") as file:
            return _datasets(file, path)
    except OSError as error:
        if "already open for" not in str(error):
            raise
    _try_beside_writer(path)
    return _beside_writer(path)


def _beside_writer(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read an HDF5 file whose writer still has it open or was killed."""
    import h5py

    with h5py.File(path, "r", libver="latest", swmr=True) as file:
        return _datasets(file, path)


def _try_beside_writer(path: str | PathLike[str]) -> None:
    """Raise ValueError if the file cannot be read beside its writer in time.

    HDF5 waits without end for damaged parts to be completed, and no signal interrupts it. So
    another process tries first.
    """
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import _beside_writer as read; "
    )
    limit = _LONGEST_READ + os.path.getsize(path) / _LEAST_RATE
    try:
        subprocess.run(
            [sys.executable, "-c", f"{code}read(sys.argv[1])", os.fspath(path)],
            check=True,
            capture_output=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it is damaged: not read within {limit:.0f} s") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"]
        raise ValueError(f"it is damaged: {said[-1]}") from None


def _datasets(file: Any, path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
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
