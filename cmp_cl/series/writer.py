"""Writes a series frame by frame, in the format of the suffix."""

import datetime
import importlib
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import ConfigError, FieldError, check_kind, extra
from cmp_cl.files import check_target, new_folder, suffix_of, version, whole_path
from cmp_cl.series import formats, mcap
from cmp_cl.series.part import LARGEST, Arrays, Part, Stored, is_written

_FORMATS: dict[str, Callable[[Stored, Path, Path], None]] = {
    ".npz": formats.write_npz,
    ".h5": formats.write_hdf5,
    ".csv": formats.write_csv,
    ".pvd": formats.write_pvd,
    ".mcap": mcap.write_mcap,
}
_PACKAGES = {".h5": ("hdf5", "h5py"), ".mcap": ("mcap", "mcap_ros2.writer")}
_OF_NODES = (".csv", ".pvd", ".mcap")  # these need what `formats.moved_by` returns
SERIES_SUFFIXES = tuple(_FORMATS)
_TAKEN = "about", "index", "time_ms", "file", "allow_pickle"  # the last are of numpy.savez

# What this library writes of a recording, by the unit.
_LENGTHS = [f"{raw}{name}" for raw in ("", "raw_") for name in ("rest", "displacement", "sigma")]
_LENGTHS += ["bias_sigma"]
_UNITS = {
    **dict.fromkeys(("xy", "left", "right", "xy_rest", "left_rest", "right_rest"), "px"),
    **{"direction": "rad", "direction_sigma": "rad", "time_ms": "ms"},
}


def check_series(path: str | PathLike[str]) -> Path:
    """Return the file that a series of that name becomes; raises what `SeriesWriter` does for a
    path."""
    _known_suffix(path)
    target = check_target(path)
    _known_suffix(target)  # a link may name a file of another format
    return target


def complete(part: str | PathLike[str], target: str | PathLike[str]) -> None:
    """Make the file of a series from its part, in the format of the suffix, and remove the part,
    unless a process still writes it.

    part: NAME.part, as a process that was killed leaves it. target: an older file is replaced.

    Raises ConfigError on another suffix or if the format's package is missing, FieldError if the
    part is damaged or lacks what the format needs, OSError if the file cannot be written; then the
    part stays.
    """
    suffix = _known_suffix(target)
    try:
        stored = Stored.of(Path(part))
    except (OSError, ValueError, KeyError) as error:
        raise FieldError(f"{str(part)!r} is damaged or no part of a series: {error}") from error
    with whole_path(target, suffix) as path:
        _FORMATS[suffix](stored, path, Path(target))
        with open(path, "rb+") as file:
            os.fsync(file.fileno())  # the part goes, so a power cut must find the file
    del stored  # Windows removes no file that is mapped
    if not is_written(Path(part)):
        shutil.rmtree(part)


class _Lines:
    """One line of JSON per frame on standard output, flushed after each.

    The first line has the description and the constants. A missing number is null.
    """

    def __init__(self, about: Mapping[str, Any], constants: Arrays) -> None:
        self._line(
            {**about, "constants": {name: formats.plain(each) for name, each in constants.items()}}
        )

    def _line(self, members: Mapping[str, Any]) -> None:
        sys.stdout.buffer.write(json.dumps(members).encode() + b"\n")
        sys.stdout.buffer.flush()

    def append(self, _number: int, index: int, time_ms: float, frame: Arrays) -> None:
        """Write a frame."""
        arrays = {"time_ms": np.array(time_ms), **frame}
        self._line({"frame": index, **{name: formats.plain(each) for name, each in arrays.items()}})


