"""Videos of grey images."""

from collections.abc import Iterable
from fractions import Fraction

import av
import cv2
import numpy as np
from numpy.typing import NDArray


def write_video(path: object, images: Iterable[NDArray], codec: str = "FFV1") -> None:
    """Write images (H, W) uint8 as a video of 25 frames a second; FFV1 loses nothing."""
    images = list(images)
    size = images[0].shape[::-1]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 25, size, isColor=False)
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
    for image in images:
        writer.write(image)
    writer.release()


def write_deep_video(path: object, image: NDArray) -> None:
    """Write an image (H, W) as three frames of 12 bits at 0, 35 and 110 ms."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width = image.shape
        stream.pix_fmt = "gray12le"
        stream.codec_context.time_base = Fraction(1, 1000)
        for time_ms in (0, 35, 110):
            frame = av.VideoFrame(stream.width, stream.height, "gray12le")
            plane = np.zeros((stream.height, frame.planes[0].line_size // 2), np.uint16)
            plane[:, : stream.width] = image
            frame.planes[0].update(plane.tobytes())
            frame.pts, frame.time_base = time_ms, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def camera_of(images, opened=None):
    """Return a stand-in for cv2.VideoCapture, which has no exposure to set.

    images: what it delivers, None for a read without one, or an error that a read raises. opened: a
    list that gets the number of the camera, and a word when it is released.
    """
    notes = [] if opened is None else opened

    class Camera:
        def __init__(self, number):
            notes.append(number)
            self.left = iter(images)

        def isOpened(self):
            return bool(images)

        def set(self, key, _):
            return key != cv2.CAP_PROP_EXPOSURE

        def read(self):
            image = next(self.left, None)
            if isinstance(image, Exception):
                raise image
            return image is not None, image

        def release(self):
            notes.append("released")

    return Camera
