"""A series as one .npz, for numpy.load."""

import io
import json
import shutil
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.files import whole_file
from cmp_cl.series.base import Arrays, Description, Format

CONSTANTS = "constants"  # the folder for them in a part


class NpzFormat(Format):
    """An .npz with a stack of every array, the constants, and the description as JSON in `about`.

    The part is a folder with an .npy for each array, which has its header and the frames so far.
    The constants are in its folder `constants`. So the disk must hold two copies at the end.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        about = np.array(json.dumps(description.with_units()))
        super().__init__(part, description, {"about": about, **constants})
        self._columns: dict[str, _Column] = {}
        part.unlink()
        try:
            (part / CONSTANTS).mkdir(parents=True)
            for name, constant in self.constants.items():
                np.save(part / CONSTANTS / f"{name}.npy", constant, allow_pickle=False)
            self._add_times()
        except BaseException:
            self.close()
            self.discard()
            raise

    def _add_times(self) -> None:
        for name, kind in (("time_ms", np.float64), ("index", np.int64)):
            self._columns[name] = _Column(self.part / f"{name}.npy", np.zeros((), kind))

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        if not number:
            for name, value in frame.items():
                self._columns[name] = _Column(self.part / f"{name}.npy", value)
        times = {"time_ms": np.asarray(time_ms), "index": np.asarray(index, np.int64)}
        for name, value in {**frame, **times}.items():  # index comes last: it counts whole frames
            self._columns[name].write(number, value)

    def finish(self, target: Path, frames: int) -> None:
        with whole_file(target, durable=True) as file, zipfile.ZipFile(file, "w") as archive:
            for name, value in self.constants.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, value, allow_pickle=False)
            for name, column in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.copy(frames, member)
        self.close()
        self.discard()

    def close(self) -> None:
        for column in self._columns.values():
            column.file.close()

    def discard(self) -> None:
        shutil.rmtree(self.part, ignore_errors=True)


class _Column:
    """The frames of one array so far: an .npy file that grows. like: an array as in each frame."""

    def __init__(self, path: Path, like: NDArray[Any]) -> None:
        self.file = open(path, "w+b", buffering=0)  # noqa: SIM115, closed by NpzFormat
        self._shape, self._size = like.shape, like.nbytes
        self._dtype = np.lib.format.dtype_to_descr(like.dtype)
        self._write_at(0, self._header(0))

    def write(self, number: int, value: NDArray[Any]) -> None:
        """Write a frame at its offset, even over one that was interrupted."""
        header = self._header(number + 1)
        self._write_at(len(header) + number * self._size, value.tobytes())
        self._write_at(0, header)

    def copy(self, frames: int, target: IO[bytes]) -> None:
        """Write the first frames as one .npy."""
        header = self._header(frames)
        self._write_at(0, header)
        self.file.truncate(len(header) + frames * self._size)
        self.file.seek(0)
        shutil.copyfileobj(self.file, target, 1 << 20)

    def _header(self, frames: int) -> bytes:
        """Return the header of an .npy of that many frames; its length is the same for any."""
        header = io.BytesIO()
        about = {"descr": self._dtype, "fortran_order": False, "shape": (frames, *self._shape)}
        np.lib.format.write_array_header_2_0(header, about)
        return header.getvalue()

    def _write_at(self, offset: int, data: bytes) -> None:
        self.file.seek(offset)
        rest = memoryview(data)
        while rest:  # a nearly full disk may take only some of it
            rest = rest[self.file.write(rest) :]