class SeriesWriter(Closing):
    """Writes a series frame by frame, in the format of the suffix; memory does not grow with it.

    path: .npz, .h5, .csv, .pvd or .mcap, or `-` for JSON lines on standard output. settings: texts
    by name that are stored too, such as the configuration. constants: arrays that hold for all
    frames, such as `rest`, the positions at rest, and `unit`, that of the lengths. With it, the
    arrays of a recording (docs/formats.md) have their units in the file.

        with SeriesWriter("press.npz", rest=rest.xyz, unit="mm") as series:
            series.append(index=i, time_ms=t, displacement=field.displacement)

    Every frame has the same arrays, of the same shapes and types; those of the nodes begin with (R,
    C). While it is written the series is in the folder NAME.part (press.npz.part), whatever the
    format, and every frame that was appended can be read there, even if the process is killed. When
    the `with` block ends, also by an exception or Ctrl-C, the file is made from it, and an older
    file is replaced; so the disk must hold both for a moment. Without a frame, an error keeps the
    older file.

    earlier: the parts of that name that were there before, of a process that was killed or still
    writes. They are kept; this one is then NAME.part-2.

    Raises ConfigError on another suffix or if the format's package is missing, FieldError if a
    constant is no array, OSError if the folder is missing or not writable.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        /,
        *,
        settings: Mapping[str, str] | None = None,
        **constants: ArrayLike,
    ) -> None:
        self._constants = {name: _array(name, value, "biufUS") for name, value in constants.items()}
        self._layout: dict[str, tuple[tuple[int, ...], str]] | None = None
        self._count = 0
        self._open = True
        self.earlier: list[Path] = []
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        units = dict(_UNITS)
        if "unit" in constants:
            units |= dict.fromkeys(_LENGTHS, str(constants["unit"]))
        about = {"units": units, "cmp_cl": version(), "written": now, **(settings or {})}
        self._target = Path("-")
        self._of_nodes = False
        if isinstance(path, str) and path == "-":
            self._sink: Part | _Lines = _Lines(about, self._constants)
            return
        self._target = check_series(path)
        self._of_nodes = self._target.suffix.lower() in _OF_NODES
        part, self.earlier = new_folder(self._target.with_name(f"{self._target.name}.part"))
        self._sink = Part(part, about, self._constants)

    def __len__(self) -> int:
        """Return the number of frames so far."""
        return self._count

    def append(self, *, index: int, time_ms: float, **arrays: ArrayLike) -> None:
        """Add a frame.

        index: its number. time_ms: its time stamp, ms, NaN if unknown. arrays: by name.

        Raises FieldError if index is not whole, time_ms is not a number or infinite, the names,
        shapes or types differ from the first frame's, a name is one of the constants', the format
        needs `rest` and `displacement` of nodes or has no such time, or the series is closed;
        OSError, for example if the disk is full. Then nothing is added.
        """
        if not self._open:
            raise FieldError("the series is closed")
        check_kind("index", index, Integral, FieldError)
        check_kind("time_ms", time_ms, Real, FieldError)
        if not -(2**63) <= index < 2**63:
            raise FieldError(f"index must be a number of 64 bits, not {index}")
        frame = {name: _array(name, value, "biuf") for name, value in arrays.items()}
        layout = {name: (value.shape, value.dtype.str) for name, value in frame.items()}
        if self._layout is not None and layout != self._layout:
            raise FieldError(f"the first frame had {self._layout}, this one has {layout}")
        taken = sorted(layout.keys() & self._constants.keys())
        if taken:
            raise FieldError(f"the series already has constants of the names {taken}")
        if self._of_nodes:
            formats.moved_by(self._constants, frame)
        if self._target.suffix.lower() == ".mcap":
            mcap.stamp_ns(int(index), float(time_ms))
        if abs(time_ms) > LARGEST:
            raise FieldError(f"time_ms must be up to {LARGEST:g}, or NaN if unknown, not {time_ms}")
        try:
            self._sink.append(self._count, int(index), float(time_ms), frame)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise OSError(error.errno, error.strerror or str(error), str(self._target)) from error
        self._layout = layout
        self._count += 1

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None and not self._count and isinstance(self._sink, Part):
            self._open = False
            self._sink.discard()
        self.close()

    def close(self) -> None:
        """Make the file; closing again does nothing.

        Raises OSError if the disk has no room for it; what was added is then at NAME.part.
        """
        was_open, self._open = self._open, False
        if not was_open or isinstance(self._sink, _Lines):
            return
        self._sink.close()
        try:
            complete(self._sink.path, self._target)
            self._sink.discard()  # a forked process may have it locked
        except OSError as error:
            frames = "1 frame" if self._count == 1 else f"{self._count} frames"
            why = f"{error.strerror or error}; what was added, {frames}, is in {self._sink.path}"
            raise OSError(error.errno, why, str(self._target)) from error


def _known_suffix(path: str | PathLike[str]) -> str:
    """Return the suffix of a path; raises ConfigError for an unknown one or without its package."""
    suffix = suffix_of(path)
    if suffix not in _FORMATS:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(_FORMATS)}")
    if suffix in _PACKAGES:
        name, module = _PACKAGES[suffix]
        with extra(name, f"a series in {suffix}"):
            importlib.import_module(module)
    return suffix


def _array(name: object, value: ArrayLike, kinds: str) -> NDArray[Any]:
    """Return an array of a series, of one of NumPy's kinds; raises FieldError if it is none."""
    usual = isinstance(name, str) and re.fullmatch(r"[\w .-]{1,100}", name) is not None
    if not usual or name in _TAKEN:
        taken = ", ".join(_TAKEN)
        raise FieldError(
            f"the name of an array must be letters and digits, and none of {taken}: {name!r}"
        )
    try:
        array = np.asarray(value)
    except ValueError as why:
        raise FieldError(f"{name} must be an array of numbers: {why}") from why
    if array.dtype.kind not in kinds:
        raise FieldError(f"{name} must be an array of numbers, not of {array.dtype}")
    return array
