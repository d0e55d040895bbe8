"""Detection on a Dask cluster: one Detector per worker process, results in a folder.

    from dask.distributed import Client
    store = cmp_cl.cluster.detect(Client("tcp://scheduler:8786"), "press.avi.corners",
                                  count=1_000_000, read=read_frame, config=config)
    corners = store[123_456]

The recording is cut into parts of consecutive frames. A part is a file, part-00000012.npz, that
appears whole or not at all. If a worker dies, Dask gives its part to another worker, so that time
is lost but no frame; if both write the part, they write the same bytes. A second call with the same
folder computes the missing parts.
"""

import dataclasses
import hashlib
import json
import os
import struct
import threading
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import DetectorConfig, to_toml
from cmp_cl.corners import Corners
from cmp_cl.detector import Detector
from cmp_cl.errors import ConfigError
from cmp_cl.files import check_path, write_bytes, write_text
from cmp_cl.image import GreyImage, check_image

_ABOUT = "about.json"
_MOST_FRAMES = 1 << 40
_DAMAGE = (  # raised on reading a damaged zip or .npy
    *(OSError, ValueError, KeyError, EOFError, OverflowError, MemoryError),
    *(RuntimeError, struct.error, zipfile.BadZipFile, zlib.error),
)
_ARRAYS = ("xy", "pixel", "response", "method", "refusal", "sigma", "edges", "doubtful")


