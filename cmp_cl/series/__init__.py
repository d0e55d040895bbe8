"""Series in the formats that other programs read, chosen by suffix."""

from collections.abc import Callable, Mapping

from cmp_cl.errors import ConfigError, check_kind
from cmp_cl.files import suffix_of
from cmp_cl.series.base import Constants, Description, FileName, Series
from cmp_cl.series.hdf5 import Hdf5Series
from cmp_cl.series.mcap import McapSeries
from cmp_cl.series.npz import NpzSeries, SeriesWriter
from cmp_cl.series.paraview import ParaViewSeries
from cmp_cl.series.reading import read_series
from cmp_cl.series.tables import CsvSeries, JsonLines, ParquetSeries

__all__ = [
    "SERIES_SUFFIXES",
    "CsvSeries",
    "Description",
    "Hdf5Series",
    "JsonLines",
    "McapSeries",
    "NpzSeries",
    "ParaViewSeries",
    "ParquetSeries",
    "Series",
    "SeriesWriter",
    "open_series",
    "read_series",
]

_WRITERS: dict[str, Callable[[FileName, Description, Constants], Series]] = {
    ".npz": NpzSeries,
    ".h5": Hdf5Series,
    ".hdf5": Hdf5Series,
    ".parquet": ParquetSeries,
    ".csv": CsvSeries,
    ".jsonl": JsonLines,
    ".pvd": ParaViewSeries,
    ".mcap": McapSeries,
}
SERIES_SUFFIXES = tuple(_WRITERS)


def open_series(
    path: FileName, description: Description | None = None, constants: Constants | None = None
) -> Series:
    """Open a series to write, in the format of the suffix; `-` is JSON lines on standard output.

    path: the file, or `-`. description: stored with the arrays, or None. constants: arrays that
    hold for all frames, such as the positions at rest.

    Raises ConfigError on another suffix or if the format's package is missing, OSError
    if the folder is missing or not writable.
    """
    description = Description() if description is None else description
    constants = {} if constants is None else constants
    check_kind("description", description, Description, ConfigError)
    check_kind("constants", constants, Mapping, ConfigError)
    suffix = ".jsonl" if isinstance(path, str) and path == "-" else suffix_of(path, ConfigError)
    if suffix not in _WRITERS:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(_WRITERS)}")
    return _WRITERS[suffix](path, description, constants)
