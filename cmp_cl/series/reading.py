"""Series read back and checked: .npz and HDF5, whole, growing, or left by a killed program."""

import contextlib
import dataclasses
import functools
import io
import math
import os
import re
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.extras import extra
from cmp_cl.files import check_path, suffix_of
from cmp_cl.series.npz import CONSTANTS

_DAMAGE = (  # raised on reading a damaged zip, .npy or HDF5
    *(OSError, ValueError, KeyError, EOFError, OverflowError, MemoryError, RuntimeError),
    *(AttributeError, TypeError, struct.error, zipfile.BadZipFile, zlib.error),
    *(NotImplementedError, SyntaxError, RecursionError),
)
_LONGEST_READ = 30.0  # s, for a growing file; more is allowed for its size at
_LEAST_RATE = 10e6  # bytes a second
_MOST_UNPACKED = 1100  # unpacked bytes for each byte of the file; deflate reaches 1032
_LARGEST = np.float64(1e100)  # of a number; the square of a larger one has no float
# The axes of the arrays that this library writes: F frames, R rows, C columns, K = 2 or 3.
_AXES: dict[str, tuple[str | int, ...]] = {
    "index": ("F",),
    "time_ms": ("F",),
    "rest": ("R", "C", "K"),
    "xy": ("F", "R", "C", 2),
    "displacement": ("F", "R", "C", "K"),
    "sigma": ("F", "R", "C"),
    "status": ("F", "R", "C"),
    "ambiguous": ("F",),
    "unit": (),
}
_KINDS = {"index": "iu", "unit": "US", "ambiguous": "b", "status": "iu"}
_KIND_NAMES = {"iu": "whole numbers", "US": "text", "b": "bool"}

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@dataclasses.dataclass(frozen=True)
class _Head:
    """What a file says about an array, and a function that reads it.

    growing: whether its first axis is that of the frames, and may be one ahead of the index.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[int], NDArray[Any]]
    growing: bool = False


_Heads = dict[str, _Head]
_Wanted = Callable[[str], bool]  # whether an array of that name is read


def read_series(
    path: str | PathLike[str], names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a series by name: `index`, `time_ms`, constants, and (F, ...) frames.

    path: .npz or .h5, or the NAME.part of one that still grows or whose writer was killed: then the
    frames so far. names: the arrays to read, as far as they are there; None is all. Only these are
    read.

    Raises ConfigError on another suffix; FieldError if the file cannot be read, is no series, does
    not fit into the memory, or if an array that this library writes has another shape or kind of
    values: the message says which, what was expected and what was found.
    """
    check_path(path, ConfigError)
    suffix = suffix_of(re.sub(r"\.part(-\d+)?$", "", os.fspath(path)), ConfigError)
    if suffix not in (".npz", ".h5", ".hdf5"):
        raise ConfigError(
            f"{str(path)!r}: the name of a series must end in .npz, .h5 or .hdf5, or that and .part"
        )
    if not Path(path).exists():
        raise FieldError(f"there is no file {str(path)!r}")
    opened = _hdf5 if suffix != ".npz" else _npz_part if Path(path).is_dir() else _npz
    try:
        with opened(Path(path), lambda name: names is None or name in {"index", *names}) as heads:
            return _read(heads)
    except (FieldError, ConfigError) as error:
        raise type(error)(f"{str(path)!r}: {error}") from error
    except _DAMAGE as error:
        why = str(error) or type(error).__name__
        if "filter returned failure" in why:  # HDF5 does not say which filter
            why = "an array does not have its checksum"
        raise FieldError(f"{str(path)!r} is damaged or no series: {why}") from error


def _read(heads: _Heads) -> dict[str, NDArray[Any]]:
    if "index" not in heads:
        raise FieldError("it holds no series: there is no array `index`")
    frames = heads["index"].shape[0] if heads["index"].shape else 0
    heads = {name: _shortened(name, head, frames) for name, head in heads.items()}
    _check_heads(heads)
    size = sum(head.dtype.itemsize * math.prod(head.shape) for head in heads.values())
    memory = _memory()
    if size > memory:
        raise FieldError(f"its arrays need {size} bytes, and {memory:.0f} bytes of memory are left")
    found = {name: head.read(frames) for name, head in heads.items()}
    for name, values in found.items():
        _check_values(name, values)
    return found


def _shortened(name: str, head: _Head, frames: int) -> _Head:
    """Return the head of an array without the frames that are not complete."""
    if not head.growing:
        return head
    if not head.shape or head.shape[0] < frames:
        raise FieldError(f"{name} is {head.shape}, and index has {frames} frames")
    return dataclasses.replace(head, shape=(frames, *head.shape[1:]))


