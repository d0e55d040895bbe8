"""Series read back: .npz and HDF5, and the parts of all formats."""

import os
import re
from collections.abc import Collection
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, extra
from cmp_cl.files import read_npz
from cmp_cl.series.part import Stored


def read_series(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    path: .npz or .h5, or the NAME.part of a series of any format that still grows or whose writer
    was killed: then the frames so far. names: the arrays to read, as far as they are there; None is
    all. Only these are read.

    Raises ConfigError on another suffix or without the package of the format, FieldError if the
    file is damaged or is no series.
    """
    part = re.search(r"\.part(-\d+)?$", os.fspath(path)) is not None
    suffix = Path(path).suffix.lower()
    if not (part or suffix in (".npz", ".h5")):
        raise ConfigError(f"{str(path)!r}: a series that is read ends in .npz, .h5 or .part")
    if not os.path.exists(path):
        raise FieldError(f"there is no file {str(path)!r}")
    wanted = None if names is None else {"index", *names}
    try:
        if part:
            stored = Stored.of(Path(path))
            found = _loaded({**stored.constants, **stored.arrays}, wanted)
        elif suffix == ".npz":
            found = read_npz(path, wanted)
        else:
            with extra("hdf5", "HDF5"):
                import h5py
            with h5py.File(path, "r") as file:
                found = _loaded(file, wanted)
    except ConfigError:
        raise
    except Exception as error:  # damaged bytes raise any of them, in zipfile, NumPy and h5py
        what = "damaged, no series, or only begun" if part else "damaged or no series"
        raise FieldError(f"{str(path)!r} is {what}: {error}") from error
    if "index" not in found:
        raise FieldError(f"{str(path)!r} is no series: there is no array `index`")
    return found


def _loaded(stored: Any, wanted: set[str] | None) -> dict[str, NDArray[Any]]:
    """Read the arrays of a part or of an HDF5 file that are wanted, all if that is None."""
    arrays = {
        name: np.array(stored[name][()]) for name in stored if wanted is None or name in wanted
    }
    return {
        name: np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
        for name, array in arrays.items()
    }
