"""Writes the nodes of a grid, and the quadrilaterals between them, as VTK's PolyData."""

import base64
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def quadrilaterals(valid: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the cells (Q, 4) whose four nodes are valid, as numbers of the valid nodes."""
    number = np.full(valid.shape, -1, np.int32)
    number[valid] = np.arange(valid.sum())
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    return quads[(quads >= 0).all(axis=1)]


def polydata(
    points: NDArray[np.float64],
    quads: NDArray[np.int32],
    columns: Mapping[str, NDArray[Any]],
    *,
    comment: str = "",
) -> str:
    """Return the text of a .vtp file.

    points: (N, 3). quads: (Q, 4). columns: the values at the points by name, (N,) or (N, K) each;
    one of them is `displacement`.
    """
    data = "".join(_array(name, values) for name, values in columns.items())
    ends = np.arange(4, 4 * len(quads) + 1, 4, dtype=np.int32)
    return f"""<?xml version="1.0"?>
{comment}<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData>
<Piece NumberOfPoints="{len(points)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" \
NumberOfPolys="{len(quads)}">
<PointData Vectors="displacement">
{data}</PointData>
<Points>
{_array("Points", points)}</Points>
<Polys>
{_array("connectivity", quads.reshape(-1))}{_array("offsets", ends)}</Polys>
</Piece>
</PolyData>
</VTKFile>
"""


def _array(name: str, values: NDArray[Any]) -> str:
    kind, dtype = ("Float64", "<f8") if values.dtype.kind == "f" else ("Int32", "<i4")
    width = values.shape[1] if values.ndim == 2 else 1
    raw = values.astype(dtype).tobytes()
    body = base64.b64encode(struct.pack("<Q", len(raw)) + raw).decode("ascii")
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="binary">'
        f"\n{body}\n</DataArray>\n"
    )
