"""Values over a lattice as its kernels take them (kernels/field.clh), and launches over nodes."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.motion.tables import LANES, axis_tables
from cmp_cl.opencl.device import Device, DeviceKind
from cmp_cl.opencl.launches import GROUP, Launch, bound, multiple
from cmp_cl.opencl.program import Kernels

_PAIRS_OF_AXES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric matrix
_ENTRIES = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # the place of each entry among them
_UNIT = np.eye(2)[..., None, None]
Array = NDArray[np.float64]


def in_lines_of(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the shape of a plane of which kernels read whole rows, with columns that are not
    used."""
    return shape[0], multiple(shape[1], LANES)


def defines_of(shape: tuple[int, int], axes: int, device: Device) -> dict[str, str | int]:
    """Return the macros of the kernels of a lattice with that many coordinates."""
    down, along = (axis_tables(n) for n in shape)
    return {
        "IS_CPU": int(device.kind is DeviceKind.CPU),
        "ROWS": shape[0],
        "COLUMNS": shape[1],
        "K": axes,
        "PILOT_DOWN": down.pilot_side,
        "PILOT_ALONG": along.pilot_side,
        "FILTERS_DOWN": len(down.sides),
        "FILTERS_ALONG": len(along.sides),
        "PAIRS": len(down.sides) * len(along.sides),
        "BEND_DOWN": down.bend.shape[2],
        "BEND_ALONG": along.bend.shape[2],
    }


def of_nodes(
    kernels: Kernels, shape: tuple[int, int], parts: Mapping[str, Any], name: str, width: int = 1
) -> Launch:
    """Bind a kernel with one work-item for `width` nodes to the parts of these names."""
    items = multiple(shape[0] * shape[1], GROUP) // width
    return bound(kernels, parts, name, (items,), (GROUP // width,))


def covariances(axes: int) -> int:
    """Return the number of planes of a covariance: all entries in space, the variance in a
    plane."""
    return len(_PAIRS_OF_AXES) if axes == 3 else 1


def flat(covariance: Array) -> NDArray[np.float32]:
    """Return covariances (R, C, K, K) as planes: xx xy xz yy yz zz, or the variance per axis."""
    if covariance.shape[2] == 2:
        return planes(covariance[..., :1, 0])
    return planes(np.stack([covariance[..., i, j] for i, j in _PAIRS_OF_AXES], axis=-1))


def planes(values: Array) -> NDArray[np.float32]:
    """Return values of nodes (R, C, K) as planes (K, R, C) float32."""
    return np.ascontiguousarray(np.moveaxis(values, -1, 0), np.float32)


def nodes(planes: NDArray[np.float32]) -> Array:
    """Return planes (K, R, C) as values of nodes, (R, C, K) float64."""
    return planes.astype(np.float64).transpose(1, 2, 0)


def matrices(planes: NDArray[np.float32]) -> Array:
    """Return the symmetric matrices (R, C, K, K) float64 of xx xy xz yy yz zz, (6, R, C), or of the
    variance per axis of a plane, (1, R, C)."""
    full = _UNIT * planes if len(planes) == 1 else planes[_ENTRIES].astype(np.float64)
    return full.transpose(2, 3, 0, 1)
