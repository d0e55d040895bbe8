"""A series as HDF5, readable while it grows."""

import os
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.extras import extra
from cmp_cl.files import check_target, temporary_beside
from cmp_cl.series.base import Constants, Description, FileName, Frame, Series
from cmp_cl.series.disk import Reserve

_CHUNK = 1 << 16  # bytes of a chunk of several small frames
_RESERVE = 1 << 21  # bytes held in reserve besides two chunks of every dataset


class Hdf5Series(Series):
    """HDF5 with the datasets index (F,), time_ms (F,), every array (F, ...) and the constants.

    The attributes of the file are the version, the time and the settings; the attribute `unit` of a
    dataset is its unit. Every frame is flushed, so a killed program loses none. The file appears
    under its name with the first frame. From then on h5py.File(path, swmr=True) reads it, even if
    its writer was killed.

    HDF5 crashes if it cannot write the last parts of a file. So some disk space is reserved until
    the file is closed or the disk is full.

    Raises ConfigError without h5py, and OSError.
    """

    def __init__(self, path: FileName, description: Description, constants: Constants) -> None:
        super().__init__(description, constants)
        with extra("hdf5", "HDF5"):
            import h5py
        self._target = check_target(path)
        self._temporary = temporary_beside(self._target)
        self._file: Any = h5py.File(self._temporary, "w", libver="latest")
        self._datasets: dict[str, Any] = {}
        self._reserve = Reserve(self._target.parent)
        self._drop = False
        for name, value in description.entries().items():
            self._file.attrs[name] = value
        for name, array in self.constants.items():
            data = str(array) if array.dtype.kind in "US" else array
            self._set_unit(name, self._file.create_dataset(name, data=data))

    def _set_unit(self, name: str, dataset: Any) -> None:
        if name in self.description.units:
            dataset.attrs["unit"] = self.description.units[name]

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        full: Frame = {
            **frame,
            "time_ms": np.asarray(time_ms, np.float64),
            "index": np.asarray(index, np.int64),  # written last: it counts complete frames
        }
        try:
            if not self._count:
                self._begin(full)
            for name, value in full.items():
                _add_frame(self._datasets[name], self._count, value)
        except (RuntimeError, OSError) as error:
            self._reserve.free()
            self._drop = True
            raise self._failed(error) from error
        if not self._count:
            os.replace(self._temporary, self._target)

    def _failed(self, error: Exception) -> OSError:
        """Return HDF5's error as an OSError of the file."""
        if isinstance(error, OSError) and error.errno is not None:
            return OSError(error.errno, error.strerror, str(self._target))
        said = re.search(r"errno = (\d+)", str(error))
        if said is None:
            return OSError(f"{self._target}: {error}")
        return OSError(int(said[1]), os.strerror(int(said[1])), str(self._target))

    def _begin(self, frame: Frame) -> None:
        """Make the datasets; none can be added while others read the file."""
        size = _RESERVE + 2 * sum(max(value.nbytes, _CHUNK) for value in frame.values())
        self._reserve.grow(size)
        for name, value in frame.items():
            if name in self._datasets:
                continue
            frames = max(1, min(1024, _CHUNK // max(value.nbytes, 1)))
            dataset = self._file.create_dataset(
                name,
                shape=(0, *value.shape),
                maxshape=(None, *value.shape),
                chunks=(frames, *(max(side, 1) for side in value.shape)),
                dtype=value.dtype,
                fillvalue=np.nan if value.dtype.kind == "f" else None,
            )
            self._set_unit(name, dataset)
            self._datasets[name] = dataset
        self._datasets["time_ms"].attrs["unit"] = "ms"
        self._file.swmr_mode = True

    def _abandon(self) -> None:
        self._drop = True
        self._finish()

    def _finish(self) -> None:
        self._datasets.clear()
        self._reserve.free()
        try:
            self._file.close()
        except RuntimeError as error:
            raise self._failed(error) from error
        if self._drop:
            self._temporary.unlink(missing_ok=True)
        elif self._temporary.exists():  # no frame came
            os.replace(self._temporary, self._target)


def _add_frame(dataset: Any, number: int, value: NDArray[Any]) -> None:
    """Append a frame to a dataset and flush it, as resize, an assignment and flush would.

    h5py's functions for this take three times as long as HDF5's own.
    """
    import h5py

    found = dataset.id
    found.set_extent((number + 1, *value.shape))
    space = found.get_space()
    space.select_hyperslab((number, *(0,) * value.ndim), (1, *value.shape))
    within = h5py.h5s.create_simple((1, *value.shape))
    found.write(within, space, np.ascontiguousarray(value))
    found.flush()
