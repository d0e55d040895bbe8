"""Series as tables: a row for each node of each frame, or a line for each frame."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.extras import extra
from cmp_cl.files import check_target, write_text
from cmp_cl.series.base import Constants, Description, FileName, Frame, Series
from cmp_cl.series.digits import nested, plain, rows_of
from cmp_cl.series.disk import Appended, Finishable

_ROWS = 1 << 17  # rows of a group in a Parquet file
_END = 1 << 16  # bytes reserved for the end of such a file, besides an eighth of a group
_AXES = "x", "y", "z"
_PARTS = {  # names of the parts of arrays that are not vectors
    **dict.fromkeys(("strain", "strain_sigma"), ("xx", "yy", "xy")),
    **dict.fromkeys(("principal", "principal_sigma"), ("1", "2")),
}


def node_columns(frame: Frame, units: Mapping[str, str]) -> Iterator[tuple[str, NDArray[Any], str]]:
    """Return name, values (N,) and unit ("" for none) of each column of a frame's R x C nodes.

    frame: arrays by name. units: their units by name. (R, C) is one column; (R, C, 2) and (R, C, 3)
    have the suffixes _x, _y, _z, strains _xx, _yy, _xy, others numbers. Numbers and vectors of the
    whole frame come last.

    Raises FieldError if no array is of nodes.
    """
    shapes = [value.shape[:2] for value in frame.values() if value.ndim in (2, 3)]
    if not shapes:
        raise FieldError("a table needs an array (R, C) or (R, C, K) of nodes")
    rows, columns = np.indices(shapes[0])
    yield "row", rows.ravel(), ""
    yield "column", columns.ravel(), ""
    for name, value in frame.items():
        if value.shape[:2] != shapes[0]:
            continue
        unit = units.get(name, "")
        if value.ndim == 2:
            yield name, value.ravel(), unit
            continue
        for part, end in enumerate(_ends(name, value.shape[2])):
            yield f"{name}_{end}", value[..., part].ravel(), unit
    for name, value in frame.items():
        unit = units.get(name, "")
        if value.ndim == 0:
            yield name, np.broadcast_to(value, rows.size), unit
        elif value.ndim == 1:
            for part, end in zip(value, _ends(name, value.size), strict=True):
                yield f"{name}_{end}", np.broadcast_to(part, rows.size), unit


def _ends(name: str, count: int) -> tuple[str, ...]:
    """Return the suffixes of the names of an array's parts."""
    ends = _PARTS.get(name, _AXES)
    return ends[:count] if count <= len(ends) else tuple(map(str, range(count)))


class CsvSeries(Series):
    """CSV with the units in its header; the description is in NAME.csv-metadata.json.

    Floats have 9 digits; missing ones are nan. The metadata file has the name that W3C recommends.
    Both appear when the series is closed.
    """

    def __init__(self, path: FileName, description: Description, constants: Constants) -> None:
        super().__init__(description, constants)
        self._target = check_target(path)
        self._file = Appended(path, self.files)

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        table = list(node_columns(frame, self.description.units))
        header = b""
        if not self._count:
            names = [f"{name}_{unit}" if unit else name for name, _, unit in table]
            header = (",".join(["frame", "time_ms", *names]) + "\n").encode()
        rows = rows_of(f"{index},{float(time_ms):.9g}", [values for _, values, _ in table])
        self._file.append(header + rows)

    def _finish(self) -> None:
        with self.files:
            self._file.check_whole()
        about = self.description.with_units()
        about["constants"] = {name: plain(value) for name, value in self.constants.items()}
        beside = self._target.with_name(f"{self._target.name}-metadata.json")
        try:
            write_text(beside, json.dumps(about, indent=1))
        except OSError:
            if self._file.error is None:  # otherwise append has reported the full disk
                raise