@dataclasses.dataclass(frozen=True)
class Store:
    """The corners of a recording, part by part in a folder.

    folder: the folder of the parts. count: number of frames of the recording. part: number of
        frames of a part.
    """

    folder: Path
    count: int
    part: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, frame: int) -> Corners:
        """Return the corners of one frame.

        Raises IndexError, FileNotFoundError if its part has not been written, ConfigError
        if that is damaged.
        """
        if not 0 <= frame < self.count:
            raise IndexError(f"frame {frame} of {self.count}")
        return self._read(frame // self.part)[frame % self.part]

    def __iter__(self) -> Iterator[Corners]:
        """Yield the corners of all frames in order; raises as indexing does."""
        for number in range(self.parts):
            yield from self._read(number)

    @property
    def parts(self) -> int:
        """The number of parts; the last part may be shorter."""
        return -(-self.count // self.part)

    def missing(self) -> list[int]:
        """Return the numbers of the parts that are missing or damaged; every byte is checked."""
        return [number for number in range(self.parts) if not self._is_whole(number)]

    def _is_whole(self, number: int) -> bool:
        """Return whether a part is present and the checksum of each of its arrays is right."""
        try:
            self._arrays(number)
        except _DAMAGE:
            return False
        return True

    def _read(self, number: int) -> list[Corners]:
        """Read the frames of a part."""
        path = self._path(number)
        try:
            arrays = self._arrays(number)
        except FileNotFoundError:
            raise
        except _DAMAGE as error:
            raise ConfigError(f"{str(path)!r} is damaged; detect again into its folder") from error
        return _split(arrays)

    def _arrays(self, number: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of a part; raises one of _DAMAGE unless they are those that were
        written.
        """
        with np.load(self._path(number), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        digest = str(arrays.pop("digest"))
        if arrays.keys() != {*_ARRAYS, "lengths", "device", "edge_radius"}:
            raise ValueError("it is of another version")
        frames = self._frames(number)
        if digest != _digest(arrays, frames.start) or len(arrays["lengths"]) != len(frames):
            raise ValueError("it is another part, or a damaged one")
        return arrays

    def _path(self, number: int) -> Path:
        return self.folder / f"part-{number:08d}.npz"

    def _frames(self, number: int) -> range:
        return range(number * self.part, min((number + 1) * self.part, self.count))


def open_store(folder: str | PathLike[str]) -> Store:
    """Open the store in a folder; raises ConfigError if there is none or its index is damaged."""
    check_path(folder, ConfigError)
    try:
        about = json.loads((Path(folder) / _ABOUT).read_text(encoding="utf-8"))
        count, part = about["count"], about["part"]
        if not (type(count) is type(part) is int and 0 <= count < _MOST_FRAMES and part >= 1):
            raise ValueError(f"{_ABOUT} says {count!r} frames in parts of {part!r}")
        return Store(Path(folder), count, part)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigError(f"there is no store of corners in {str(folder)!r}: {error}") from error


def detect(
    client: Any,
    folder: str | PathLike[str],
    *,
    count: int,
    read: Callable[[int], GreyImage],
    config: DetectorConfig | None = None,
    device: str | None = None,
    part: int = 256,
) -> Store:
    """Detect the corners of frames 0 .. count - 1 on a cluster, and return when all are stored.

    client: a dask.distributed.Client. Run one worker process per device, with one thread.
    folder: the folder of the parts, made if missing; workers must see it under this name.
    read: read(n) gives frame n, (H, W) uint8 or uint16, on a worker; it travels there by
        pickle, so it is a function of a module that workers can import, or a closure.
    config: None means DetectorConfig(). device: a text for `select_device` on the worker; None is
        the worker's default device. count: number of frames of the recording. part: number of
        frames of a file.

    Existing parts are kept, and damaged ones are computed again. Raises ConfigError if the folder
    holds parts of another count, length or configuration, and the errors of `read` and of the
    detector on a worker.
    """
    import distributed

    config = DetectorConfig() if config is None else config
    if count < 0 or part < 1:
        raise ConfigError(f"count must be 0 or more and part 1 or more, not {count} and {part}")
    store = Store(Path(os.path.abspath(folder)), count, part)
    _claim(store, config)
    futures = [
        client.submit(_work, store, number, read, config, device, pure=False)
        for number in store.missing()
    ]
    completed: Any = distributed.as_completed
    try:
        for future in completed(futures):
            future.result()
    finally:
        client.cancel(futures)
    return store


def _claim(store: Store, config: DetectorConfig) -> None:
    """Store the description of the recording in the folder, or check that it is the same."""
    digest = hashlib.sha256(to_toml(config).encode()).hexdigest()
    about = {"count": store.count, "part": store.part, "config": digest}
    store.folder.mkdir(parents=True, exist_ok=True)
    path = store.folder / _ABOUT
    if not path.exists():
        write_text(path, json.dumps(about) + "\n")
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{str(path)!r} is damaged: {error}") from error
    if before != about:
        raise ConfigError(
            f"{str(store.folder)!r} holds the corners of another recording or configuration "
            f"({before}, not {about}); name another folder"
        )


def _work(
    store: Store,
    number: int,
    read: Callable[[int], GreyImage],
    config: DetectorConfig,
    device: str | None,
) -> None:
    """Detect a part and write it; on a worker."""
    from distributed import get_worker

    first, *rest = store._frames(number)
    image = read(first)
    own: _Own = get_worker().__dict__.setdefault("cmp_cl", _Own())
    with own.lock:
        detector = own.detector_for(image, config, device)
        found = list(detector.stream(chain([image], map(read, rest))))
    lengths = np.array([len(corners) for corners in found], np.int64)
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(corners, name) for corners in found]) for name in _ARRAYS
    }
    arrays |= {"lengths": lengths, "device": np.array(found[0].device)}
    arrays["edge_radius"] = np.array(found[0].edge_radius)
    data = BytesIO()
    np.savez(data, digest=np.array(_digest(arrays, first)), **arrays)
    write_bytes(store._path(number), data.getvalue(), durable=True)


class _Own:
    """The detector that a worker process keeps; it is replaced for another kind of frame."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self._detector: Detector | None = None
        self._device: str | None = None

    def detector_for(
        self, image: GreyImage, config: DetectorConfig, device: str | None
    ) -> Detector:
        check_image(image)
        old = self._detector
        if old is not None:
            before = (old.shape, old.dtype, old.config, self._device)
            if before == (image.shape, image.dtype, config, device):
                return old
            old.close()
        self._device = device
        self._detector = Detector(
            shape=image.shape, dtype=image.dtype, config=config, device=device
        )
        return self._detector


def _digest(arrays: Mapping[str, NDArray[Any]], first: int) -> str:
    """Return the SHA-256 of the arrays with names, types and shapes, and of the first frame's
    number.
    """
    hashed = hashlib.sha256(f"{first}\n".encode())
    for name, array in sorted(arrays.items()):
        hashed.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        hashed.update(array.tobytes())
    return hashed.hexdigest()


def _split(arrays: Mapping[str, NDArray[Any]]) -> list[Corners]:
    """Return the frames of a part."""
    ends = np.cumsum(arrays["lengths"])[:-1]
    device, radius = str(arrays["device"]), float(arrays["edge_radius"])
    split = {name: np.split(arrays[name], ends) for name in _ARRAYS}
    return [
        Corners(
            **{name: split[name][n].copy() for name in _ARRAYS}, edge_radius=radius, device=device
        )
        for n in range(len(ends) + 1)
    ]
