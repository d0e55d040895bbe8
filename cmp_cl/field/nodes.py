"""The nodes of a grid as columns of a table, and as a surface for VTK."""

import base64
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.points import corners_of_cells

Arrays = Mapping[str, NDArray[Any]]

_AXES = "x", "y", "z"
_PARTS = {  # names of the parts of arrays that are not vectors
    **dict.fromkeys(("strain", "strain_sigma"), ("11", "22", "12")),
    **dict.fromkeys(("principal", "principal_sigma"), ("1", "2")),
}


def node_columns(arrays: Arrays, units: Mapping[str, str]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Return the columns of R x C nodes: name with unit, values (R C,).

    arrays: by name. units: their units by name. (R, C) is one column; (R, C, 2) and (R, C, 3)
    have the suffixes _x, _y, _z, strains _11, _22, _12, others numbers. Numbers and vectors of the
    whole frame come last.
    """
    shape = next(value.shape[:2] for value in arrays.values() if value.ndim in (2, 3))
    rows, columns = np.indices(shape)
    yield "row", rows.ravel()
    yield "column", columns.ravel()
    ordered = sorted(arrays.items(), key=lambda item: item[1].shape[:2] != shape)
    for name, value in ordered:
        of_nodes = value.shape[:2] == shape
        if value.ndim > (3 if of_nodes else 1):
            continue
        full = value if of_nodes else np.broadcast_to(value, (*shape, *value.shape))
        unit = f"_{units[name]}" if name in units else ""
        if full.ndim == 2:
            yield f"{name}{unit}", full.ravel()
            continue
        ends = _PARTS.get(name, _AXES)
        if full.shape[2] > len(ends):
            ends = tuple(map(str, range(full.shape[2])))
        for part, end in enumerate(ends[: full.shape[2]]):
            yield f"{name}_{end}{unit}", full[..., part].ravel()


def quadrilaterals(valid: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the cells (Q, 4) whose four nodes are valid, as numbers of the valid nodes."""
    number = np.full(valid.shape, -1, np.int32)
    number[valid] = np.arange(valid.sum())
    quads = np.stack(corners_of_cells(number), axis=-1).reshape(-1, 4)
    return quads[(quads >= 0).all(axis=1)]


def surface(rest: NDArray[Any], shift: NDArray[Any], arrays: Arrays, *, comment: str = "") -> bytes:
    """Return a .vtp file: VTK's PolyData of the valid nodes and the quadrilaterals between them.

    rest, shift: positions at rest and displacements, (R, C, 2 or 3); a plane lies at z = 0. arrays:
    values by name: (R, C) or (R, C, K) of the nodes, or one number, which becomes field data;
    others are left out.
    "Warp By Vector" shows the surface as it is now.
    """
    valid = np.isfinite(rest + shift).all(axis=2)
    row, column = np.nonzero(valid)
    values = {"displacement": _in_space(shift[valid]), "row": row, "column": column}
    for name, value in arrays.items():
        if value.shape[:2] == valid.shape and value.ndim in (2, 3):
            values.setdefault(name, value[valid])
    data = "".join(_data_array(name, value) for name, value in values.items())
    whole = "".join(
        _data_array(name, value.reshape(1), "Tuples")
        for name, value in arrays.items()
        if not value.ndim
    )
    quads = quadrilaterals(valid)
    ends = np.arange(4, 4 * len(quads) + 1, 4)
    return f"""<?xml version="1.0"?>
{comment}<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData>
<FieldData>
{whole}</FieldData>
<Piece NumberOfPoints="{len(row)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" \
NumberOfPolys="{len(quads)}">
<PointData Vectors="displacement">
{data}</PointData>
<Points>
{_data_array("Points", _in_space(rest[valid]))}</Points>
<Polys>
{_data_array("connectivity", quads.ravel())}{_data_array("offsets", ends)}</Polys>
</Piece>
</PolyData>
</VTKFile>
""".encode()


def _in_space(points: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N, 2) with a third coordinate of 0, or (N, 3) as they are."""
    return np.pad(points.astype(np.float64), ((0, 0), (0, 3 - points.shape[1])))


def _data_array(name: str, values: NDArray[Any], counted: str = "Components") -> str:
    kind, dtype = ("Float64", "<f8") if values.dtype.kind == "f" else ("Int32", "<i4")
    width = values.shape[1] if values.ndim == 2 else 1
    raw = values.astype(dtype).tobytes()
    body = base64.b64encode(struct.pack("<Q", len(raw)) + raw).decode("ascii")
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOf{counted}="{width}" format="binary">'
        f"\n{body}\n</DataArray>\n"
    )
