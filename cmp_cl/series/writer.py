"""Writes a series frame by frame, in the format of the suffix."""

import re
from numbers import Integral, Real
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import ConfigError, FieldError, check_kind
from cmp_cl.files import check_target, part_of, suffix_of
from cmp_cl.series.base import Description, Format
from cmp_cl.series.hdf5 import Hdf5Format
from cmp_cl.series.mcap import McapFormat
from cmp_cl.series.npz import NpzFormat
from cmp_cl.series.paraview import ParaViewFormat
from cmp_cl.series.tables import CsvFormat, JsonLines

_FORMATS: dict[str, type[Format]] = {
    ".npz": NpzFormat,
    ".h5": Hdf5Format,
    ".hdf5": Hdf5Format,
    ".csv": CsvFormat,
    ".pvd": ParaViewFormat,
    ".mcap": McapFormat,
}
SERIES_SUFFIXES = tuple(_FORMATS)


class SeriesWriter(Closing):
    """Writes a series frame by frame, in the format of the suffix; memory does not grow with it.

    path: .npz, .h5, .csv, .pvd or .mcap, or `-` for JSON lines on standard output. description:
    stored with the arrays, or None. constants: arrays that hold for all frames, such as the
    positions at rest and the unit.

        with SeriesWriter("press.npz", rest=rest.xyz, unit="mm") as series:
            series.append(index=i, time_ms=t, displacement=field.displacement)

    Every frame has the same arrays, of the same shapes and types; those of the nodes begin with (R,
    C). While it is written the series is at NAME.part (press.npz.part), and every frame that was
    appended can be read there, even if the process is killed. When the `with` block ends, also by
    an exception or Ctrl-C, it is renamed to NAME, and an older file is replaced; without a frame,
    an error keeps the older file.

    earlier: the parts of that name that were there before, of a process that was killed or still
    writes. They are kept; this one is then NAME.part-2.

    Raises ConfigError on another suffix or if the format's package is missing, FieldError if a
    constant is no array or the format needs one that is not given, OSError if the folder is missing
    or not writable.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        /,
        *,
        description: Description | None = None,
        **constants: ArrayLike,
    ) -> None:
        description = Description() if description is None else description
        check_kind("description", description, Description, ConfigError)
        self._constants = {name: _array(name, value, "biufUS") for name, value in constants.items()}
        self._layout: dict[str, tuple[tuple[int, ...], str]] | None = None
        self._count = 0
        self._open = True
        self.earlier: list[Path] = []
        self._target = Path("-")
        if isinstance(path, str) and path == "-":
            self._format: Format = JsonLines(self._target, description, self._constants)
            return
        suffix = suffix_of(path, ConfigError)
        if suffix not in _FORMATS:
            raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(_FORMATS)}")
        self._target = check_target(path)
        part, self.earlier = part_of(self._target)
        try:
            self._format = _FORMATS[suffix](part, description, self._constants)
        except BaseException:
            part.unlink(missing_ok=True)
            raise

    def __len__(self) -> int:
        """Return the number of frames so far."""
        return self._count

    def append(self, *, index: int, time_ms: float, **arrays: ArrayLike) -> None:
        """Add a frame.

        index: its number. time_ms: its time stamp, ms, NaN if unknown. arrays: by name.

        Raises FieldError if index is not whole, time_ms is not a number, the names, shapes or types
        differ from the first frame's, a name is one of the constants', or the series is closed;
        OSError, for example if the disk is full. Then nothing is added.
        """
        if not self._open:
            raise FieldError("the series is closed")
        check_kind("index", index, Integral, FieldError)
        check_kind("time_ms", time_ms, Real, FieldError)
        frame = {name: _array(name, value, "biuf") for name, value in arrays.items()}
        layout = {name: (value.shape, value.dtype.str) for name, value in frame.items()}
        if self._layout is not None and layout != self._layout:
            raise FieldError(f"the first frame had {self._layout}, this one has {layout}")
        taken = sorted(layout.keys() & self._constants.keys())
        if taken:
            raise FieldError(f"the series already has constants of the names {taken}")
        try:
            self._format.write(self._count, int(index), float(time_ms), frame)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise OSError(error.errno, error.strerror or str(error), str(self._target)) from error
        self._layout = layout
        self._count += 1

    def __exit__(self, *raised: object) -> None:
        if raised[0] is not None and self._open and not self._count:
            self._open = False
            self._format.close()
            self._format.discard()
        self.close()

    def close(self) -> None:
        """Finish the file; closing again does nothing.

        Raises OSError if the disk has no room for it; what was added is then at NAME.part.
        """
        if not self._open:
            return
        self._open = False
        try:
            self._format.finish(self._target, self._count)
        except BrokenPipeError:
            raise
        except OSError as error:
            self._format.close()
            frames = "1 frame" if self._count == 1 else f"{self._count} frames"
            why = f"{error.strerror or error}; what was added, {frames}, is in {self._format.part}"
            raise OSError(error.errno, why, str(self._target)) from error


def _array(name: object, value: ArrayLike, kinds: str) -> NDArray[Any]:
    """Return an array of a series, of one of NumPy's kinds; raises FieldError if it is none."""
    if not isinstance(name, str) or re.fullmatch(r"[\w .-]{1,100}", name) is None:
        raise FieldError(f"the name of an array must be letters and digits, not {name!r}")
    try:
        array = np.asarray(value)
    except ValueError as why:
        raise FieldError(f"{name} must be an array of numbers: {why}") from why
    if array.dtype.kind not in kinds:
        raise FieldError(f"{name} must be an array of numbers, not of {array.dtype}")
    return array
