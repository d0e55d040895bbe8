"""Series read back and checked: .npz and HDF5, and the parts of all formats."""

import os
import re
from collections.abc import Collection, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, extra
from cmp_cl.files import check_memory, read_npz, suffix_of
from cmp_cl.series.part import LARGEST, Stored

_LONGEST = 40  # characters of a unit
# The axes of the arrays that are drawn and replayed: F frames, R rows, C columns, K = 2 or 3.
_AXES: dict[str, tuple[str, ...]] = {
    "index": ("F",),
    "time_ms": ("F",),
    "ambiguous": ("F",),
    "misfit": ("F",),
    "rest": ("R", "C", "K"),
    "displacement": ("F", "R", "C", "K"),
    "sigma": ("F", "R", "C"),
    "unit": (),
}
_KINDS = {
    "index": ("iu", "whole numbers"),
    "unit": ("USO", "text"),
    **dict.fromkeys(("ambiguous", "misfit"), ("b", "True or False")),
}

_Found = dict[str, NDArray[Any]]


def read_series(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    path: .npz or .h5, or the NAME.part of a series of any format that still grows or whose writer
    was killed: then the frames so far. names: the arrays to read, as far as they are there; None is
    all. Only these are read.

    Raises ConfigError on another suffix or without the package of the format, FieldError if the
    file is damaged, is no series, does not fit into the memory, or holds one of the arrays that
    this library writes with another shape or kind of values.
    """
    part = re.search(r"\.part(-\d+)?$", os.fspath(path)) is not None
    suffix = suffix_of(path)
    if not (part or suffix in (".npz", ".h5")):
        raise ConfigError(f"{str(path)!r}: a series that is read ends in .npz, .h5 or .part")
    if not os.access(path, os.R_OK):
        missing = "right to read" if os.path.exists(path) else "file"
        raise FieldError(f"there is no {missing} {str(path)!r}")
    wanted = None if names is None else {"index", *names}
    try:
        if part:
            stored = Stored.of(Path(path))
            found = _loaded({**stored.constants, **stored.arrays}, wanted)
        elif suffix == ".npz":
            found = read_npz(path, wanted, _check_shapes)
        else:
            with extra("hdf5", "HDF5"):
                import h5py
            with h5py.File(path, "r") as file:
                found = _loaded(file, wanted)
        _check_values(found)
    except ConfigError:
        raise
    except Exception as error:  # damaged bytes raise any of them, in zipfile, NumPy and h5py
        what = "damaged, no series, or only begun" if part else "damaged or no series"
        raise FieldError(f"{str(path)!r} is {what}: {error}") from error
    return found


def _check_shapes(found: _Found) -> None:
    """Raise ValueError if an array that this library writes has another shape or type."""
    if "index" not in found:
        raise ValueError("there is no array `index`")
    sizes: dict[str, int] = {}
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
    if "unit" in found and found["unit"].dtype.itemsize > 4 * _LONGEST:
        raise ValueError("unit must be a short text")


def _check_values(found: _Found) -> None:
    """Raise ValueError if an array that this library writes has other values."""
    for name, array in found.items():
        if name in _AXES and array.dtype.kind == "f" and (np.abs(array) > LARGEST).any():
            raise ValueError(f"{name} must have numbers up to {LARGEST:g} or NaN, not larger ones")
    if "rest" in found and np.isnan(found["rest"]).all():
        raise ValueError("rest must have the positions of nodes, and there are none")
    if len(str(found.get("unit", ""))) > _LONGEST:
        raise ValueError("unit must be a short text")


def _loaded(stored: Mapping[str, Any], wanted: set[str] | None) -> _Found:
    """Read arrays of which so far only the shape and the type are known."""
    chosen = {name: stored[name] for name in stored if wanted is None or name in wanted}
    _check_shapes(chosen)
    check_memory(sum(each.nbytes for each in chosen.values()))
    arrays = {name: np.array(each[()]) for name, each in chosen.items()}
    return {
        name: np.char.decode(array, "utf-8") if array.dtype.kind == "S" else array
        for name, array in arrays.items()
    }