class JsonLines(Series):
    """One line of JSON per frame; the first line has the description and the constants.

    A missing number is null. `-` is standard output, flushed after each line.
    """

    def __init__(self, path: FileName, description: Description, constants: Constants) -> None:
        super().__init__(description, constants)
        self._file = None if os.fspath(path) == "-" else Appended(path, self.files)
        about = description.with_units()
        parts = {name: json.dumps(text).encode() for name, text in about.items()}
        self._line({**parts, "constants": _members(_nested(self.constants))})

    def _line(self, members: Mapping[str, bytes]) -> None:
        line = _members(members) + b"\n"
        if self._file is not None:
            self._file.append(line)
        else:
            sys.stdout.buffer.write(line)
            sys.stdout.buffer.flush()

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        time = repr(float(time_ms)) if np.isfinite(time_ms) else "null"
        self._line({"frame": b"%d" % index, "time_ms": time.encode(), **_nested(frame)})

    def _finish(self) -> None:
        with self.files:
            if self._file is not None:
                self._file.check_whole()


def _nested(arrays: Mapping[str, NDArray[Any]]) -> dict[str, bytes]:
    return {name: nested(value) for name, value in arrays.items()}


def _members(values: Mapping[str, bytes]) -> bytes:
    """Return an object of JSON from its values in JSON."""
    texts = (json.dumps(name).encode() + b": " + value for name, value in values.items())
    return b"{" + b", ".join(texts) + b"}"


class ParquetSeries(Series):
    """Parquet with a row for each node of each frame, for pandas, Polars, DuckDB and Arrow.

    The metadata of the schema holds the description, and the constants as JSON; the metadata of a
    field holds its `unit`. The file appears when the series is closed.

    Raises ConfigError without pyarrow.
    """

    def __init__(self, path: FileName, description: Description, constants: Constants) -> None:
        super().__init__(description, constants)
        with extra("parquet", "Parquet"):
            import pyarrow
            import pyarrow.parquet
        self._arrow: Any = pyarrow
        self._file = Finishable(path, self.files)
        self._writer: Any = None
        self._waiting: list[Any] = []
        self._rows = self._bytes = 0

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        self._file.check()
        table = list(node_columns(frame, self.description.units))
        count = len(table[0][1])
        full = [
            ("frame", np.full(count, index, np.int64), ""),
            ("time_ms", np.full(count, time_ms, np.float64), "ms"),
            *((n, v.astype(np.int32) if n in ("row", "column") else v, u) for n, v, u in table),
        ]
        arrow = self._arrow
        if self._writer is None:
            about = self.description.entries()
            about["constants"] = json.dumps(
                {name: plain(value) for name, value in self.constants.items()}
            )
            schema = arrow.schema(
                [
                    arrow.field(
                        name, arrow.from_numpy_dtype(v.dtype), metadata={"unit": u} if u else None
                    )
                    for name, v, u in full
                ],
                metadata=about,
            )
            repeated = [name for name, value, _ in full if value.dtype.kind != "f"]
            self._writer = arrow.parquet.ParquetWriter(
                self._file, schema, use_dictionary=["time_ms", *repeated]
            )
        self._waiting.append(
            arrow.record_batch([_arrow_array(v) for _, v, _ in full], schema=self._writer.schema)
        )
        self._rows += count
        self._bytes += sum(v.nbytes for _, v, _ in full)
        self._file.expect(self._bytes * 9 // 8 + _END)
        if self._rows >= _ROWS:
            self._flush()

    def _flush(self) -> None:
        if self._waiting:
            self._writer.write_table(self._arrow.Table.from_batches(self._waiting))
        self._waiting, self._rows, self._bytes = [], 0, 0

    def _finish(self) -> None:
        with self.files:
            self._file.check_whole()
            if self._writer is None:
                raise FieldError("no frame was measured: there is no table to write")
            self._flush()
            self._writer.close()


def _arrow_array(values: NDArray[Any]) -> Any:
    """Return an array (N,) of numbers as an Arrow array; `pyarrow.array` would import pandas."""
    import pyarrow

    flat = np.packbits(values, bitorder="little") if values.dtype.kind == "b" else values
    buffer = pyarrow.py_buffer(np.ascontiguousarray(flat))
    kind = pyarrow.from_numpy_dtype(values.dtype)
    return pyarrow.Array.from_buffers(kind, len(values), [None, buffer])
