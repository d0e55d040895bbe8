"""Frames of other array libraries."""

import numpy as np
import pytest

from cmp_cl.arrays import as_frame
from cmp_cl.errors import ImageError

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


def test_memory_of_the_host_is_shared():
    image = IMAGE.copy()
    frame = as_frame(Host(image))
    image[2, 3] = 200
    assert frame[2, 3] == 200
    assert as_frame(image) is image


@pytest.mark.parametrize("method", ["get", "cpu", "copy_to_host"])
@pytest.mark.parametrize("result", [IMAGE, Host(IMAGE)])
def test_memory_of_a_device_is_copied_by_its_library(method, result):
    np.testing.assert_array_equal(as_frame(Cuda(method, result)), IMAGE)


def test_what_is_no_image_is_refused():
    with pytest.raises(ImageError, match=r"cupy\.asarray"):
        as_frame(Cuda())
    with pytest.raises(ImageError, match="expected"):
        as_frame(Host(IMAGE.astype(np.float32)))
    with pytest.raises(ImageError, match="list"):
        as_frame([1, 2])
