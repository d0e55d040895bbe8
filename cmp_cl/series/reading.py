"""Series read back and checked: .npz and HDF5, whole, growing, or left by a killed program."""

import os
import re
import subprocess
import sys
from collections.abc import Collection
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, extra
from cmp_cl.files import check_memory, check_path, read_npz, suffix_of
from cmp_cl.series.npz import CONSTANTS

_LONGEST_READ = 30.0  # s, for a growing HDF5; more is allowed for its size at
_LEAST_RATE = 10e6  # bytes a second
_LARGEST = np.float64(1e100)  # of a number; the square of a larger one has no float
# The axes of the arrays that are drawn and replayed: F frames, R rows, C columns, K = 2 or 3.
_AXES: dict[str, tuple[str | int, ...]] = {
    "index": ("F",),
    "time_ms": ("F",),
    "rest": ("R", "C", "K"),
    "xy": ("F", "R", "C", 2),
    "displacement": ("F", "R", "C", "K"),
    "sigma": ("F", "R", "C"),
    "unit": (),
}
_KINDS = {"index": ("iu", "whole numbers"), "unit": ("U", "text")}

_Found = dict[str, NDArray[Any]]


def read_series(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    path: .npz or .h5, or the NAME.part of one that still grows or whose writer was killed: then the
    frames so far. names: the arrays to read, as far as they are there; None is all. Only these are
    read.

    Raises ConfigError on another suffix or without the package of the format, FieldError if the
    file is damaged, is no series, does not fit into the memory, or holds one of the arrays that
    this library writes with another shape or kind of values.
    """
    check_path(path, ConfigError)
    suffix = suffix_of(re.sub(r"\.part(-\d+)?$", "", os.fspath(path)), ConfigError)
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ConfigError(
            f"{str(path)!r}: the name of a series must end in .npz, .h5 or .hdf5, or that and .part"
        )
    if not os.access(path, os.R_OK):
        missing = "right to read" if os.path.exists(path) else "file"
        raise FieldError(f"there is no {missing} {str(path)!r}")
    wanted = None if names is None else {"index", *names}
    read = _hdf5 if suffix != ".npz" else _npz_part if Path(path).is_dir() else read_npz
    try:
        found = read(Path(path), wanted)
        _check(found)
    except ConfigError:
        raise
    except Exception as error:  # damaged bytes raise any of them, in zipfile, NumPy and h5py
        raise FieldError(f"{str(path)!r} is damaged or no series: {error}") from error
    return found


def _check(found: _Found) -> None:
    """Raise ValueError if an array that this library writes has another shape or other values."""
    if "index" not in found:
        raise ValueError("there is no array `index`")
    sizes: dict[str | int, int] = {2: 2}
    for name, axes in _AXES.items():
        if name not in found:
            continue
        array = found[name]
        kinds, kind = _KINDS.get(name, ("fiu", "numbers"))
        fits = array.ndim == len(axes) and array.dtype.kind in kinds
        for axis, size in zip(axes, array.shape, strict=False):
            fits = fits and size == sizes.get(axis, size) and (axis != "K" or size in (2, 3))
        if not fits:
            expected = ", ".join(str(sizes.get(axis, axis)) for axis in axes)
            raise ValueError(
                f"{name} must be ({expected}) of {kind}, not {array.shape} of {array.dtype}"
            )
        sizes |= zip(axes, array.shape, strict=True)
        if array.dtype.kind == "f" and (np.abs(array) > _LARGEST).any():
            raise ValueError(f"{name} must have numbers up to {_LARGEST:g} or NaN, not larger ones")
    if "rest" in found and np.isnan(found["rest"]).all():
        raise ValueError("rest must have the positions of nodes, and there are none")
    if len(str(found.get("unit", ""))) > 40:
        raise ValueError("unit must be a short text")


def _npz_part(path: Path, wanted: set[str] | None) -> _Found:
    """Read the folder that a growing .npz is, see `NpzFormat`; `index` counts its whole frames."""
    frames = len(np.load(path / "index.npy"))
    files = [*path.glob("*.npy"), *(path / CONSTANTS).glob("*.npy")]
    files = [file for file in files if wanted is None or file.stem in wanted]
    check_memory(sum(file.stat().st_size for file in files))
    found = {}
    for file in files:
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
        _try_beside_writer(path)
        file = h5py.File(path, "r", libver="latest", swmr=True)
    with file:
        names = [name for name in file if wanted is None or name in wanted]
        return _arrays({name: file[name] for name in names})


def _arrays(datasets: dict[str, Any]) -> _Found:
    """Read the datasets of an HDF5; `index` counts the whole frames of those that grow."""
    check_memory(sum(dataset.nbytes for dataset in datasets.values()))
    frames = datasets["index"].size if "index" in datasets else 0
    found = {}
    for name, dataset in datasets.items():
        growing = dataset.maxshape[:1] == (None,)
        array = np.asarray(dataset[:frames] if growing else dataset[()])
        found[name] = np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
    return found


def _try_beside_writer(path: Path) -> None:
    """Raise ValueError if an HDF5 file cannot be read beside its writer in time.

    HDF5 waits without end for damaged parts to be completed, and no signal interrupts it. So
    another process tries first.
    """
    code = (
        f"import sys; sys.path[:] = {sys.path!r}; import h5py\n"
        "with h5py.File(sys.argv[1], 'r', libver='latest', swmr=True) as file:\n"
        "    for dataset in file.values():\n"
        "        for first in range(0, len(dataset) if dataset.shape else 0, 256):\n"
        "            dataset[first : first + 256]"
    )
    limit = _LONGEST_READ + os.path.getsize(path) / _LEAST_RATE
    command = [sys.executable, "-c", code, os.fspath(path)]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=limit)
    except subprocess.TimeoutExpired:
        raise ValueError(f"it was not read within {limit:.0f} s") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"]
        raise ValueError(said[-1]) from None
