"""Videos of grey images."""

from collections.abc import Iterable

import cv2
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
