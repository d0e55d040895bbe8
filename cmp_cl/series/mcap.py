"""A series as MCAP, with the nodes as ROS 2 point clouds; it needs no ROS."""

import contextlib
import errno
import importlib
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import extra
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
