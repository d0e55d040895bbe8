"""Reads damaged files of every kind: settings, rigs, grids, images, videos, series, MCAP files.

    python tests/fuzz_files.py --cases 5000 --seed 1 [--megabytes 3000] [--seconds 600]

Each case changes an intact file: its bytes or numbers, or pieces are left out, repeated or inserted
elsewhere. A child process reads the file within 20 s and 1 GB. The outcome must be a result or an
error of cmp_cl. Case K of a seed is always the same: a failure prints its number, and
the status is 1.
"""

import argparse
import contextlib
import importlib
import importlib.util
import itertools
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from cmp_cl import (
    CmpClError,
    DetectorConfig,
    EdgeStep,
    Grid,
    Midlines,
    RingHarmonic,
    StereoRig,
    media,
)
from cmp_cl.series import Description, SeriesWriter, read_series
from cmp_cl.series.mcap import mcap_images
from cmp_cl.synthetic import default_rig
from cmp_cl.viz import Quantity, map_figure, sheet_figure
from cmp_cl.viz.moments import NEEDED, Recorded

LIMIT_S = 20
LIMIT_KB = 1 << 20  # resident memory of a child
TOO_LARGE = 3  # exit status of a child that has had more
MOST_PIXELS = 1 << 20
FRAMES = 40  # most that are read of a file
IMAGE_DEFINITION = """\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
Rng = np.random.Generator


def settings(folder: Path) -> Iterator[Path]:
    """Write settings that together have every table."""
    for number, config in enumerate(
        (
            DetectorConfig(refinement=EdgeStep(cell=17.5)),
            DetectorConfig(detection=RingHarmonic(octaves=0), refinement=Midlines(), scale=0.5),
        )
    ):
        config.save(folder / f"{number}.toml")
        yield folder / f"{number}.toml"


def rigs(folder: Path) -> Iterator[Path]:
    """Write a rig as OpenCV does in its three formats."""
    rig = StereoRig(*default_rig((300, 300)))
    rig.save(folder / "rig.yaml")
    yield folder / "rig.yaml"
    for suffix in ("json", "xml"):
        path = folder / f"rig.{suffix}"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        for name in ("K1", "D1", "K2", "D2", "R", "T"):
            storage.write(name, np.asarray(getattr(rig, name)))
        storage.release()
        yield path


def grids(folder: Path) -> Iterator[Path]:
    """Write a grid."""
    xy = 9 * np.stack(np.indices((6, 8)), axis=2).astype(np.float32)
    index = np.argwhere(xy[..., 0] >= 0).astype(np.int32)
    status, sigma = np.ones((6, 8), np.uint8), np.full((6, 8), 0.1, np.float32)
    Grid(xy=xy, status=status, sigma=sigma, index=index).save(folder / "rest.npz")
    yield folder / "rest.npz"


def checkerboard() -> np.ndarray:
    y, x = np.indices((60, 80))
    return ((y // 9 + x // 9) % 2 * 150 + 40).astype(np.uint8)


def images(folder: Path) -> Iterator[Path]:
    """Write an image in every format, and a stack."""
    for suffix in ("png", "jpg", "bmp", "pgm", "tif", "webp", "jp2", "gif"):
        image = np.dstack([checkerboard()] * 3) if suffix == "gif" else checkerboard()
        media.write_image(folder / f"a.{suffix}", image)
        yield folder / f"a.{suffix}"
    cv2.imwritemulti(
        str(folder / "stack.tif"), [checkerboard(), checkerboard().T.copy(), checkerboard()]
    )
    yield folder / "stack.tif"


def videos(folder: Path) -> Iterator[Path]:
    """Write videos in the containers and codecs that OpenCV brings."""
    for name, codec in (("a.avi", "FFV1"), ("b.avi", "MJPG"), ("c.mp4", "mp4v"), ("d.mkv", "FFV1")):
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter_fourcc(*codec), 25, (80, 60))
        for _ in range(4):
            writer.write(np.dstack([checkerboard()] * 3))
        writer.release()
        yield folder / name


def series(folder: Path) -> Iterator[Path]:
    """Write series of one view and of two views, as `cmp-cl run` does."""
    rows, columns = np.indices((4, 5)) * 10.0
    rest = np.stack([columns, rows, np.full((4, 5), 80.0)], axis=2)
    for suffix, size in itertools.product(("npz", "h5"), (2, 3)):
        path = folder / f"{size}.{suffix}"
        constants = {"rest": rest[..., :size], "unit": np.array("mm")}
        with SeriesWriter(path, description=Description(units={"xy": "px"}), **constants) as series:
            for number in range(3):
                moved = {"xy": rest[..., :2] + number} if size == 2 else {"displacement": rest / 99}
                sigma = np.full((4, 5), 0.1)
                series.append(index=number, time_ms=40.0 * number, sigma=sigma, **moved)
        yield path


def bags(folder: Path) -> Iterator[Path]:
    """Write images of 8 and of 16 bits in an MCAP file."""
    writing = importlib.import_module("mcap_ros2.writer")
    path = folder / "a.mcap"
    with open(path, "wb") as file:
        writer = writing.Writer(file)
        image = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE_DEFINITION)
        for number, (encoding, pixels) in enumerate(
            (("mono8", checkerboard()), ("mono16", checkerboard().astype(np.uint16) << 4))
        ):
            message = {
                "header": {"stamp": {"sec": number, "nanosec": 5}, "frame_id": "camera"},
                "height": pixels.shape[0],
                "width": pixels.shape[1],
                "encoding": encoding,
                "is_bigendian": 0,
                "step": pixels.strides[0],
                "data": pixels.tobytes(),
            }
            writer.write_message("/image", image, message, log_time=number)
        writer.finish()
    yield path


def read_image(path: Path) -> None:
    for page in itertools.islice(media.read_pages(path), FRAMES):
        assert page.size <= MOST_PIXELS


def read_video(path: Path) -> None:
    media.count_frames(path)
    media.frame_rate(path)
    for frame in itertools.islice(media.read_frames(path), FRAMES):
        assert frame.image is None or frame.image.size <= MOST_PIXELS


def read_one_series(path: Path) -> None:
    """Read the arrays of a series, and draw every plot of them."""
    recorded = Recorded.of(read_series(path, NEEDED))
    summary = recorded.summary()
    for quantity in Quantity:
        with contextlib.suppress(CmpClError):
            map_figure(summary.moment, quantity)
    sheet_figure(summary.moment, summary)


def read_bag(path: Path) -> None:
    for _, image in itertools.islice(mcap_images(path), FRAMES):
        assert image is None or image.size <= MOST_PIXELS


KINDS: dict[str, tuple[Callable[[Path], Iterator[Path]], Callable[[Path], Any]]] = {
    "settings": (settings, DetectorConfig.load),
    "rigs": (rigs, StereoRig.load),
    "grids": (grids, Grid.load),
    "images": (images, read_image),
    "videos": (videos, read_video),
    "series": (series, read_one_series),
    "bags": (bags, read_bag),
}
for needed, kind in (("h5py", "series"), ("mcap_ros2", "bags")):
    if importlib.util.find_spec(needed) is None:
        del KINDS[kind]


def damaged(data: bytes, rng: Rng) -> bytes:
    """Return the bytes with one to four changes."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        data = _changed(data, rng)
    return data


