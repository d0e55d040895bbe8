"""Writes the arrays of a field as .npz, .csv or .vtp."""

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError
from cmp_cl.files import suffix_of, whole_file, write_bytes, write_csv
from cmp_cl.grid.grid import NodeStatus
from cmp_cl.points import PointStatus
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
    "principal": ("e1", "e2"),
    "principal_sigma": ("e1_sigma", "e2_sigma"),
    "direction": ("direction",),
    "direction_sigma": ("direction_sigma",),
    "position_sigma": ("position_sigma",),
}
_LENGTHS = "position", "displacement", "sigma", "position_sigma"


def save(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    """Write the arrays of a field by suffix, see `DisplacementField.save`.

    arrays: those of `DisplacementField`, (R, C, ...), by name; those of the raw field begin with
    raw_. unit: of the lengths.

    .npz: the arrays under their names, for numpy.load.
    .csv: a row per node, the unit in the header, nan where missing.
    .vtp: the valid nodes and the quadrilaterals between them, for ParaView; "Warp By Vector"
        shows the surface as it is now. A plane lies at z = 0.

    Raises ConfigError on another suffix, OSError if the file cannot be written.
    """
    writers = {".npz": _save_npz, ".csv": _save_csv, ".vtp": _save_vtp}
    suffix = suffix_of(path, ConfigError)
    if suffix not in writers:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(writers)}")
    writers[suffix](path, arrays, unit)


def _save_npz(path: str | PathLike[str], arrays: dict[str, Any], unit: str) -> None:
    with whole_file(path) as file:
        np.savez(file, **arrays, unit=np.array(unit), filtered=np.array("raw_position" in arrays))


def _columns(name: str, count: int) -> list[str]:
    """Return the names of the `count` columns of an array."""
    begin = "raw_" if name.startswith("raw_") else ""
    return [begin + column for column in _COLUMNS[name.removeprefix("raw_")][:count]]


def _save_csv(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    shape = arrays["status"].shape
    header = ["row", "column"]
    columns: list[list[Any]] = [index.ravel().tolist() for index in np.indices(shape)]
    for name in sorted(arrays, key=[*_COLUMNS, *arrays].index):
        values = arrays[name].reshape(len(columns[0]), -1).T.tolist()
        named = _columns(name, len(values))
        if name in _NAMES:
            values = [[_NAMES[name](number).name for number in values[0]]]
        is_length = name.removeprefix("raw_") in _LENGTHS
        header += [f"{column}_{unit}" if is_length else column for column in named]
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


def _save_vtp(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    columns, quads = mesh_of(arrays)
    in_space = {name: _in_space(name, values) for name, values in columns.items()}
    position = in_space.pop("position")
    comment = f"<!-- lengths in {unit} -->\n"
    write_bytes(path, polydata(position, quads, in_space, comment=comment).encode())


def _in_space(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return the values; vectors (N, 2) of a plane get a third coordinate, 0."""
    vectors = name.removeprefix("raw_") in ("position", "displacement")
    return np.pad(values, ((0, 0), (0, 1))) if vectors and values.shape[1] == 2 else values
