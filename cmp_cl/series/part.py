"""A series while it is written: a folder with an .npy for each array, which grows."""

import io
import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]

LARGEST = np.float64(1e100)  # of a number; the square of a larger one has no float
_CONSTANTS = "constants"  # the folder for them
_OF_FRAMES = "index", "time_ms"  # what every series has of each frame


class Part:
    """Appends frames to the folder of a part, which is made.

    A frame is complete on the disk when `append` returns, and can be read from then on. A frame
    that a full disk refuses is not counted. Until it is closed, its index is locked.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], constants: Arrays) -> None:
        self.path = path
        self._columns: dict[str, _Column] = {}
        try:
            (path / _CONSTANTS).mkdir()
            for name, constant in {"about": np.array(json.dumps(about)), **constants}.items():
                np.save(path / _CONSTANTS / f"{name}.npy", constant, allow_pickle=False)
            for name, kind in zip(_OF_FRAMES, (np.int64, np.float64), strict=True):
                self._add(name, np.zeros((), kind))
            lock(self._columns["index"].file)
        except BaseException:
            self.discard()
            raise

    def _add(self, name: str, like: NDArray[Any]) -> None:
        self._columns[name] = _Column(self.path / f"{name}.npy", like)

    def append(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        """Write a frame, the one of that number in the series; raises OSError."""
        if not number:
            for name, value in frame.items():
                self._add(name, value)
        times = {"time_ms": np.asarray(time_ms), "index": np.asarray(index, np.int64)}
        for name, value in {**frame, **times}.items():  # index comes last: it counts whole frames
            self._columns[name].write(number, value)

    def close(self) -> None:
        """Close the files; the part stays."""
        for column in self._columns.values():
            column.file.close()

    def discard(self) -> None:
        """Remove the part."""
        self.close()
        shutil.rmtree(self.path, ignore_errors=True)


def is_written(path: Path) -> bool:
    """Return whether a process still writes a part."""
    with open(path / "index.npy", "rb") as file:
        return not lock(file)


def lock(file: IO[bytes]) -> bool:
    """Lock a file until it is closed; return False if it is locked already.

    Windows needs no locks: it does not remove a file that is open.
    """
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # the file system has no locks
        pass
    return True


class _Column:
    """The frames of one array so far. like: an array as in each frame."""

    def __init__(self, path: Path, like: NDArray[Any]) -> None:
        self.file = open(path, "w+b", buffering=0)  # noqa: SIM115, closed by Part
        self._shape, self._size = like.shape, like.nbytes
        self._dtype = np.lib.format.dtype_to_descr(like.dtype)
        self._write_at(0, self._header(0))

    def write(self, number: int, value: NDArray[Any]) -> None:
        """Write a frame at its offset, even over one that was interrupted."""
        header = self._header(number + 1)
        self._write_at(len(header) + number * self._size, value.tobytes())
        self._write_at(0, header)

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


class Stored(NamedTuple):
    """The whole frames of a part.

    about: the units, the version, the time of writing and the settings. arrays: (F, ...) of all
    frames by name, in the order of the names. They are not read before they are used.
    """

    about: Mapping[str, Any]
    constants: Arrays
    arrays: Arrays

    @classmethod
    def of(cls, path: Path) -> Self:
        """Open a part, which may grow; `index`, opened before the others, counts whole frames."""
        count = len(np.load(path / "index.npy", mmap_mode="r"))
        constants, arrays = _opened(path / _CONSTANTS), _opened(path)
        about = json.loads(str(constants["about"]))
        return cls(about, constants, {name: each[:count] for name, each in arrays.items()})

    def frames(self) -> Iterator[tuple[int, float, Arrays]]:
        """Yield the number, the time and the arrays of each frame."""
        others = {name: each for name, each in self.arrays.items() if name not in _OF_FRAMES}
        for place, (index, time) in enumerate(zip(*map(self.arrays.get, _OF_FRAMES), strict=True)):
            yield int(index), float(time), {name: each[place] for name, each in others.items()}


def _opened(folder: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays in a folder by name, not read before they are used."""
    return {file.stem: np.load(file, mmap_mode="r") for file in sorted(folder.glob("*.npy"))}
