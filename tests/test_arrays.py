"""Frames of other array libraries."""

import images
import numpy as np
import pyopencl as cl
import pytest
from comparison import assert_same_bytes

from cmp_cl import Detector, DetectorConfig, RingHarmonic, detect
from cmp_cl.errors import ImageError
from cmp_cl.image import as_frame

BOARD = images.eight_bits()["board"]
IMAGE = np.arange(48, dtype=np.uint8).reshape(6, 8)


class Host:
    """An array of another library in the host's memory."""

    def __init__(self, image):
        self.image = image

    def __dlpack__(self, **how):
        return self.image.__dlpack__(**how)

    def __dlpack_device__(self):
        return self.image.__dlpack_device__()


class Cuda:
    """An array on a CUDA device, whose library copies it by `method`."""

    def __init__(self, method=None, result=IMAGE):
        self.__cuda_array_interface__ = {"shape": (6, 8), "typestr": "|u1", "data": (1, True)}
        if method:
            setattr(self, method, lambda: result)

    def __dlpack_device__(self):
        return (2, 0)


@pytest.mark.parametrize("method", ["get", "cpu", "copy_to_host"])
@pytest.mark.parametrize("result", [IMAGE, Host(IMAGE)])
def test_memory_of_a_device_is_copied_by_its_library(method, result):
    np.testing.assert_array_equal(as_frame(Cuda(method, result)), IMAGE)


def test_an_array_that_is_no_image_is_refused():
    with pytest.raises(ImageError, match=r"cupy\.asarray"):
        as_frame(Cuda())
    with pytest.raises(ImageError, match="expected"):
        as_frame(Host(IMAGE.astype(np.float32)))
    with pytest.raises(ImageError, match="list"):
        as_frame([1, 2])


@pytest.mark.parametrize("array", [Host(BOARD), Cuda("get", BOARD)])
def test_a_detector_takes_arrays_of_other_libraries(array, device):
    expected = detect(BOARD, device=device)
    assert len(expected) > 3
    assert_same_bytes(detect(array, device=device), expected)
    with Detector(shape=BOARD.shape, device=device) as detector:
        for found in (
            detector(array),
            *detector.stream([array, BOARD]),
            *detector.batch([BOARD, array]),
            detector.on_device(array)[0],
        ):
            assert_same_bytes(found, expected)
        one, other = detector.maps(array), detector.maps(BOARD)
        np.testing.assert_array_equal(one.maximum, other.maximum)
        with pytest.raises(ImageError, match="this detector takes"):
            detector(Host(IMAGE))


@pytest.mark.parametrize("name", ["board", "black"])
@pytest.mark.parametrize(
    "config",
    [DetectorConfig(), DetectorConfig(detection=RingHarmonic(octaves=0), max_corners=4, scale=0.9)],
)
def test_positions_stay_on_the_device_if_requested(device, name, config):
    image = images.eight_bits()[name]
    context = cl.Context([device.handle])
    queue = cl.CommandQueue(context)
    held = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=image)
    with Detector(shape=image.shape, config=config, queue=queue) as detector:
        expected = detector(image)
        for frame in (image, held):
            corners, positions = detector.on_device(frame)
            detector(images.eight_bits()["noise"])  # the buffer is the caller's
            here = np.empty((len(expected), 2), np.float32)
            if len(expected):
                cl.enqueue_copy(queue, here, positions)
            assert_same_bytes(corners, expected)
            np.testing.assert_array_equal(here, expected.xy)
