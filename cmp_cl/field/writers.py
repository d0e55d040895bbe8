"""Writes the arrays of a field as .npz, .csv or .vtp."""

from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError
from cmp_cl.field.nodes import node_columns, surface
from cmp_cl.files import suffix_of, whole_file, write_bytes, write_csv

Arrays = dict[str, NDArray[Any]]

_LENGTHS = "position", "displacement", "sigma", "position_sigma"


def save(path: str | PathLike[str], arrays: Arrays, unit: str) -> None:
    """Write the arrays of a field by suffix, see `DisplacementField.save`.

    arrays: those of `DisplacementField`, (R, C, ...), by name; those of the raw field begin with
    raw_. unit: of the lengths.

    .npz: the arrays under their names, for numpy.load.
    .csv: a row per node, the unit in the header, nan where missing.
    .vtp: the valid nodes and the quadrilaterals between them, for ParaView.

    Raises ConfigError on another suffix, OSError if the file cannot be written.
    """
    suffix = suffix_of(path, ConfigError)
    if suffix == ".npz":
        with whole_file(path) as file:
            np.savez(file, **arrays, unit=np.array(unit))  # type: ignore[arg-type]
    elif suffix == ".csv":
        units = dict.fromkeys((begin + name for begin in ("", "raw_") for name in _LENGTHS), unit)
        columns = dict(node_columns(arrays, units))
        write_csv(path, columns, zip(*(each.tolist() for each in columns.values()), strict=True))
    elif suffix == ".vtp":
        comment = f"<!-- lengths in {unit} -->\n"
        rest, shift = arrays["position"], arrays["displacement"]
        write_bytes(path, surface(rest, shift, arrays, comment=comment))
    else:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of .npz, .csv, .vtp")
