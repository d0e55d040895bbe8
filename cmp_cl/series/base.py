"""The part that all formats of a series share."""

import contextlib
import dataclasses
import datetime
from collections.abc import Mapping
from numbers import Integral, Real
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import FieldError, check_kind
from cmp_cl.version import package_version

Frame = dict[str, NDArray[Any]]
FileName = str | PathLike[str]
Constants = Mapping[str, ArrayLike]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Description:
    """The description that is stored with a series.

    units: units of the arrays, by name; arrays without an entry have no unit. settings:
    configuration, device and source, as texts by name. Raises FieldError if either is no Mapping.
    """

    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    settings: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        check_kind("units", self.units, Mapping, FieldError)
        check_kind("settings", self.settings, Mapping, FieldError)

    def entries(self) -> dict[str, str]:
        """Return cmp_cl's version, the time of writing (UTC, ISO 8601) and the settings, by
        name."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        return {"cmp_cl": package_version(), "written": now, **self.settings}

    def with_units(self) -> dict[str, Any]:
        """Return the units of the arrays, then the entries."""
        return {"units": dict(self.units), **self.entries()}


def _array(name: object, value: ArrayLike, kinds: str) -> NDArray[Any]:
    """Return an array of a series, of one of NumPy's kinds; raises FieldError if it is none."""
    if not isinstance(name, str) or "/" in name:
        raise FieldError(f"the name of an array must be a text without /, not {name!r}")
    try:
        array = np.asarray(value)
    except ValueError as why:
        raise FieldError(f"{name} must be an array of numbers: {why}") from why
    if array.dtype.kind not in kinds:
        raise FieldError(f"{name} must be an array of numbers, not of {array.dtype}")
    return array


class Series(Closing):
    """Writes a series frame by frame; use it in a with statement.

    description: stored with the arrays, or None. constants: arrays that hold for all frames.


        with open_series("press.h5", constants={"rest": rest.xyz}) as series:
            series.append(index=i, time_ms=t, displacement=field.displacement)

    Every frame has the same arrays, of the same shapes and types; those of the nodes begin with (R,
    C). The frames written before an exception or Ctrl-C are kept; before the first one, an older
    file stays.
    """

    def __init__(self, description: Description, constants: Constants) -> None:
        self.description = description
        self.files = contextlib.ExitStack()  # left with an error, it removes the files
        self.constants = {name: _array(name, value, "biufUS") for name, value in constants.items()}
        self._layout: dict[str, tuple[tuple[int, ...], str]] | None = None
        self._count = 0
        self._open = True

    def __len__(self) -> int:
        """Return the number of frames so far."""
        return self._count

    def append(self, *, index: int, time_ms: float, **arrays: ArrayLike) -> None:
        """Add a frame.

        index: its number. time_ms: its time stamp, ms, NaN if unknown. arrays: by name.

        Raises FieldError if index is not whole, time_ms is not a number, the names, shapes or
        types differ from the first frame's, a name is one of the constants', or the series is
        closed; then nothing is added.
        Raises OSError.
        """
        if not self._open:
            raise FieldError("the series is closed")
        check_kind("index", index, Integral, FieldError)
        check_kind("time_ms", time_ms, Real, FieldError)
        frame = {name: _array(name, value, "biuf") for name, value in arrays.items()}
        layout = {name: (value.shape, value.dtype.str) for name, value in frame.items()}
        if self._layout is not None and layout != self._layout:
            raise FieldError(f"the first frame had {self._layout}, this one has {layout}")
        taken = sorted(layout.keys() & (self.constants.keys() | {"index", "time_ms"}))
        if taken:
            raise FieldError(f"the series already has constants or columns of the names {taken}")
        self._write(index, time_ms, frame)
        self._layout = layout
        self._count += 1

    def __exit__(self, *raised: Any) -> None:
        if raised[0] is not None and self._open and not self._count:
            self._open = False
            self._abandon()
            self.files.__exit__(*raised)
        self.close()

    def close(self) -> None:
        """Finish the file; closing again does nothing. Raises OSError."""
        if self._open:
            self._open = False
            self._finish()

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        raise NotImplementedError

    def _abandon(self) -> None:
        """Remove what is not in `files`, because an error came before the first frame."""

    def _finish(self) -> None:
        self.files.close()
