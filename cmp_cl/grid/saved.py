"""The arrays that keep a grid in a file."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

# The attributes of a grid that are kept: the dtype of the array, and its shape. R rows, C columns
# and N corners are those of the arrays that come first.
SAVED: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "status": ("uint8", ("R", "C")),
    "index": ("int32", ("N", 2)),
    "xy": ("float32", ("R", "C", 2)),
    "image_sigma": ("float32", ("R", "C")),
    "parity": ("int64", ()),
    "origin": ("int64", (2,)),
    "border": ("bool", (4,)),
    "reach": ("float64", (4,)),
    "seen_shape": ("int64", (2,)),
    "confidence": ("float64", ()),
    "rival": ("int64", (3,)),
    "others": ("int64", ()),
    "others_are": ("int64", ()),
    "edge_radius": ("float64", ()),
}
_MAY_BE_NONE = ("border", "seen_shape", "rival")  # then the array has no elements
_ARRAYS = ("status", "index", "xy", "image_sigma")
_STATUSES = 6  # of `NodeStatus`


def packed(grid: Any) -> dict[str, Any]:
    """Return the arrays of a grid, by the name of the attribute."""
    values = {name: getattr(grid, name) for name in SAVED}
    return {
        name: np.asarray(() if values[name] is None else values[name], kind)
        for name, (kind, _) in SAVED.items()
    }


def check_shapes(arrays: Arrays) -> None:
    """Raise ValueError with the name of an array that is missing, or of a shape or type that no
    grid has."""
    sizes: dict[str | int, int] = {}
    for name, (kind, axes) in SAVED.items():
        if name not in arrays:
            raise ValueError(f"there is no array {name!r}")
        found = arrays[name]
        fits = found.dtype == kind and found.ndim == len(axes)
        for axis, size in zip(axes, found.shape, strict=False):
            fits &= size == (axis if isinstance(axis, int) else sizes.setdefault(axis, size))
        none = name in _MAY_BE_NONE and found.shape == (0,) and found.dtype == kind
        if not (fits or none):
            shape = tuple(sizes.get(axis, axis) for axis in axes)
            raise ValueError(
                f"{name} must be {_words(shape)} of {kind}, found {_words(found.shape)} of "
                f"{found.dtype}"
            )


def unpacked(arrays: Arrays) -> dict[str, Any]:
    """Return the attributes that `packed` packed: arrays, tuples, numbers or None.

    arrays: of their shapes and types. Raises ValueError with the name of one that no grid has.
    """
    _check_values(arrays)
    return {
        name: array if name in _ARRAYS else _plain(array, none=name in _MAY_BE_NONE)
        for name, array in arrays.items()
    }


def _plain(array: NDArray[Any], *, none: bool) -> Any:
    values = array.tolist()
    if not array.ndim:
        return values
    return None if none and not values else tuple(values)


def _words(shape: tuple[str | int, ...]) -> str:
    return f"({', '.join(map(str, shape))})"


def _check_values(arrays: Arrays) -> None:
    status, index, xy = arrays["status"], arrays["index"], arrays["xy"]
    if (status >= _STATUSES).any():
        raise ValueError(f"status must be under {_STATUSES}, found {status.max()}")
    wrong = np.isfinite(xy).all(axis=2) != (status > 0)
    wrong |= np.isnan(xy).any(axis=2) != np.isnan(xy).all(axis=2)
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        raise ValueError(
            f"xy must be NaN where status is 0 and finite elsewhere, found {xy[row, column]} with "
            f"status {status[row, column]} at row {row}, column {column}"
        )
    inside = ((index >= 0) & (index < status.shape)).all(axis=1) | (index == -1).all(axis=1)
    if not inside.all():
        raise ValueError(
            f"index must lie in {_words(status.shape)} or be -1, found {index[~inside][0].tolist()}"
        )
    if arrays["parity"] not in (0, 1):
        raise ValueError(f"parity must be 0 or 1, found {arrays['parity']}")
    if arrays["others"] < 0:
        raise ValueError(f"others must not be negative, found {arrays['others']}")
