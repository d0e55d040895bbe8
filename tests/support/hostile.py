"""Files of every kind that is read, how each is read, and what may be wrong with one."""

import itertools
import re
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
from stereo_data import grid_of, toed_in_rig
from videos import write_deep_video, write_video

from cmp_cl import DetectorConfig, EdgeStep, Grid, SeriesWriter, StereoRig, media
from cmp_cl.series import read_series

BOARD = (np.indices((60, 80)) // 9).sum(axis=0).astype(np.uint8) % 2 * 150 + 40
RGBA = np.dstack([BOARD, BOARD, BOARD, BOARD])
NODES = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1) * 10 + 5


def write_series(path: Path) -> None:
    with SeriesWriter(path, rest=NODES, unit="px") as series:
        for number in range(3):
            series.append(index=number, time_ms=40.0 * number, displacement=0 * NODES + number)


def write_rig(path: Path) -> None:
    rig = toed_in_rig()
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name in ("K1", "D1", "K2", "D2", "R", "T"):
        storage.write(name, np.atleast_2d(getattr(rig, name)))
    storage.write("unit", "mm")
    storage.release()


def read_all(path: Path) -> None:
    media.video_info(path)
    for _ in itertools.islice(media.read_frames(path), 40):
        pass


def image_kind(image: Any, *how: int) -> tuple[Any, ...]:
    return lambda path: cv2.imwrite(str(path), image, how), read_all, ("detect", "FILE")


def video_kind(write: Any, *arguments: Any) -> tuple[Any, ...]:
    command_line = "run", "FILE", "--out", "press.npz"
    return lambda path: write(path, *arguments), read_all, command_line


PLOT = "plot", "FILE", "--out", "plot.png"
RIG = "run", "both.png", "--stereo", "FILE", "--out", "press.npz"
KINDS: dict[str, tuple[Any, ...]] = {  # how a file is written, read, and given to a command
    "a.toml": (
        DetectorConfig(refinement=EdgeStep(cell=17.5)).save,
        DetectorConfig.load,
        ("detect", "both.png", "--config", "FILE"),
    ),
    "rig.yaml": (toed_in_rig().save, StereoRig.load, RIG),
    "rig.xml": (write_rig, StereoRig.load, RIG),
    "rig.json": (write_rig, StereoRig.load, RIG),
    "rest.npz": (grid_of(NODES).save, Grid.load, None),
    **{f"a.{suffix}": image_kind(BOARD) for suffix in ("png", "jpg", "bmp", "pgm", "webp", "jp2")},
    "alpha.png": image_kind(RGBA),
    "alpha.webp": image_kind(RGBA),
    "alpha.tif": image_kind(RGBA),
    "a.ppm": image_kind(RGBA[..., :3]),
    "deep.png": image_kind(BOARD.astype(np.uint16) << 4),
    "stack.tif": (lambda path: cv2.imwritemulti(str(path), [BOARD] * 3), *image_kind(BOARD)[1:]),
    "packed.tif": image_kind(RGBA[..., :3], cv2.IMWRITE_TIFF_COMPRESSION, 32773),
    "a.avi": video_kind(write_video, [BOARD] * 4),
    "jpeg.avi": video_kind(write_video, [BOARD] * 4, "MJPG"),
    "a.mp4": video_kind(write_video, [BOARD] * 4, "mp4v"),
    "a.mkv": video_kind(write_deep_video, BOARD.astype(np.uint16)),
    "a.gif": image_kind(RGBA[..., :3]),
    "press.npz": (write_series, read_series, PLOT),
    "press.h5": (write_series, read_series, PLOT),
}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes with a piece changed, left out, repeated or put elsewhere."""
    start, end = sorted(int(n) for n in rng.integers(0, len(data) + 1, 2))
    end = min(end, start + int(rng.integers(1, 400)))
    place, size = int(rng.integers(len(data))), int(rng.choice([1, 2, 4, 8]))
    flipped = bytearray(data)
    for bit in rng.integers(0, 8 * len(data), int(rng.integers(1, 9))):
        flipped[bit // 8] ^= 1 << (bit % 8)
    numbers = list(re.finditer(rb"\d+(\.\d+)?(e[+-]?\d+)?", data[:20_000]))
    first, last = numbers[place % len(numbers)].span() if numbers else (start, end)
    others = [b"0", b"-1", b"1e308", b"nan", b"9" * 20, b"'a'", b"[" * 3000]
    return [
        bytes(flipped),
        data[:start],
        data[:start] + data[end:],
        data[:end] + data[start:end] * int(rng.integers(1, 2000)) + data[end:],
        data[:place] + data[start:end] + data[place:],
        data[:first] + others[int(rng.integers(7))] + data[last:],
        data[:start] + [b"\0", b"\xff", b"\x7f"][place % 3] * size + data[start + size :],
        data[:start] + rng.bytes(end - start) + data[end:],
    ][int(rng.integers(8))]


def with_another_array(path: Path, rng: np.random.Generator) -> None:
    """Rewrite a series or a grid with one array that does not fit the others."""
    arrays = dict(read_series(path) if path.name.startswith("press") else np.load(path))
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    old = arrays[name]
    arrays[name] = [
        old[..., None],
        old.ravel()[:1],
        np.zeros((0, *old.shape)),
        np.full(old.shape, [np.nan, np.inf, -1e308, 1e200][int(rng.integers(4))]),
        np.full(old.shape, "text"),
        np.zeros(old.shape, [bool, complex, np.uint64, np.float16][int(rng.integers(4))]),
        rng.normal(size=old.shape) * 10.0 ** rng.integers(-30, 30),
        np.array([]),
    ][int(rng.integers(8))]
    if path.suffix == ".npz":
        np.savez(path, **arrays)
        return
    with h5py.File(path, "w") as file:
        for key, array in arrays.items():
            file[key] = np.char.encode(array) if array.dtype.kind == "U" else array
