"""Frames from other array libraries: by DLPack, or from the memory of a CUDA device."""

from typing import Any, Protocol, TypeAlias

import numpy as np

from cmp_cl.errors import ImageError
from cmp_cl.image import GreyImage, check_image

_HOST = (1, 3)  # kDLCPU and kDLCUDAHost of dlpack.h: the host can read this memory
_TO_HOST = ("get", "cpu", "copy_to_host")  # CuPy and pyopencl.array, PyTorch and JAX, Numba


class OnHostOrDevice(Protocol):
    """An array that offers DLPack, as those of PyTorch, JAX, CuPy and NumPy do."""

    def __dlpack__(self, *, stream: Any = None) -> Any:
        """Return a DLPack capsule of the array."""

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return the type of the device in dlpack.h, and its number."""


class OnCuda(Protocol):
    """An array in the memory of a CUDA device, as those of CuPy, Numba and PyTorch."""

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """Return the shape, the type and the address of the array."""


Frame: TypeAlias = GreyImage | OnHostOrDevice | OnCuda


def as_frame(array: Any) -> GreyImage:
    """Return the array as an image (H, W) of uint8 or uint16 that a detector takes.

    NumPy arrays come back as they are. Memory of the host is shared by DLPack, without a copy:
    PyTorch and JAX on the CPU, pinned memory, and anything else with `__dlpack__`. Memory of a
    device (`__cuda_array_interface__`, or DLPack of a device) is staged: the library that owns
    it copies it to the host, after the work that was queued for it there.

    Raises ImageError if the array offers neither, or is not an image.
    """
    if not isinstance(array, np.ndarray):
        by_dlpack = hasattr(array, "__dlpack_device__")
        if by_dlpack and int(array.__dlpack_device__()[0]) in _HOST:
            array = _shared(array)
        elif by_dlpack or hasattr(array, "__cuda_array_interface__"):
            array = _staged(array)
    return check_image(array)


def _shared(array: Any) -> Any:
    try:
        return np.from_dlpack(array)
    except (BufferError, RuntimeError, TypeError, ValueError) as error:
        raise ImageError(f"{type(array).__name__} is not shared by DLPack: {error}") from error


def _staged(array: Any) -> Any:
    for name in _TO_HOST:
        copy = getattr(array, name, None)
        if callable(copy):
            here = copy()
            return here if isinstance(here, np.ndarray) else _shared(here)
    raise ImageError(
        f"{type(array).__name__} lies on a device and has none of {', '.join(_TO_HOST)} to copy it "
        "to the host; cupy.asarray(image).get() does for anything on CUDA"
    )
