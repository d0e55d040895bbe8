"""A damaged file of any kind gives a result or an error of cmp_cl, and nothing else."""

import importlib
import itertools
import warnings

import cv2
import numpy as np
import pytest
from stereo_data import grid_of, toed_in_rig
from videos import write_video

from cmp_cl import CmpClError, DetectorConfig, EdgeStep, Grid, SeriesWriter, StereoRig, media
from cmp_cl.media.bags import mcap_images
from cmp_cl.series import read_series

BOARD = (np.indices((60, 80)) // 9).sum(axis=0).astype(np.uint8) % 2 * 150 + 40
NODES = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1) * 10 + 5
NEEDED = {".h5": "h5py", ".mcap": "mcap_ros2"}
IMAGE = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
IMAGE += (
    f"uint32 step\nuint8[] data\n{'=' * 80}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp"
)
IMAGE += f"\nstring frame_id\n{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"


def write_series(path):
    with SeriesWriter(path, rest=NODES, unit="px") as series:
        for number in range(3):
            series.append(index=number, time_ms=40.0 * number, xy=NODES + number)


def write_bag(path):
    with open(path, "wb") as file:
        writer = importlib.import_module("mcap_ros2.writer").Writer(file)
        image = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE)
        stamp = {"stamp": {"sec": 1, "nanosec": 5}, "frame_id": "camera"}
        shown = {"height": 60, "width": 80, "encoding": "mono8", "is_bigendian": 0, "step": 80}
        writer.write_message("/image", image, {"header": stamp, "data": BOARD.tobytes()} | shown)
        writer.finish()


def read_all(path):
    return list(itertools.islice(media.read_frames(path), 40))


KINDS = {
    "a.toml": (DetectorConfig(refinement=EdgeStep(cell=17.5)).save, DetectorConfig.load),
    "rig.yaml": (toed_in_rig().save, StereoRig.load),
    "rest.npz": (grid_of(NODES).save, Grid.load),
    **{
        f"a.{suffix}": (lambda path: media.write_image(path, BOARD), media.read_image)
        for suffix in ("png", "jpg", "bmp", "pgm", "webp", "jp2")
    },
    "stack.tif": (lambda path: cv2.imwritemulti(str(path), [BOARD] * 3), read_all),
    "a.avi": (lambda path: write_video(path, [BOARD] * 4), read_all),
    "a.mp4": (lambda path: write_video(path, [BOARD] * 4, "mp4v"), read_all),
    "press.npz": (write_series, read_series),
    "press.h5": (write_series, read_series),
    "a.mcap": (write_bag, lambda path: list(mcap_images(path))),
}


def damaged(data, rng):
    """Return the bytes with a part flipped, left out, repeated, overwritten, or cut off."""
    start, end = sorted(int(n) for n in rng.integers(0, len(data), 2))
    end = min(end, start + int(rng.integers(1, 400)))
    return [
        data[:start] + bytes([data[start] ^ (1 << int(rng.integers(8)))]) + data[start + 1 :],
        data[:start],
        data[:start] + data[end:],
        data[:end] + data[start:end] * int(rng.integers(1, 50)) + data[end:],
        data[:start] + rng.bytes(end - start) + data[end:],
    ][int(rng.integers(5))]


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_read_or_refused(tmp_path, name):
    write, read = KINDS[name]
    path = tmp_path / name
    if path.suffix in NEEDED:
        pytest.importorskip(NEEDED[path.suffix], reason=f"{NEEDED[path.suffix]} is not installed")
    write(path)
    read(path)
    whole, refused = path.read_bytes(), 0
    for seed in range(30):
        path.write_bytes(damaged(whole, np.random.default_rng([seed, len(whole)])))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read(path)
            except CmpClError:
                refused += 1
    assert refused > 1
