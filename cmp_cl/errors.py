"""The errors of cmp_cl. Each message says what was given, what was expected and what to do."""

import contextlib
import math
from collections.abc import Iterable, Iterator
from numbers import Real
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")


class CmpClError(Exception):
    """The base class of every error that cmp_cl raises on purpose; its message is one line."""

    def __str__(self) -> str:
        return " ".join(line.strip() for line in super().__str__().splitlines())


class ConfigError(CmpClError, ValueError):
    """A configuration field has a wrong type or a value outside its range."""


class ImageError(CmpClError, ValueError):
    """An image is not what a detector takes: (H, W) uint8 or uint16, row-contiguous."""


class CalibrationError(CmpClError, ValueError):
    """Camera parameters are missing, malformed or degenerate."""


class FieldError(CmpClError, ValueError):
    """Grids, points or fields do not match in shape, unit or name."""


class DeviceError(CmpClError, RuntimeError):
    """The requested OpenCL device does not exist or cannot be used."""


class KernelBuildError(CmpClError, RuntimeError):
    """The OpenCL compiler rejected a kernel; the message contains its log, line by line."""

    __str__ = Exception.__str__


class CapacityError(CmpClError, RuntimeError):
    """The device has too little memory; the message gives the sizes needed and available."""


class GridError(CmpClError, ValueError):
    """The corners do not form one grid: no board of nine, two patterns, or too few corners in a
    grid."""


def check_kind(name: str, value: object, kind: type, error: type[CmpClError]) -> None:
    """Raise the error if an argument of that name is not of that kind."""
    if not isinstance(value, kind):
        raise error(f"{name} must be of type {kind.__name__}, not {type(value).__name__}")


def listed(name: str, values: Any, kind: type, error: type[CmpClError]) -> list[Any]:
    """Return the values of an argument of that name; raise the error if one is of another kind."""
    try:
        found = list(values)
    except TypeError as why:
        raise error(f"{name} must be several, not one {type(values).__name__}") from why
    for value in found:
        check_kind(f"each of {name}", value, kind, error)
    return found


def as_numbers(name: str, value: Any, error: type[CmpClError]) -> NDArray[np.float64]:
    """Return an argument of that name as a new array; raise the error if it is not of numbers."""
    try:
        if np.iscomplexobj(value):
            raise TypeError("they are complex")
        return np.array(value, np.float64)
    except (TypeError, ValueError) as why:
        raise error(f"{name} must be an array of numbers: {why}") from why


def check_range(
    name: str, value: Any, low: float, high: float, *, kind: type = float, odd: bool = False
) -> None:
    """Raise ConfigError if an argument of that name is not a number of that kind in [low, high].

    kind: int or float, which takes an int too. odd: whether it must be odd.
    """
    noun = "an odd integer" if odd else "an integer" if kind is int else "a number"
    number = isinstance(value, int | kind) and not isinstance(value, bool)
    if not number or not low <= value <= high or (odd and value % 2 == 0):
        what = "" if number else f" ({type(value).__name__})"
        raise ConfigError(
            f"{name} must be {noun} in [{low:.10g}, {high:.10g}], not {value!r}{what}"
        )


def check_shape(shape: Any, error: type[CmpClError]) -> None:
    """Raise the error if a shape is not two whole numbers from 1."""
    sides = shape if isinstance(shape, tuple | list) else ()
    whole = [isinstance(n, int | np.integer) and type(n) is not bool and n >= 1 for n in sides]
    if whole != [True, True]:
        raise error(f"shape must be (rows, columns), each at least 1, not {shape!r}")


def check_positive(name: str, value: object, error: type[CmpClError]) -> None:
    """Raise the error if an argument of that name is not a finite number above 0."""
    if not (isinstance(value, Real) and 0 < cast(float, value) < math.inf):
        raise error(f"{name} must be a positive number, not {value!r}")


def errors_last(items: Iterable[T]) -> Iterator[T | Exception]:
    """Yield the items; an error in making one is the last, so that those before it can be used."""
    try:
        yield from items
    except Exception as error:
        yield error


@contextlib.contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Import in this block; if that fails, raise ConfigError, which names the extra to install."""
    try:
        yield
    except ImportError as error:
        missing = f" ({error.name} is not installed)" if error.name else ""
        raise ConfigError(f"{what} needs pip install 'cmp-cl[{name}]'{missing}") from error
