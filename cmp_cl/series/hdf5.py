"""A series as HDF5, readable while it grows."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import extra
from cmp_cl.series.base import Arrays, Description, Format
from cmp_cl.series.disk import check_room

_ROOM = 1 << 18  # bytes that HDF5 may need to complete a file, measured: under 2^16


class Hdf5Format(Format):
    """HDF5 with the datasets index (F,), time_ms (F,), every array (F, ...) and the constants.

    The attributes of the file are the version, the time and the settings; the attribute `unit` of a
    dataset is its unit. All values have checksums. Every frame is a chunk of its own and is
    flushed. h5py.File(NAME.part, swmr=True) reads the part, even if its writer was killed.

    HDF5 crashes if it cannot complete a file. So a frame is refused while there is still room for
    that.

    Raises ConfigError without h5py.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        super().__init__(part, description, constants)
        with extra("hdf5", "HDF5"):
            import h5py
        check_room(part.parent, _ROOM)
        self._file: Any = h5py.File(part, "w", libver="latest")
        self._datasets: dict[str, Any] = {}
        self._frame_space: dict[str, Any] = {}  # the shape of a frame's part of each
        for name, value in description.entries().items():
            self._file.attrs[name] = value
        compact = h5py.h5p.create(h5py.h5p.DATASET_CREATE)  # in the header, which has a checksum
        compact.set_layout(h5py.h5d.COMPACT)
        for name, array in constants.items():
            data = np.asarray(np.char.encode(array, "utf-8")) if array.dtype.kind == "U" else array
            how = {"fletcher32": True} if array.ndim and array.size else {"dcpl": compact}
            self._set_unit(name, self._file.create_dataset(name, data=data, **how))

    def _set_unit(self, name: str, dataset: Any) -> None:
        if name in self.description.units:
            dataset.attrs["unit"] = self.description.units[name]

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        times = {"time_ms": np.asarray(time_ms), "index": np.asarray(index, np.int64)}
        full = {**frame, **times}  # index comes last: it counts whole frames
        check_room(self.part.parent, _ROOM + 2 * sum(value.nbytes for value in full.values()))
        try:
            if not number:
                self._begin(full)
            for name, value in full.items():
                self._append(name, number, np.asarray(value, order="C"))
        except (RuntimeError, OSError) as error:
            raise _as_os_error(error) from error

    def _append(self, name: str, number: int, value: NDArray[Any]) -> None:
        """Write a frame's part of a dataset, by the calls of HDF5; h5py's own take twice the
        time."""
        dataset = self._datasets[name].id
        dataset.set_extent((number + 1, *value.shape))
        if value.size:
            place = dataset.get_space()
            place.select_hyperslab((number, *[0] * value.ndim), (1, *value.shape))
            dataset.write(self._frame_space[name], place, value)
        dataset.flush()

    def _begin(self, frame: Arrays) -> None:
        """Make the datasets; none can be added while others read the file."""
        import h5py

        for name, value in frame.items():
            if name not in self._datasets:
                self._datasets[name] = self._file.create_dataset(
                    name,
                    shape=(0, *value.shape),
                    maxshape=(None, *value.shape),
                    chunks=(1, *(max(side, 1) for side in value.shape)),
                    dtype=value.dtype,
                    fletcher32=True,
                )
                self._frame_space[name] = h5py.h5s.create_simple((1, *value.shape))
                self._set_unit(name, self._datasets[name])
        self._datasets["time_ms"].attrs["unit"] = "ms"
        self._file.swmr_mode = True

    def finish(self, target: Path, frames: int) -> None:
        self.close()
        super().finish(target, frames)

    def close(self) -> None:
        self._datasets.clear()
        try:
            self._file.close()
        except RuntimeError as error:
            raise _as_os_error(error) from error


def _as_os_error(error: Exception) -> OSError:
    """Return HDF5's error as an OSError."""
    said = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
    return OSError(int(said[1]), said[2]) if said else OSError(str(error))
