"""Images of a robot's recording, read from MCAP by the packages of the extra `mcap`."""

import importlib
from collections.abc import Iterator
from os import PathLike
from typing import Any

import cv2
import numpy as np

from cmp_cl.errors import ImageError, extra
from cmp_cl.image import GreyImage
from cmp_cl.media.images import decoded

_TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
}


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
        try:
            return decoded(data, "a message", 0, 1)[0]
        except ImageError:
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
