"""Writes one field as .npz, .csv, .ply or .vtp."""

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, FieldError, check_kind
from cmp_cl.files import suffix_of, whole_file, write_bytes, write_csv
from cmp_cl.grid.grid import NodeStatus
from cmp_cl.stereo.points import PointStatus
from cmp_cl.vtk import polydata, quadrilaterals

if TYPE_CHECKING:
    from cmp_cl.field.field import DisplacementField


def save(field: "DisplacementField", path: str | PathLike[str]) -> None:
    """Write a field by suffix, whole or not at all; positions are those at rest.

    .npz: the arrays of the field under their names, for numpy.load.
    .csv: a row per node, the unit in the header, nan where missing.
    .ply: the valid nodes and the quadrilaterals between them, little-endian.
    .vtp: the same for VTK and ParaView; "Warp By Vector" shows the surface as it is now.

    Raises ConfigError on another suffix, OSError if the file cannot be written.
    """
    writers = {".npz": _save_npz, ".csv": _save_csv, ".ply": _save_ply, ".vtp": _save_vtp}
    suffix = suffix_of(path, ConfigError)
    if suffix not in writers:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(writers)}")
    writers[suffix](field, path)


def _arrays(field: "DisplacementField", begin: str = "") -> dict[str, NDArray[Any]]:
    """Return the arrays of a field by name; those of the raw one begin with raw_."""
    arrays: dict[str, NDArray[Any]] = {
        f"{begin}position": field.position,
        f"{begin}displacement": field.displacement,
        f"{begin}sigma": field.sigma,
    }
    if field.strain is not None and field.strain_sigma is not None:
        arrays |= {f"{begin}strain": field.strain, f"{begin}strain_sigma": field.strain_sigma}
    arrays[f"{begin}position_sigma"] = field.position_sigma
    if field.raw is not None:
        arrays |= _arrays(field.raw, "raw_")
    return arrays


def _save_npz(field: "DisplacementField", path: str | PathLike[str]) -> None:
    arrays: dict[str, Any] = _arrays(field) | {
        "status": field.status,
        "source": field.source,
        "unit": np.array(field.unit),
        "filtered": np.array(field.raw is not None),
    }
    with whole_file(path) as file:
        np.savez(file, **arrays)


_FIRST = ("position", "displacement", "sigma")
_COLUMNS = {
    "position": ("x", "y", "z"),
    "position_sigma": ("position_sigma",),
    "displacement": ("ux", "uy", "uz"),
    "sigma": ("sigma",),
    "strain": ("e11", "e22", "e12"),
    "strain_sigma": ("e11_sigma", "e22_sigma", "e12_sigma"),
}


def _names(name: str) -> tuple[str, ...]:
    """Return the columns of an array of the field."""
    begin = "raw_" if name.startswith("raw_") else ""
    return tuple(begin + column for column in _COLUMNS[name.removeprefix("raw_")])


def _save_csv(field: "DisplacementField", path: str | PathLike[str]) -> None:
    arrays = _arrays(field)
    lengths, others = _columns(arrays, _FIRST, field.unit), [n for n in arrays if n not in _FIRST]
    header = ["row", "column", *lengths, "status", "source", *_columns(arrays, others, field.unit)]
    shape = field.status.shape
    parts = [
        np.concatenate([arrays[name].reshape(*shape, -1) for name in names], axis=2)
        for names in (_FIRST, others)
    ]
    rows = (
        [
            *(*node, *(float(number) for number in parts[0][node])),
            PointStatus(int(field.status[node])).name,
            NodeStatus(int(field.source[node])).name,
            *(float(number) for number in parts[1][node]),
        ]
        for node in np.ndindex(*shape)
    )
    write_csv(path, header, rows)


def _columns(arrays: dict[str, NDArray[Any]], names: Sequence[str], unit: str) -> list[str]:
    """Return the columns of some arrays, lengths with their unit."""
    return [
        column if "strain" in name else f"{column}_{unit}"
        for name in names
        if name in arrays
        for column in _names(name)
    ]


def mesh(field: "DisplacementField") -> tuple[dict[str, NDArray[Any]], NDArray[np.int32]]:
    """Return columns of the valid nodes of a field, and the quadrilaterals between them, (Q, 4)
    indices; raises FieldError if field is of another type."""
    from cmp_cl.field.field import DisplacementField  # imported here: it imports this module

    check_kind("field", field, DisplacementField, FieldError)
    valid = field.valid
    row, column = np.nonzero(valid)
    columns: dict[str, NDArray[Any]] = {
        **{name: array[valid] for name, array in _arrays(field).items()},
        "row": row.astype(np.int32),
        "column": column.astype(np.int32),
        "source": field.source[valid].astype(np.int32),
    }
    return columns, quadrilaterals(valid)


def _save_ply(field: "DisplacementField", path: str | PathLike[str]) -> None:
    columns, quads = mesh(field)
    names = {
        key: (key,) if values.dtype.kind == "i" else _names(key) for key, values in columns.items()
    }
    properties = [
        (name, values.dtype.kind == "i") for key, values in columns.items() for name in names[key]
    ]
    vertices = np.empty(
        len(columns["row"]), [(name, "<i4" if whole else "<f8") for name, whole in properties]
    )
    for key, values in columns.items():
        for name, column in zip(names[key], np.atleast_2d(values.T), strict=True):
            vertices[name] = column
    faces = np.empty(len(quads), [("count", "u1"), ("nodes", "<i4", 4)])
    faces["count"], faces["nodes"] = 4, quads
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment lengths in {field.unit}",
        f"element vertex {len(vertices)}",
        *(f"property {'int' if whole else 'double'} {name}" for name, whole in properties),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    text = "\n".join(header) + "\n"
    write_bytes(path, text.encode() + vertices.tobytes() + faces.tobytes())


def _save_vtp(field: "DisplacementField", path: str | PathLike[str]) -> None:
    columns, quads = mesh(field)
    position = columns.pop("position")
    comment = f"<!-- lengths in {field.unit} -->\n"
    write_bytes(path, polydata(position, quads, columns, comment=comment).encode())
