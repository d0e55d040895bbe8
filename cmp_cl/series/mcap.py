"""A series as MCAP, with the nodes as ROS 2 point clouds; it needs no ROS."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.series.formats import moved_by
from cmp_cl.series.part import Stored

TOPIC = "/cmp_cl/nodes"
_FLAGS = "ambiguous", "misfit"  # of a frame, each on a topic of its name
POINT_FIELDS = ("x", "y", "z", "dx", "dy", "dz", "sigma", "row", "column")

_LATEST = 2**31 - 1  # s, of ROS's 32 bits with a sign; MCAP has none for the sign

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


def stamp_ns(index: int, time_ms: float) -> int:
    """Return the time stamp of a frame; raises FieldError if MCAP has none for such a time."""
    stamp = time_ms if np.isfinite(time_ms) else index
    if not 0 <= stamp <= 1e3 * _LATEST:
        raise FieldError(f"time_ms must be from 0 to {1e3 * _LATEST:.0f} in .mcap, not {stamp:g}")
    return round(stamp * 1e6)


def write_mcap(series: Stored, path: Path, _target: Path) -> None:
    """MCAP with one PointCloud2 per frame on /cmp_cl/nodes, for ROS 2, Foxglove and rosbags.

    Before it, with its log time, come /cmp_cl/ambiguous and /cmp_cl/misfit, std_msgs/Bool.
    Lengths are in the series' unit, not in m. Stamps are the times of the frames; that of a frame
    without a time is its number in ms. The description is the metadata record `cmp_cl`.
    """
    from mcap_ros2.writer import Writer

    texts = {name: text for name, text in series.about.items() if isinstance(text, str)}
    texts |= {f"unit of {name}": unit for name, unit in series.about["units"].items()}
    with open(path, "wb") as file:
        writer: Any = Writer(file)
        writer.add_metadata("cmp_cl", texts)
        schema = writer.register_msgdef("sensor_msgs/msg/PointCloud2", _POINT_CLOUD)
        flag = writer.register_msgdef("std_msgs/msg/Bool", "bool data\n")
        for index, time_ms, frame in series.frames():
            rest, shift = moved_by(series.constants, frame)
            sigma = frame.get("sigma", np.full(rest.shape[:2], np.nan))
            stamp = stamp_ns(index, time_ms)
            frame_id = "camera" if rest.shape[2] == 3 else "image"
            messages = [
                (f"/cmp_cl/{name}", flag, {"data": bool(frame[name])})
                for name in _FLAGS
                if name in frame
            ]
            messages += [(TOPIC, schema, point_cloud(rest, shift, sigma, stamp, frame_id))]
            for topic, kind, message in messages:
                writer.write_message(
                    topic=topic, schema=kind, message=message, log_time=stamp, publish_time=stamp
                )
        writer.finish()
