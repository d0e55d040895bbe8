"""Robot recordings: images are read from MCAP, nodes are written to MCAP as ROS 2 point clouds.

Neither needs ROS: the packages mcap and mcap-ros2-support (the extra `mcap`) read and write
the files.
"""

import contextlib
import errno
import importlib
import os
from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.errors import ImageError
from cmp_cl.extras import extra
from cmp_cl.image import GreyImage
from cmp_cl.series.base import Arrays, Description, Format, at_rest, moved_by

TOPIC = "/cmp_cl/nodes"
POINT_FIELDS = ("x", "y", "z", "dx", "dy", "dz", "sigma", "row", "column")

_RULE = "=" * 80
_POINT_CLOUD = f"""\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_RULE}
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
"""
_TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}


def point_cloud(
    rest: NDArray[Any], shift: NDArray[Any], sigma: NDArray[Any], stamp_ns: int, frame_id: str
) -> dict[str, Any]:
    """Return the nodes as a message sensor_msgs/PointCloud2: position x y z now, displacement dx dy
    dz.

    rest, shift: positions at rest and displacements, (R, C, 2 or 3), in the series' unit; z and
    dz are 0 in a plane. sigma: (R, C). stamp_ns: time stamp, ns. All fields are FLOAT32. The cloud
    is organised, of height R and width C; missing nodes are NaN.
    """
    rows, columns = rest.shape[:2]
    points = np.full((rows, columns, len(POINT_FIELDS)), np.nan, "<f4")
    size = rest.shape[2]
    points[..., 2] = points[..., 5] = np.where(np.isnan(shift[..., 0]), np.nan, 0)
    points[..., :size] = rest + shift
    points[..., 3 : 3 + size] = shift
    points[..., 6] = sigma
    points[..., 7], points[..., 8] = np.indices((rows, columns))
    step = 4 * len(POINT_FIELDS)
    fields = [
        {"name": name, "offset": 4 * index, "datatype": 7, "count": 1}
        for index, name in enumerate(POINT_FIELDS)
    ]
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id},
        "height": rows,
        "width": columns,
        "fields": fields,
        "is_bigendian": False,
        "point_step": step,
        "row_step": step * columns,
        "data": points.tobytes(),
        "is_dense": bool(np.isfinite(points).all()),
    }