def _check_heads(heads: _Heads) -> None:
    sizes: dict[str | int, int] = {}
    for name, axes in _AXES.items():
        if name not in heads:
            continue
        shape, dtype = heads[name].shape, heads[name].dtype
        kinds = _KINDS.get(name, "fiu")
        fits = len(shape) == len(axes) and dtype.kind in kinds
        for axis, size in zip(axes, shape, strict=False):
            allowed = {sizes.get(axis, size)} if axis != "K" or axis in sizes else {2, 3}
            fits = fits and size in ({axis} if isinstance(axis, int) else allowed)
        if not fits:
            expected = ", ".join(str(sizes.get(axis, axis)) for axis in axes)
            what = f"({expected}) of {_KIND_NAMES.get(kinds, 'numbers')}"
            raise FieldError(f"{name} must be {what}, not {shape} of {dtype}")
        sizes |= {axis: n for axis, n in zip(axes, shape, strict=True) if isinstance(axis, str)}


def _check_values(name: str, values: NDArray[Any]) -> None:
    if name == "unit" and not 0 < len(str(values)) <= 40:
        raise FieldError(f"unit must be a short text, not {str(values)[:40]!r}")
    if values.dtype.kind != "f" or not values.size:
        return
    if name == "rest" and np.isnan(values).all():
        raise FieldError("rest must have the positions of nodes, and all are NaN")
    with np.errstate(invalid="ignore"):
        if (np.abs(values) > _LARGEST).any():
            raise FieldError(f"{name} must have numbers up to {_LARGEST:g} or NaN, not larger ones")


def _memory() -> float:
    """Return how many bytes of memory are available; infinity where that is not known."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    return np.inf


# .npz


@contextlib.contextmanager
def _npz(path: Path, wanted: _Wanted) -> Iterator[_Heads]:
    with zipfile.ZipFile(path) as archive:
        members = {
            info.filename.removesuffix(".npy"): info
            for info in archive.infolist()
            if info.filename.endswith(".npy")
        }
        yield {
            name: _npy_head(functools.partial(archive.open, info), info.file_size)
            for name, info in members.items()
            if wanted(name)
        }


@contextlib.contextmanager
def _npz_part(path: Path, wanted: _Wanted) -> Iterator[_Heads]:
    """Read the folder that a growing .npz is, see `NpzFormat`."""
    files = [*path.glob("*.npy"), *(path / CONSTANTS).glob("*.npy")]
    yield {
        file.stem: _npy_head(functools.partial(io.FileIO, file), None, growing=file.parent == path)
        for file in files
        if wanted(file.stem)
    }


def _npy_head(opened: Callable[[], IO[bytes]], size: int | None, *, growing: bool = False) -> _Head:
    """Return the head of an .npy.

    size: bytes of the file, which must be what its header promises, or None. growing: whether the
    last frame may not be complete.
    """
    with opened() as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"an array has the unknown version {version}")
        shape, _, dtype = _HEADERS[version](file)
        begin = file.tell()
    promised = dtype.itemsize * math.prod(shape)
    if min(shape, default=0) < 0 or size not in (None, begin + promised):
        raise ValueError(f"an array of {shape} needs {promised} bytes, and the file has {size}")

    def read(frames: int) -> NDArray[Any]:
        with opened() as file:
            if not growing:
                return np.asarray(np.lib.format.read_array(file, allow_pickle=False))
            file.seek(begin)
            data = file.read(frames * math.prod(shape[1:]) * dtype.itemsize)
            return np.frombuffer(data, dtype).reshape(frames, *shape[1:]).copy()

    return _Head(tuple(shape), dtype, read, growing)


# HDF5


@contextlib.contextmanager
def _hdf5(path: Path, wanted: _Wanted) -> Iterator[_Heads]:
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
        yield _datasets(file, os.path.getsize(path), wanted)


def _datasets(file: Any, size: int, wanted: _Wanted) -> _Heads:
    """Return the heads of the wanted datasets; size: bytes of the file."""
    import h5py

    heads = {}
    for name in filter(wanted, file):
        if not isinstance(file.get(name, getlink=True), h5py.HardLink):
            continue  # it would lead to another file
        dataset = file[name]
        if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual:
            continue
        growing = dataset.maxshape[:1] == (None,)
        if dataset.nbytes > _MOST_UNPACKED * size:
            raise ValueError(f"{name} says to hold {dataset.nbytes} bytes, more than the file can")
        heads[name] = _Head(dataset.shape, dataset.dtype, _reader(dataset, growing), growing)
    return heads


def _reader(dataset: Any, growing: bool) -> Callable[[int], NDArray[Any]]:
    def read(frames: int) -> NDArray[Any]:
        found = np.asarray(dataset[:frames] if growing else dataset[()])
        return np.char.decode(found, "utf-8") if found.dtype.kind == "S" else found

    return read


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
    try:
        subprocess.run(
            [sys.executable, "-c", code, os.fspath(path)],
            check=True,
            capture_output=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"it is damaged: not read within {limit:.0f} s") from None
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"]
        raise ValueError(f"it is damaged: {said[-1]}") from None
