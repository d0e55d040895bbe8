"""Series read back: .npz and HDF5, whole, growing, or left by a killed program."""

import os
import re
from collections.abc import Collection
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, extra
from cmp_cl.files import check_path, suffix_of
from cmp_cl.series.npz import CONSTANTS

_Found = dict[str, NDArray[Any]]


def read_series(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    path: .npz or .h5, or the NAME.part of one that still grows or whose writer was killed: then the
    frames so far. names: the arrays to read, as far as they are there; None is all. Only these are
    read.

    Raises ConfigError on another suffix or without the package of the format, FieldError if the
    file is damaged or is no series.
    """
    check_path(path, ConfigError)
    suffix = suffix_of(re.sub(r"\.part(-\d+)?$", "", os.fspath(path)), ConfigError)
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ConfigError(
            f"{str(path)!r}: the name of a series must end in .npz, .h5 or .hdf5, or that and .part"
        )
    if not Path(path).exists():
        raise FieldError(f"there is no file {str(path)!r}")
    wanted = None if names is None else {"index", *names}
    read = _hdf5 if suffix != ".npz" else _npz_part if Path(path).is_dir() else _npz
    try:
        found = read(Path(path), wanted)
        _check_index(found)
    except (ConfigError, MemoryError):
        raise
    except Exception as error:  # damaged bytes raise any of them, in zipfile, NumPy and h5py
        raise FieldError(f"{str(path)!r} is damaged or no series: {error}") from error
    return found


def _check_index(found: _Found) -> None:
    if "index" not in found:
        raise ValueError("there is no array `index`")
    if found["index"].ndim != 1 or found["index"].dtype.kind not in "iu":
        raise ValueError(f"index must be (F,) of whole numbers, not {found['index']!r}")


def _npz(path: Path, wanted: set[str] | None) -> _Found:
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data if wanted is None or name in wanted}


def _npz_part(path: Path, wanted: set[str] | None) -> _Found:
    """Read the folder that a growing .npz is, see `NpzFormat`; `index` counts its whole frames."""
    frames = len(np.load(path / "index.npy"))
    found = {}
    for file in [*path.glob("*.npy"), *(path / CONSTANTS).glob("*.npy")]:
        if wanted is None or file.stem in wanted:
            array = np.load(file, allow_pickle=False)
            found[file.stem] = array[:frames] if file.parent == path else array
    return found


def _hdf5(path: Path, wanted: set[str] | None) -> _Found:
    with extra("hdf5", "HDF5"):
        import h5py
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if "already open for" not in str(error):
            raise
        file = h5py.File(path, "r", libver="latest", swmr=True)
    found = {}
    with file:
        frames = len(file["index"]) if "index" in file else 0
        for name, dataset in file.items():
            if wanted is None or name in wanted:
                growing = dataset.maxshape[:1] == (None,)
                array = np.asarray(dataset[:frames] if growing else dataset[()])
                found[name] = np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
    return found
