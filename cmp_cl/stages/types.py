"""The type of every quantity, by the type of a pixel, in NumPy and in OpenCL C."""

from typing import Any

import numpy as np

from cmp_cl.config import BinaryRings, DetectorConfig, RapidCriteria

DType = np.dtype[Any]

_BY_PIXEL: dict[str, tuple[type[np.generic], type[np.generic]]] = {
    "PIXEL": (np.uint8, np.uint16),  # the first type is for 8-bit images, the second for 16 bits
    "CURVATURE": (np.int16, np.int32),  # [1 -2 1] along an axis, and along both
    "NOISE": (np.uint16, np.uint32),  # eight absolute curvatures
    "ROW_NOISE": (np.uint32, np.uint64),  # the same, summed over a row
    "SUM_OF_COLUMN": (np.uint16, np.uint32),  # the sum of a window's column
    "LEVEL": (np.int32, np.uint32),  # (I + C) n, compared with the sum of a window
    "CONTRAST": (np.int16, np.int32),  # of the gate
}
_IN_C: dict[type[np.generic], str] = {
    np.uint8: "uchar",
    np.uint16: "ushort",
    np.int16: "short",
    np.uint32: "uint",
    np.int32: "int",
    np.uint64: "ulong",
}


def types_of(pixel: DType, config: DetectorConfig) -> dict[str, DType]:
    """Return the type of every quantity that the kernels name."""
    deep = pixel == np.uint16
    types = {name: np.dtype(pair[deep]) for name, pair in _BY_PIXEL.items()}
    rule = config.detection
    if isinstance(rule, BinaryRings):
        if deep and rule.threshold.offset:
            types["LEVEL"] = np.dtype(np.uint64)
        rapid = isinstance(rule.criteria, RapidCriteria)
        types["RESPONSE"] = np.dtype(np.uint8 if rapid else np.uint16)
        types["SCORE"] = np.dtype(np.uint16 if rapid else np.int32)
    return types


def defines_of(types: dict[str, DType]) -> dict[str, str | int]:
    """Return the macros that give the kernels these types."""
    names: dict[str, str | int] = {name: _IN_C[dtype.type] for name, dtype in types.items()}
    return {**names, "PIXEL_BITS": 8 * types["PIXEL"].itemsize}