class McapFormat(Format):
    """MCAP with one PointCloud2 per frame on /cmp_cl/nodes, for ROS 2, Foxglove and rosbags.

    It needs the constant `rest`, and `displacement` or `xy` in each frame. Lengths are in the
    series' unit, not in m. Stamps are the times of the frames, added to the setting `start_ns`
    if there is one; the stamp of a frame without a time is its number in ms. The description is the
    metadata record `cmp_cl`. Every frame is a chunk of its own. The part has no summary: `mcap
    recover` makes it a whole file.

    Raises ConfigError without the packages, FieldError without `rest`.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        super().__init__(part, description, constants)
        rest = at_rest(constants, "an MCAP")
        with extra("mcap", "MCAP"):
            writing = importlib.import_module("mcap_ros2.writer")
        self._start_ns = int(description.settings.get("start_ns", "0"))
        self._file = open(part, "wb")  # noqa: SIM115, closed by close
        size = 4 * len(POINT_FIELDS) * rest[..., 0].size
        self._writer: Any = writing.Writer(self._file, chunk_size=max(size, 1))
        self._writer.add_metadata("cmp_cl", _about(description))
        self._file.flush()
        self._schema = self._writer.register_msgdef("sensor_msgs/msg/PointCloud2", _POINT_CLOUD)
        self._whole = True

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        rest, shift = moved_by(self.constants, frame, "an MCAP")
        sigma = frame.get("sigma", np.full(rest.shape[:2], np.nan))
        stamp = self._start_ns + round((time_ms if np.isfinite(time_ms) else index) * 1e6)
        frame_id = "camera" if rest.shape[2] == 3 else "image"
        self._check_whole()
        self._whole = False  # if the disk refuses this frame, nothing can follow it
        self._writer.write_message(
            topic=TOPIC,
            schema=self._schema,
            message=point_cloud(rest, shift, sigma, stamp, frame_id),
            log_time=stamp,
            publish_time=stamp,
            sequence=number,
        )
        self._file.flush()
        self._whole = True

    def _check_whole(self) -> None:
        if not self._whole:
            raise OSError(
                errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}; mcap recover repairs the file"
            )

    def finish(self, target: Path, frames: int) -> None:
        self._check_whole()
        self._writer.finish()
        self._file.flush()
        self.close()
        super().finish(target, frames)

    def close(self) -> None:
        with contextlib.suppress(OSError):  # what a full disk refused is tried again, and told
            self._file.close()


def _about(description: Description) -> dict[str, str]:
    units = {f"unit of {name}": unit for name, unit in description.units.items()}
    return description.entries() | units


def mcap_images(
    path: str | PathLike[str], *, topic: str | None = None
) -> Iterator[tuple[int, GreyImage | None]]:
    """Yield the images of a recording: stamp in ns since 1970, (H, W) uint8 or uint16.

    topic: a topic of sensor_msgs/Image or CompressedImage; None means the only one. Colour becomes
    grey. The stamp is the header's, or the log time if that is 0. The image is None if it cannot be
    decoded.

    Raises ConfigError without the packages, ImageError if the file cannot be read, has no
    such topic, or has several and none is chosen.
    """
    with extra("mcap", "MCAP"):
        reading = importlib.import_module("mcap.reader")
        decoding = importlib.import_module("mcap_ros2.decoder")
    try:
        with open(path, "rb") as file:
            reader = reading.make_reader(file, decoder_factories=[decoding.DecoderFactory()])
            chosen = _image_topic(reader, path, topic)
            for _, _, record, message in reader.iter_decoded_messages(topics=[chosen]):
                stamp = message.header.stamp
                image = _grey(message)
                yield stamp.sec * 10**9 + stamp.nanosec or record.log_time, image
    except ImageError:
        raise
    except Exception as error:  # damaged bytes raise any of them, in the packages and in codecs
        raise ImageError(f"{str(path)!r} is not an MCAP that can be read: {error}") from error


def _image_topic(reader: Any, path: str | PathLike[str], topic: str | None) -> str:
    summary = reader.get_summary()
    if summary is None:
        raise ImageError(f"{str(path)!r} has no summary: mcap recover repairs it")
    kinds = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
    found = sorted(
        channel.topic
        for channel in summary.channels.values()
        if channel.schema_id and summary.schemas[channel.schema_id].name in kinds
    )
    if topic is None and len(found) == 1:
        return str(found[0])
    if not found:
        raise ImageError(f"{str(path)!r} has no topic of images")
    if topic not in found:
        names = ", ".join(found)
        what = "which topic is meant?" if topic is None else f"there is no image topic {topic};"
        raise ImageError(f"{str(path)!r}: {what} Its image topics: {names}")
    return str(topic)


def _grey(message: Any) -> GreyImage | None:
    """Return an Image or CompressedImage as grey, None if it cannot be decoded."""
    data = np.frombuffer(bytes(message.data), np.uint8)
    if not hasattr(message, "encoding"):
        with contextlib.suppress(ImageError):
            return next(media.decoded_pages(data, "a message"))
        return None
    encoding, rows, columns = message.encoding, message.height, message.width
    if len(data) < message.step * rows or not rows:
        return None
    lines = data[: message.step * rows].reshape(rows, message.step)
    if encoding in ("mono16", "16UC1") and message.step >= 2 * columns:
        order = ">u2" if message.is_bigendian else "<u2"
        return np.ascontiguousarray(lines[:, : 2 * columns]).view(order).astype(np.uint16)
    if encoding in ("mono8", "8UC1") and message.step >= columns:
        return lines[:, :columns].astype(np.uint8)
    channels = 4 if "a8" in encoding else 3
    if encoding in _TO_GREY and message.step >= channels * columns:
        colour = np.ascontiguousarray(lines[:, : channels * columns])
        grey = cv2.cvtColor(colour.reshape(rows, columns, channels), _TO_GREY[encoding])
        return np.asarray(grey, np.uint8)
    return None
