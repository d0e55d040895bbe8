"""What an image is, with an error that says how to convert anything else."""

from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ImageError

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
AnyImage: TypeAlias = NDArray[Any]  # what a user gives, such as cv2.imread's; `check_image` looks
_PIXELS = frozenset({np.dtype(np.uint8), np.dtype(np.uint16)})


def check_image(image: Any) -> GreyImage:
    """Return the image, if it is (H, W) uint8 or uint16 with pixels, its rows contiguous;
    the pixels of a subclass of NumPy's array come back as such an array, without a copy.

    Raises ImageError that says what was given, what is expected and which call converts it.
    """
    if not _is_image(image):
        raise _not_an_image(image)
    return cast(GreyImage, np.asarray(image))


def check_dtype(dtype: Any) -> np.dtype[Any]:
    """Return the type of an image's pixels; raises ImageError if it is not uint8 or uint16."""
    try:
        known: np.dtype[Any] = np.dtype(dtype)
    except TypeError as error:
        raise ImageError(f"dtype must be uint8 or uint16, not {dtype!r}") from error
    if known not in _PIXELS:
        raise ImageError(f"dtype must be uint8 or uint16, not {known}")
    return known


def check_mask(mask: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a copy of the mask of an image of that shape, if it is (H, W) bool; raises
    ImageError."""
    is_array = isinstance(mask, np.ndarray)
    if not (is_array and mask.dtype == np.bool_ and mask.shape == shape):
        came = f"{mask.shape} of {mask.dtype}" if is_array else type(mask).__name__
        raise ImageError(f"mask must be {shape} of bool, not {came}; mask > 0 converts")
    return np.array(mask)


def _is_image(image: Any) -> bool:
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype not in _PIXELS:
        return False
    if np.ma.is_masked(image):  # nothing else would look at its mask
        return False
    (rows, columns), (row, column), size = image.shape, image.strides, image.itemsize
    return (
        image.size > 0
        and (column == size or columns == 1)
        and (rows == 1 or (row >= columns * size and row % size == 0))
    )


def _not_an_image(image: Any) -> Exception:
    """Return an ImageError that says what was given and how to convert it."""
    expected, came = "expected a NumPy array (H, W) of uint8 or uint16", type(image).__name__
    hint = (
        "cv2.imread(file, 0) reads a file, and gives None for one that it cannot read; "
        "numpy.asarray(image) converts most other images"
    )
    if isinstance(image, np.ndarray):
        came = f"shape {image.shape} of {image.dtype}"
        hint = "it must have pixels, and numpy.ascontiguousarray(image) makes its rows contiguous"
        if np.ma.is_masked(image):
            came = "a masked array"
            hint = "image.filled(level) converts, and Detector(mask=...) leaves pixels out"
        elif image.ndim == 3 and image.shape[2] in (3, 4):
            hint = "cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) converts"
        elif image.ndim != 2:
            hint = "image.reshape(height, width) or one frame of it converts"
        elif image.dtype not in _PIXELS:
            hint = "(image * (255 / white)).clip(0, 255).astype(numpy.uint8) converts"
            if image.dtype.newbyteorder("=") in _PIXELS:
                hint = "image.astype(numpy.uint16) puts its bytes in this machine's order"
    return ImageError(f"{expected}, got {came}; {hint}")