def _changed(data: bytes, rng: Rng) -> bytes:
    if not data:
        return data
    start, end = sorted(int(n) for n in rng.integers(0, len(data) + 1, 2))
    end = min(end, start + int(rng.integers(1, 400)))
    kind = int(rng.integers(8))
    if kind == 0:  # bits
        changed = bytearray(data)
        for place in rng.integers(0, len(data), int(rng.integers(1, 9))):
            changed[place] ^= 1 << int(rng.integers(8))
        return bytes(changed)
    if kind == 1:  # cut off
        return data[:start]
    if kind == 2:  # left out
        return data[:start] + data[end:]
    if kind == 3:  # repeated
        return data[:end] + data[start:end] * int(rng.integers(1, 2000)) + data[end:]
    if kind == 4:  # inserted elsewhere
        place = int(rng.integers(len(data)))
        return data[:place] + data[start:end] + data[place:]
    if kind == 5:  # another number, in text
        numbers = list(re.finditer(rb"\d+(\.\d+)?(e[+-]?\d+)?", data[:20_000]))
        if numbers:
            match = numbers[int(rng.integers(len(numbers)))]
            others = [b"0", b"-1", b"1e999", b"nan", b"99999999999999999999", b"'a'", b"[" * 3000]
            return data[: match.start()] + others[int(rng.integers(7))] + data[match.end() :]
    if kind == 6:  # another number, in bytes
        size = int(rng.choice([1, 2, 4, 8]))
        value = [b"\0", b"\xff", b"\x7f", b"\x80"][int(rng.integers(4))] * size
        return data[:start] + value + data[start + size :]
    return data[:start] + rng.bytes(end - start) + data[end:]


def one_case(seed: int, number: int, folder: Path) -> str:
    """Read one damaged file; return its kind and the outcome."""
    rng = np.random.default_rng([seed, number])
    kind = list(KINDS)[number % len(KINDS)]
    make, read = KINDS[kind]
    paths = list(make(folder))
    path = paths[int(rng.integers(len(paths)))]
    read(path)  # the intact file
    path.write_bytes(damaged(path.read_bytes(), rng))
    try:
        read(path)
    except (CmpClError, OSError):
        return f"{kind} refused"
    return f"{kind} read"


def child(seed: int, first: int, last: int, megabytes: int) -> None:
    """Read the files of some cases; print the number of each before, and its outcome after."""
    size = megabytes << 20
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    cv2.setNumThreads(1)
    for number in range(first, last):
        print(number, end=" ", flush=True)
        signal.alarm(LIMIT_S)  # the signal ends the process
        with tempfile.TemporaryDirectory() as folder:
            outcome = one_case(seed, number, Path(folder))
        signal.alarm(0)
        if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > LIMIT_KB:
            sys.exit(TOO_LARGE)
        print(outcome, flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the cases; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--megabytes", type=int, default=3000, help="address space of the reader")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after that")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    last = options.first + options.cases
    if options.child is not None:
        child(options.seed, options.first, options.child, options.megabytes)
        return 0
    begin, first = time.monotonic(), options.first
    counts: Counter[str] = Counter()
    while first < last and time.monotonic() - begin < options.seconds:
        end = min(first + 200, last)
        command = [sys.executable, __file__, "--seed", str(options.seed), "--first", str(first)]
        command += ["--megabytes", str(options.megabytes), "--child", str(end)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace")
        lines = done.stdout.splitlines()
        counts.update(line.partition(" ")[2] for line in lines if line.partition(" ")[2])
        if done.returncode == 0:
            first = end
            continue
        number = int(lines[-1].split()[0])
        print(f"FAILED with {done.returncode}; again: --seed {options.seed} --first {number}")
        print("\n".join(done.stderr.splitlines()[-12:]), flush=True)
        kinds = {-signal.SIGALRM: "hung", TOO_LARGE: "over 1 GB"}
        counts[kinds.get(done.returncode, "failed")] += 1
        first = number + 1
    print(f"{sum(counts.values())} cases: {dict(sorted(counts.items()))}")
    return 1 if counts["failed"] + counts["hung"] + counts["over 1 GB"] else 0


if __name__ == "__main__":
    sys.exit(main())
