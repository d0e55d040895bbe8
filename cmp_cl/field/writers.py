"""Writes the arrays of a field as .npz, .csv, .ply or .vtp."""

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError
from cmp_cl.files import suffix_of, whole_file, write_bytes, write_csv
from cmp_cl.grid.grid import NodeStatus
from cmp_cl.space.points import PointStatus
from cmp_cl.vtk import polydata, quadrilaterals

Arrays = dict[str, NDArray[Any]]

_NAMES = {"status": PointStatus, "source": NodeStatus}  # of the numbers in these arrays
_COLUMNS = {
    "position": ("x", "y", "z"),
    "displacement": ("ux", "uy", "uz"),
    "sigma": ("sigma",),
    "status": ("status",),
    "source": ("source",),
    "strain": ("e11", "e22", "e12"),
    "strain_sigma": ("e11_sigma", "e22_sigma", "e12_sigma"),
    "position_sigma": ("position_sigma",),
}


def save(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    """Write the arrays of a field by suffix, see `DisplacementField.save`.

    arrays: those of `DisplacementField`, (R, C, ...), by name; those of the raw field begin with
    raw_. unit: of the lengths.

    .npz: the arrays under their names, for numpy.load.
    .csv: a row per node, the unit in the header, nan where missing.
    .ply: the valid nodes and the quadrilaterals between them, little-endian.
    .vtp: the same for VTK and ParaView; "Warp By Vector" shows the surface as it is now.

    Raises ConfigError on another suffix, OSError if the file cannot be written.
    """
    writers = {".npz": _save_npz, ".csv": _save_csv, ".ply": _save_ply, ".vtp": _save_vtp}
    suffix = suffix_of(path, ConfigError)
    if suffix not in writers:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(writers)}")
    writers[suffix](path, arrays, unit)


def _save_npz(path: str | PathLike[str], arrays: dict[str, Any], unit: str) -> None:
    with whole_file(path) as file:
        np.savez(file, **arrays, unit=np.array(unit), filtered=np.array("raw_position" in arrays))


def _columns(name: str) -> list[str]:
    """Return the columns of an array."""
    begin = "raw_" if name.startswith("raw_") else ""
    return [begin + column for column in _COLUMNS.get(name.removeprefix("raw_"), (name,))]


def _save_csv(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    shape = arrays["status"].shape
    header = ["row", "column"]
    columns: list[list[Any]] = [index.ravel().tolist() for index in np.indices(shape)]
    for name in sorted(arrays, key=[*_COLUMNS, *arrays].index):
        values = arrays[name].reshape(len(columns[0]), -1).T.tolist()
        if name in _NAMES:
            values = [[_NAMES[name](number).name for number in values[0]]]
        plain = name in _NAMES or "strain" in name
        header += [column if plain else f"{column}_{unit}" for column in _columns(name)]
        columns += values
    write_csv(path, header, zip(*columns, strict=True))


def mesh_of(arrays: Arrays) -> tuple[Arrays, NDArray[np.int32]]:
    """Return columns of the valid nodes, and the quadrilaterals between them, (Q, 4) indices."""
    valid = arrays["status"] == PointStatus.VALID
    row, column = np.nonzero(valid)
    columns = {name: values[valid] for name, values in arrays.items() if name not in _NAMES}
    whole = {"row": row, "column": column, "source": arrays["source"][valid]}
    columns |= {name: values.astype(np.int32) for name, values in whole.items()}
    return columns, quadrilaterals(valid)


def _save_ply(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    columns, quads = mesh_of(arrays)
    properties = [
        (name, values.dtype.kind == "i")
        for key, values in columns.items()
        for name in _columns(key)
    ]
    vertices = np.empty(
        len(columns["row"]), [(name, "<i4" if whole else "<f8") for name, whole in properties]
    )
    for key, values in columns.items():
        for name, column in zip(_columns(key), np.atleast_2d(values.T), strict=True):
            vertices[name] = column
    faces = np.empty(len(quads), [("count", "u1"), ("nodes", "<i4", 4)])
    faces["count"], faces["nodes"] = 4, quads
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment lengths in {unit}",
        f"element vertex {len(vertices)}",
        *(f"property {'int' if whole else 'double'} {name}" for name, whole in properties),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    text = "\n".join(header) + "\n"
    write_bytes(path, text.encode() + vertices.tobytes() + faces.tobytes())


def _save_vtp(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    columns, quads = mesh_of(arrays)
    position = columns.pop("position")
    comment = f"<!-- lengths in {unit} -->\n"
    write_bytes(path, polydata(position, quads, columns, comment=comment).encode())
