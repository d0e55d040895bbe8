"""A ROS 2 node: images in, the displacement of every node of the pattern out as PointCloud2.

    ros2 run --prefix python3 ... or: python3 ros_node.py --ros-args -p image:=/gel/image_raw

The first image is the frame at rest. It subscribes to sensor_msgs/Image (mono8, mono16) on the
topic `image` and publishes sensor_msgs/PointCloud2 on `nodes`, with the stamp and the frame of
the image. The fields are x y z dx dy dz sigma row column, in px; with one view, z and dz are 0.
If the parameter `stereo` names the file of a rig, an image holds both views, and lengths are in
the rig's unit. The parameter `shape` gives the pattern's rows and columns, such as 40x40.

An image whose displacements may all be wrong gives a warning and no message.

It was tested with a stand-in for rclpy, not within ROS.
"""

import array

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, PointCloud2, PointField

import cmp_cl
from cmp_cl.measure import OneView, TwoViews
from cmp_cl.series.mcap import point_cloud


class Deformation(Node):
    """Measures every image against the first one."""

    def __init__(self) -> None:
        super().__init__("cmp_cl")
        names = {"image": "image_raw", "nodes": "nodes", "stereo": "", "shape": "", "device": ""}
        for name, value in names.items():
            names[name] = str(self.declare_parameter(name, value).value)
        self._names = names
        self._measure: OneView | TwoViews | None = None
        self._publisher = self.create_publisher(PointCloud2, names["nodes"], 10)
        # Drivers may publish as "best effort", which a subscriber that asks for more never gets.
        self.create_subscription(Image, names["image"], self.take, qos_profile_sensor_data)

    def take(self, message: Image) -> None:
        """Measure an image and publish its nodes."""
        frame = grey(message)
        if frame is None:
            self.get_logger().error(f"{message.encoding} is neither mono8 nor mono16")
            return
        try:
            if self._measure is None:
                self._measure = self._at_rest(frame)
                self.get_logger().info(f"{self._measure.nodes} nodes at rest")
            measured = self._measure(frame)
        except cmp_cl.CmpClError as error:
            self.get_logger().error(str(error))
            return
        for doubtful, reason in (
            (measured.ambiguous, "its numbers may be wrong by whole cells"),
            (measured.misfit, "the rig no longer fits as it did at rest"),
        ):
            if doubtful:
                self.get_logger().warning(f"a frame is not published: {reason}")
                return
        rest = self._measure.constants["rest"]
        field = measured.field
        nodes = point_cloud(rest, field.displacement, field.sigma, 0, "")
        self._publisher.publish(cloud(message.header, nodes))

    def _at_rest(self, frame: np.ndarray) -> OneView | TwoViews:
        search: dict = {}
        if self._names["shape"]:
            rows, columns = map(int, self._names["shape"].split("x"))
            search["shape"] = (rows, columns)
        if self._names["device"]:
            search["device"] = self._names["device"]
        if not self._names["stereo"]:
            return OneView(frame, **search)
        rig = cmp_cl.StereoRig.load(self._names["stereo"])
        split = cmp_cl.BinocularSplit.halves(frame.shape[1], frame.shape[0])
        return TwoViews(frame, rig, split, **search)

    def close(self) -> None:
        """Release the device's memory."""
        if self._measure is not None:
            self._measure.close()


def grey(message: Image) -> np.ndarray | None:
    """Return the pixels (H, W) of an image, uint8 or uint16; None for other encodings."""
    if message.encoding not in ("mono8", "8UC1", "mono16", "16UC1"):
        return None
    deep = message.encoding in ("mono16", "16UC1")
    lines = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
    lines = np.ascontiguousarray(lines[:, : message.width * (2 if deep else 1)])
    if not deep:
        return lines
    return lines.view(">u2" if message.is_bigendian else "<u2").astype(np.uint16)


def cloud(header: object, fields: dict) -> PointCloud2:
    """Return the ROS message for the result of `point_cloud`, with the image's header."""
    message = PointCloud2()
    message.header = header
    message.fields = [PointField(**field) for field in fields["fields"]]
    message.data = array.array("B", fields["data"])
    for name in ("height", "width", "is_bigendian", "point_step", "row_step", "is_dense"):
        setattr(message, name, fields[name])
    return message


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = Deformation()
    try:
        rclpy.spin(node)
    finally:
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
