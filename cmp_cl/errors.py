"""The errors of cmp_cl. Each message says what was given, what was expected and what to do."""

import math
from numbers import Real
from typing import cast


class CmpClError(Exception):
    """The base class of every error that cmp_cl raises on purpose."""


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
    """The OpenCL compiler rejected a kernel; the message contains its log."""


class CapacityError(CmpClError, RuntimeError):
    """The device has too little memory; the message gives the sizes needed and available."""


class GridError(CmpClError, ValueError):
    """The corners do not form one grid: no closed cell, two patterns, or too few corners in a
    grid."""


def check_kind(name: str, value: object, kind: type, error: type[CmpClError]) -> None:
    """Raise the error if an argument of that name is not of that kind."""
    if not isinstance(value, kind):
        raise error(f"{name} must be of type {kind.__name__}, not {type(value).__name__}")


def check_positive(name: str, value: object, error: type[CmpClError]) -> None:
    """Raise the error if an argument of that name is not a finite number above 0."""
    if not (isinstance(value, Real) and 0 < cast(float, value) < math.inf):
        raise error(f"{name} must be a positive number, not {value!r}")
