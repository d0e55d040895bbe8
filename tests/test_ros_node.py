"""The example of a ROS 2 node, against a stand-in for ROS."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from cmp_cl.synthetic import boards

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "ros_node.py"


class Message:
    """Any message: its fields are what it was given."""

    def __init__(self, **fields):
        self.__dict__.update(fields)


@pytest.fixture
def node(monkeypatch):
    """Return the example's module, with a stand-in for rclpy that keeps what is published."""

    class Node:
        def __init__(self, name):
            self.published, self.said = [], []
            say = self.said.append
            logger = Message(info=say, warning=say, error=say)
            self.get_logger = lambda: logger
            self.declare_parameter = lambda name, value: Message(value=value)
            self.create_publisher = lambda *_: Message(publish=self.published.append)

        def create_subscription(self, kind, topic, callback, qos):
            assert topic == "image_raw"
            assert qos == "best effort"  # what cameras publish, and any subscriber may ask for

    kinds = {kind: Message for kind in ("Image", "PointCloud2", "PointField")}
    for name, content in {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": "best effort"},
        "sensor_msgs.msg": kinds,
    }.items():
        monkeypatch.setitem(sys.modules, name, Message(**content))
    spec = importlib.util.spec_from_file_location("ros_node", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def image_message(number, image, encoding):
    return Message(
        header={"frame_id": "gel", "number": number},
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=image.shape[1],
        data=image.tobytes(),
    )


def test_the_example_node_publishes_no_numbers_that_may_be_wrong(node):
    """No border of the pattern is in view."""
    deformation = node.Deformation()
    for number, shift in enumerate((0.0, 7.5)):
        camera = boards.plane(cell=14, middle=(-40 + shift, -40))
        image = boards.drawn(camera, (168, 168), (30, 30)).image
        deformation.take(image_message(number, image, "mono8"))
    deformation.close()
    warning = "a frame is not published: its numbers may be wrong by whole cells"
    assert deformation.said[1:] == [warning, warning]
    assert not deformation.published


def test_the_example_node_publishes_displacements_with_the_images_header(node):
    deformation = node.Deformation()
    for number, shift in enumerate((0.0, 1.5)):
        camera = boards.plane(cell=14, middle=(23 + shift, 23))
        image = boards.drawn(camera, (200, 200), (12, 12)).image
        deformation.take(image_message(number, image, "mono8"))
    deformation.take(image_message(2, image, "rgb8"))
    deformation.close()
    assert deformation.said[0] == "144 nodes at rest"
    assert "rgb8" in deformation.said[1]
    assert len(deformation.published) == 2
    cloud = deformation.published[1]
    assert cloud.header["number"] == 1
    points = np.frombuffer(cloud.data, "<f4").reshape(cloud.height, cloud.width, 9)
    np.testing.assert_allclose(points[..., 3], 1.5, atol=0.1)
    np.testing.assert_allclose(points[..., 4], 0, atol=0.1)
