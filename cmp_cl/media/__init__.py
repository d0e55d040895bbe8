"""Images, videos and cameras are read here, as grey; images are written whole or not at all.

Images are read by OpenCV. Videos are read by PyAV (the extra `video`), which knows the time of each
frame and its size, keeps the levels of 10 to 16 bits, and refuses damaged frames. Both come
upright: photographs as their EXIF tag says, videos as their display matrix does.
"""

from cmp_cl.media import cameras as cameras
from cmp_cl.media.images import IMAGE_SUFFIXES, find_inputs, read_image, read_pages, write_image
from cmp_cl.media.videos import Frame, VideoInfo, is_video, read_frames, video_info

__all__ = [
    "IMAGE_SUFFIXES",
    "Frame",
    "VideoInfo",
    "find_inputs",
    "is_video",
    "read_frames",
    "read_image",
    "read_pages",
    "video_info",
    "write_image",
]
