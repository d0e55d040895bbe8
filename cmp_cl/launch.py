"""A kernel with its arguments, and what all forms of the stages share."""

from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl

from cmp_cl.config import AdaptiveMean

GROUP = 64  # work-items of a group over a list


class Launch(NamedTuple):
    """A kernel with its arguments, which must outlive it, and the work-items it runs over."""

    stage: str
    kernel: cl.Kernel
    items: tuple[int, ...]
    group: tuple[int, ...] | None
    arguments: tuple[Any, ...]


def multiple(value: int, of: int) -> int:
    """The least multiple that is not below the value, and not 0."""
    return max(-(-value // of), 1) * of


def level_type(threshold: AdaptiveMean, dtype: np.dtype[Any]) -> tuple[type[np.integer[Any]], int]:
    """LEVEL of the kernels, which holds (I + C) n, and C: no mean of bytes is above 255."""
    if dtype != np.uint16:
        return np.int32, min(threshold.offset, 255)
    return (np.uint64 if threshold.offset else np.uint32), threshold.offset
