"""A series as one .npz, for numpy.load."""

import io
import json
import math
import shutil
import zipfile
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.files import check_target, whole_file
from cmp_cl.series.base import Constants, Description, FileName, Frame, Series
from cmp_cl.series.disk import write_all


class NpzSeries(Series):
    """An .npz with a stack of every array, the constants, and the description as JSON in `about`.

    Its use of memory does not grow: see `SeriesWriter`. A description of None leaves out `about`.
    """

    def __init__(
        self, path: FileName, description: Description | None, constants: Constants
    ) -> None:
        if description is not None:
            constants = {"about": np.array(json.dumps(description.with_units())), **constants}
        super().__init__(description or Description(), constants)
        self._path = check_target(path)
        self._folder = _made_folder(self._path)
        self._columns: dict[str, _Column] = {}
        try:
            for name, constant in self.constants.items():
                np.save(self._folder / f"{name}.npy", constant, allow_pickle=False)
            self._add_column("index", (), np.dtype(np.int64))
            self._add_column("time_ms", (), np.dtype(np.float64))
        except BaseException:
            self._remove()
            raise

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        if not self._count:
            for name, value in frame.items():
                self._add_column(name, value.shape, value.dtype)
        times = {"index": np.asarray(index, np.int64), "time_ms": np.asarray(time_ms, np.float64)}
        try:
            for name, value in (frame | times).items():
                self._columns[name].write(self._count, value)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from error

    def _add_column(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        # Without a buffer, which would keep the bytes that a full disk refused. "w+b" starts anew
        # if the first frame was interrupted.
        file = open(self._folder / f"{name}.npy", "w+b", buffering=0)  # noqa: SIM115, closed by files
        self._columns[name] = _Column(self.files.enter_context(file), shape, dtype)

    def _abandon(self) -> None:
        self._remove()

    def _finish(self) -> None:
        try:
            with self.files:
                self._pack()
        except OSError as error:
            what = "1 frame" if self._count == 1 else f"{self._count} frames"
            raise OSError(
                error.errno,
                f"{error.strerror}; what was added, {what}, is in the folder "
                f"{str(self._folder)!r}, an .npy file for each array",
                str(self._path),
            ) from error
        self._remove()

    def _pack(self) -> None:
        with whole_file(self._path, durable=True) as file, zipfile.ZipFile(file, "w") as archive:
            for name, value in self.constants.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, value, allow_pickle=False)
            for name, column in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.copy(self._count, member)

    def _remove(self) -> None:
        self.files.close()
        shutil.rmtree(self._folder, ignore_errors=True)


class SeriesWriter(NpzSeries):
    """Writes a series, frame by frame, to one .npz; memory does not grow with it.

    The file holds `index` (F,) int64, `time_ms` (F,) float64, every array that `append` gets
    stacked along a first axis of F frames, and the constants (positions at rest, unit) as they are;
    numpy.load reads it. It appears when the `with` block ends, even by an exception or Ctrl-C: then
    with the frames so far, if there are any. Until then the frames are in the folder NAME.parts
    beside it, one .npy for each array, so the disk must hold two copies. If it cannot, or if the
    process is killed, that folder stays; the OSError names it.

        with SeriesWriter("press.npz", rest=rest.xyz, unit="mm") as series:
            series.append(index=i, time_ms=t, displacement=field.displacement)

    path: the file, with the suffix .npz. Raises OSError if the folder is missing or not writable.
    """

    def __init__(self, path: str | PathLike[str], **constants: ArrayLike) -> None:
        super().__init__(path, None, constants)


def _made_folder(path: Path) -> Path:
    """Make a folder for the arrays of a series: NAME.parts, with a number if that exists."""
    folder = path.with_name(f"{path.name}.parts")
    number = 1
    while True:
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            number += 1
            folder = path.with_name(f"{path.name}.parts-{number}")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


class _Column:
    """The frames of one array so far: an .npy file that grows."""

    def __init__(self, file: io.FileIO, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file = file
        self.shape = shape
        self.dtype = dtype
        self._write_at(0, self._header(0))

    def write(self, frame: int, value: NDArray[np.generic]) -> None:
        """Write a frame at its offset, even over one that was interrupted."""
        header = self._header(frame + 1)
        self._write_at(len(header) + frame * value.nbytes, value.tobytes())
        self._write_at(0, header)

    def copy(self, frames: int, target: IO[bytes]) -> None:
        """Write the first frames as one .npy."""
        header = self._header(frames)
        self._write_at(0, header)
        self.file.truncate(len(header) + frames * self.dtype.itemsize * math.prod(self.shape))
        self.file.seek(0)
        shutil.copyfileobj(self.file, target, 1 << 20)

    def _header(self, frames: int) -> bytes:
        """Return the header of an .npy of that many frames; its length is the same for any
        number."""
        header = io.BytesIO()
        np.lib.format.write_array_header_2_0(
            header,
            {
                "descr": np.lib.format.dtype_to_descr(self.dtype),
                "fortran_order": False,
                "shape": (frames, *self.shape),
            },
        )
        return header.getvalue()

    def _write_at(self, offset: int, data: bytes) -> None:
        self.file.seek(offset)
        write_all(self.file, data)
