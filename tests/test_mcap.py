"""Recordings of robots, read and written, and the example node."""

import importlib.util
import sys
import types
from pathlib import Path

import cv2
import numpy as np
import pytest
from plane_images import moved_board

from cmp_cl.cli.main import main
from cmp_cl.errors import ImageError
from cmp_cl.media.bags import mcap_images
from cmp_cl.media.cameras import Source

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "ros_node.py"
START = 1_700_000_000_123  # ms since 1970
HEADER = """\
std_msgs/Header header
{fields}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = HEADER.format(
    fields="uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    "uint8[] data"
)
COMPRESSED = HEADER.format(fields="string format\nuint8[] data")


@pytest.fixture
def ros():
    """Return the writer of the package mcap-ros2-support."""
    pytest.importorskip("mcap_ros2", reason="mcap-ros2-support is not installed")
    return importlib.import_module("mcap_ros2.writer")


def header(number):
    milliseconds = START + 20 * number
    stamp = {"sec": milliseconds // 1000, "nanosec": milliseconds % 1000 * 10**6}
    return {"stamp": stamp, "frame_id": "gel"}


def image_message(number, image, encoding, *, padding=0, big=False):
    pixels = image.astype(">u2") if big else image
    lines = pixels.reshape(image.shape[0], -1).view(np.uint8)
    lines = np.pad(lines, ((0, 0), (0, padding)))
    return {
        "header": header(number),
        "height": image.shape[0],
        "width": image.shape[1],
        "encoding": encoding,
        "is_bigendian": int(big),
        "step": lines.shape[1],
        "data": lines.tobytes(),
    }


def write(ros, path, messages):
    """Write messages: topic, kind, definition and content of each."""
    with open(path, "wb") as file:
        writer = ros.Writer(file)
        schemas = {}
        for topic, kind, definition, message in messages:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(f"sensor_msgs/msg/{kind}", definition)
            stamp = message["header"]["stamp"]
            time = stamp["sec"] * 10**9 + stamp["nanosec"]
            writer.write_message(topic, schemas[kind], message, log_time=time, publish_time=time)
        writer.finish()


def test_images_of_every_encoding_are_read_with_their_stamps(ros, tmp_path):
    ramp = np.arange(48, dtype=np.uint8).reshape(6, 8)
    deep = ramp.astype(np.uint16) * 80
    colour = np.repeat(ramp[..., None], 3, axis=2)
    messages = [
        image_message(0, ramp, "mono8", padding=3),
        image_message(1, deep, "mono16"),
        image_message(2, deep, "16UC1", big=True),
        image_message(3, colour, "bgr8"),
        image_message(4, ramp, "bayer_rggb8"),
    ]
    path = tmp_path / "gel.mcap"
    write(ros, path, [("/gel", "Image", IMAGE, message) for message in messages])
    found = list(mcap_images(path))
    assert [time for time, _ in found] == [(START + 20 * n) * 10**6 for n in range(5)]
    for (_, image), expected in zip(found[:4], (ramp, deep, deep, ramp), strict=True):
        np.testing.assert_array_equal(image, expected)
        assert image.dtype == expected.dtype
    assert found[4][1] is None
    write(ros, tmp_path / "next.mcap", [("/gel", "Image", IMAGE, image_message(5, ramp, "mono8"))])
    source = Source(str(tmp_path / "*.mcap"), from_start=True)  # the parts have one start
    frames = list(source.frames())
    assert [frame.time_ms for frame in frames] == [0, 20, 40, 60, 80, 100]
    assert source.start_ns == START * 10**6
    np.testing.assert_array_equal(frames[1].image, deep)


def test_compressed_images_are_read_and_a_topic_is_chosen(ros, tmp_path):
    ramp = np.arange(48, dtype=np.uint8).reshape(6, 8)
    packed = {
        "header": header(0),
        "format": "png",
        "data": cv2.imencode(".png", ramp)[1].tobytes(),
    }
    path = tmp_path / "gel.mcap"
    messages = [
        ("/a", "Image", IMAGE, image_message(0, ramp, "mono8")),
        ("/b", "CompressedImage", COMPRESSED, packed),
    ]
    write(ros, path, messages)
    ((_, image),) = mcap_images(path, topic="/b")
    np.testing.assert_array_equal(image, ramp)
    with pytest.raises(ImageError, match="/a, /b"):
        list(mcap_images(path))
    with pytest.raises(ImageError, match="no image topic /c"):
        list(mcap_images(path, topic="/c"))
    (tmp_path / "bad.mcap").write_bytes(b"nothing")
    with pytest.raises(ImageError, match="not an MCAP"):
        list(mcap_images(tmp_path / "bad.mcap"))


def test_a_recording_of_a_robot_is_measured_and_its_stamps_are_kept(ros, tmp_path):
    board = (30, 30, 190, 190)
    messages = []
    for number, shift in enumerate((0.0, 1.5, 2.5)):
        image = moved_board((220, 220), 20, lambda q, s=shift: 0 * q + [s, 0], board=board, noise=1)
        messages.append(("/gel", "Image", IMAGE, image_message(number, image, "mono8")))
    write(ros, tmp_path / "gel.mcap", messages)
    source, out = str(tmp_path / "gel.mcap"), str(tmp_path / "nodes.mcap")
    assert main(["run", source, "--out", out]) == 0
    reading, decoding = (importlib.import_module(n) for n in ("mcap.reader", "mcap_ros2.decoder"))
    with open(out, "rb") as file:
        reader = reading.make_reader(file, decoder_factories=[decoding.DecoderFactory()])
        found = [(record.log_time, cloud) for _, _, record, cloud in reader.iter_decoded_messages()]
        assert next(reader.iter_metadata()).metadata["unit of xy"] == "px"
    assert [stamp for stamp, _ in found] == [(START + 20 * n) * 10**6 for n in range(3)]
    points = np.frombuffer(found[2][1].data, "<f4").reshape(8, 8, 9)
    np.testing.assert_allclose(points[..., 3], 2.5, atol=0.1)


# the example node, against a stand-in for ROS


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

        def declare_parameter(self, name, value):
            return Message(value=value)

        def create_publisher(self, kind, topic, depth):
            return Message(publish=self.published.append)

        def create_subscription(self, kind, topic, callback, depth):
            assert topic == "image_raw"

        def get_logger(self):
            return Message(info=self.said.append, error=self.said.append)

    for name, content in (
        ("rclpy", {}),
        ("rclpy.node", {"Node": Node}),
        ("sensor_msgs", {}),
        ("sensor_msgs.msg", {kind: Message for kind in ("Image", "PointCloud2", "PointField")}),
    ):
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("ros_node", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_example_node_publishes_displacements_with_the_images_header(node):
    deformation = node.Deformation()
    board = (30, 30, 190, 190)
    for number, shift in enumerate((0.0, 1.5)):
        image = moved_board((220, 220), 20, lambda q, s=shift: 0 * q + [s, 0], board=board, noise=1)
        deformation.take(Message(**image_message(number, image, "mono8")))
    deformation.take(Message(**image_message(2, image, "rgb8")))
    deformation.close()
    assert deformation.said[0] == "64 nodes at rest"
    assert "rgb8" in deformation.said[1]
    assert len(deformation.published) == 2
    cloud = deformation.published[1]
    assert cloud.header == header(1)
    points = np.frombuffer(cloud.data, "<f4").reshape(cloud.height, cloud.width, 9)
    np.testing.assert_allclose(points[..., 3], 1.5, atol=0.1)
    np.testing.assert_allclose(points[..., 4], 0, atol=0.1)
