"""Series as tables: a row for each node of each frame, or a line for each frame."""

import io
import json
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.files import csv_bytes, write_text
from cmp_cl.series.base import Arrays, Description, Format
from cmp_cl.series.disk import Appended

_AXES = "x", "y", "z"
_PARTS = {  # names of the parts of arrays that are not vectors
    **dict.fromkeys(("strain", "strain_sigma"), ("xx", "yy", "xy")),
    **dict.fromkeys(("principal", "principal_sigma"), ("1", "2")),
}


def node_columns(frame: Arrays, units: Mapping[str, str]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Return the columns of a frame's R x C nodes: name with unit, values (R C,).

    frame: arrays by name. units: their units by name. (R, C) is one column; (R, C, 2) and (R, C, 3)
    have the suffixes _x, _y, _z, strains _xx, _yy, _xy, others numbers. Numbers and vectors of the
    whole frame come last.

    Raises FieldError if no array is of nodes.
    """
    shapes = [value.shape[:2] for value in frame.values() if value.ndim in (2, 3)]
    if not shapes:
        raise FieldError("a table needs an array (R, C) or (R, C, K) of nodes")
    shape = shapes[0]
    rows, columns = np.indices(shape)
    yield "row", rows.ravel()
    yield "column", columns.ravel()
    ordered = sorted(frame.items(), key=lambda item: item[1].shape[:2] != shape)
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


class CsvFormat(Format):
    """CSV with the units in its header; the description is in NAME.csv-metadata.json.

    Floats have 9 digits; missing ones are nan. The metadata file has the name that W3C recommends;
    it has the constants too.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        super().__init__(part, description, constants)
        self._file = Appended(part)

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        columns = dict(node_columns(frame, self.description.units))
        columns = {"frame": np.array(index), "time_ms": np.array(time_ms), **columns}
        text = io.BytesIO()
        if not number:
            text.write(csv_bytes([columns]))
            self._write_metadata()
        kinds = ["%.9g" if column.dtype.kind == "f" else "%d" for column in columns.values()]
        table = np.stack(np.broadcast_arrays(*columns.values()), axis=1)
        np.savetxt(text, table, fmt=",".join(kinds))
        self._file.append(text.getvalue())

    def _write_metadata(self) -> None:
        about = self.description.with_units()
        about["constants"] = {name: plain(value) for name, value in self.constants.items()}
        write_text(_metadata_of(self.part), json.dumps(about, indent=1))

    def finish(self, target: Path, frames: int) -> None:
        if not frames:
            self._write_metadata()
        self.close()
        os.replace(_metadata_of(self.part), _metadata_of(target))
        super().finish(target, frames)

    def close(self) -> None:
        self._file.close()

    def discard(self) -> None:
        super().discard()
        _metadata_of(self.part).unlink(missing_ok=True)


def _metadata_of(table: Path) -> Path:
    return table.with_name(f"{table.name}-metadata.json")


class JsonLines(Format):
    """One line of JSON per frame on standard output, flushed after each.

    The first line has the description and the constants. A missing number is null.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        super().__init__(part, description, constants)
        self._line(description.with_units() | {"constants": _plain(constants)})

    def _line(self, members: Mapping[str, Any]) -> None:
        sys.stdout.buffer.write(json.dumps(members).encode() + b"\n")
        sys.stdout.buffer.flush()

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        time = plain(np.array(time_ms))
        self._line({"frame": index, "time_ms": time, **_plain(frame)})

    def finish(self, target: Path, frames: int) -> None:
        """Do nothing: each line is complete."""

    def discard(self) -> None:
        """Do nothing: there is no file."""


def _plain(arrays: Arrays) -> dict[str, Any]:
    return {name: plain(value) for name, value in arrays.items()}


def plain(value: NDArray[Any]) -> Any:
    """Return an array as nested lists for JSON, with None for NaN and infinity."""
    if value.dtype.kind == "S":
        value = np.char.decode(value, "utf-8")
    if value.dtype.kind != "f" or np.isfinite(value).all():
        return value.tolist()
    numbers = value.astype(object)
    numbers[~np.isfinite(value)] = None
    return numbers.tolist()
