"""Series as tables: a row for each node of each frame, or a line for each frame."""

import io
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.field.nodes import node_columns
from cmp_cl.files import csv_bytes, write_text
from cmp_cl.series.base import Arrays, Description, Format
from cmp_cl.series.disk import Appended


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
