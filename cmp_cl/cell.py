"""The size of the cells of a pattern, from the image alone."""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.image import GreyImage, check_image

_WINDOW = 63
_NONE_FOUND = 24.0
_HALVINGS = 5
_LEAST_SIDE = 32  # px, the shortest side of a halved image
_SHARE = 0.75  # share of the largest contrast; chosen on rendered boards with cells of 8 to 110 px
_NEAR = (0.7, 1.4)  # cells; runs of these lengths count as one cell
_STEEPEST = 0.3  # px of steep pixels for each edge of a cell
_STEP = 2.1  # step of an edge, over the mean contrast of the runs on its two sides
_OWN_BLUR = 0.4  # px^2, variance that the pixels and the derivative's kernel add
_MOST_PIXELS = 1 << 24  # the most pixels that are examined in either direction
_BAND = 16  # rows of a band


class _Runs(NamedTuple):
    """Runs of one colour, by length: their number and their summed contrast, per examined pixel."""

    number: NDArray[np.float64]
    contrast: NDArray[np.float64]


class Cells(NamedTuple):
    """The size and the contrast of the cells that an image shows.

    side: side of a cell, px. contrast: mean difference from the window's mean, grey levels. weight:
        sum of that difference over the runs of about one cell, per pixel of the image.
    """

    side: float
    contrast: float
    weight: float


def estimate_cell(image: GreyImage) -> float:
    """Estimate the side of the pattern's cells, px; 24 if the image shows none.

    image: (H, W) uint8 or uint16.

    The image is binarized against the mean of a 63 px window. Runs of 3 px and more between two
    transitions are counted over all rows and columns. The cell is the length at which half of the
    pixels of those runs are in runs of that length or shorter.

    A window smaller than a cell sees only noise inside it. So the image is halved up to five times,
    and a cell is estimated at each size. The weight of an estimate is the difference of the runs of
    about one cell from the window's mean. Of the estimates with at least 3/4 of the best weight and
    of which two cells fit into the image, the largest is taken.

    The estimate is within 0.95 to 1.15 of the truth on dense patterns, within 0.8 to 1.4 on boards
    of wide cells, and unreliable in clutter. In an image of over 2^24 px only some rows and columns
    are counted.

    Raises ImageError if the image is not (H, W) uint8 or uint16.
    """
    return estimate_cells(image).side


def estimate_cells(image: GreyImage) -> Cells:
    """Estimate side and contrast of the cells of an image, see `estimate_cell`."""
    import cv2  # imported here: its import takes longer than a plan's first frame

    image = check_image(image)
    if not image.size:
        return Cells(_NONE_FOUND, 0.0, 0.0)
    level: Any = image
    sizes = [_cells(image)]
    for n in range(1, _HALVINGS + 1):
        rows, columns = (length // 2 for length in level.shape)
        if min(rows, columns) < _LEAST_SIDE:
            break
        level = cv2.resize(level, (columns, rows), interpolation=cv2.INTER_AREA)
        halved = _cells(level)
        sizes.append(halved._replace(side=halved.side * 2**n))
    seen = [cells for cells in sizes if 2 * cells.side <= min(image.shape)] or sizes[:1]
    best = max(cells.weight for cells in seen)
    return next(cells for cells in seen if cells.weight >= _SHARE * best)


def estimate_blur(image: GreyImage, cells: Cells) -> float:
    """Estimate the standard deviation of the blur of the cells' edges, px; 0 without contrast.

    image: (H, W). cells: as estimated from it.

    The steepest pixels are on edges. A step C that is blurred by sigma has the slope C / (sqrt(2
    pi) sigma). Noise makes edges look sharper than they are, and so does a pattern that fills only
    a part of the image.
    """
    import cv2

    if not image.size:
        return 0.0
    slopes = []
    for part, band in _bands(image):
        grey = part.astype(np.float32)
        x, y = (cv2.Sobel(grey, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
        slopes.append(np.hypot(x, y)[band].ravel())
    slope = np.concatenate(slopes)
    steepest = min(int(_STEEPEST * len(slope) / cells.side), len(slope) - 1)
    steep = float(-np.partition(-slope, steepest)[steepest])
    if not steep:
        return 0.0
    blur = _STEP * cells.contrast / (math.sqrt(math.tau) * steep)
    return math.sqrt(max(blur**2 - _OWN_BLUR, 0))


def cell_and_blur(image: GreyImage) -> tuple[float, float]:
    """Estimate the side of the cells and the blur of their edges, px, as `for_cell` takes them."""
    cells = estimate_cells(image)
    return min(max(cells.side, 4), 1000), min(estimate_blur(image, cells), 1000)


def _cells(image: GreyImage) -> Cells:
    """Estimate the cells of an image at this size."""
    longest = max(image.shape)
    along, across = _row_runs(image, longest), _row_runs(image.T, longest)
    covered = (along.number + across.number) * np.arange(longest + 1)
    covered[:3] = 0
    pixels = np.cumsum(covered)
    if not pixels[-1]:
        return Cells(_NONE_FOUND, 0.0, 0.0)
    side = int(np.searchsorted(2 * pixels, pixels[-1]))
    near = slice(max(round(_NEAR[0] * side), 3), round(_NEAR[1] * side) + 1)
    weight = float((along.contrast + across.contrast)[near].sum())
    return Cells(float(side), weight / covered[near].sum(), weight)


def _bands(image: GreyImage) -> Iterator[tuple[GreyImage, slice]]:
    """Yield the image, or bands of a large one with the rows that a window needs, and the slice of
    the band's own rows."""
    rows, columns = image.shape
    if rows * columns <= _MOST_PIXELS:
        yield image, slice(None)
        return
    bands = max(_MOST_PIXELS // (_BAND * columns), 1)
    margin = _WINDOW // 2
    for top in np.linspace(0, rows - _BAND, bands).astype(int):
        first = max(top - margin, 0)
        yield image[first : top + _BAND + margin], slice(top - first, top - first + _BAND)


def _row_runs(image: GreyImage, longest: int) -> _Runs:
    """Return the runs of the rows, or of bands of them."""
    found = []
    for part, band in _bands(image):
        black, contrast = _differences(part)
        found.append(_runs(black[band], contrast[band], longest))
    return _Runs(*(np.mean([part[k] for part in found], axis=0) for k in (0, 1)))


def _differences(image: GreyImage) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return a mask of the pixels darker than the mean over a window, and their distance from it.

    The distance is that of the image smoothed over 3 x 3 px, in 1/63^2 grey levels, absolute.
    """
    import cv2

    pixels: NDArray[np.uint8] = np.ascontiguousarray(image)  # or 16 bits

    def sums(side: int) -> NDArray[np.int32]:
        border = cv2.BORDER_REPLICATE
        of_box = cv2.boxFilter(pixels, cv2.CV_32S, (side, side), normalize=False, borderType=border)
        return np.asarray(of_box, np.int32)

    total = sums(_WINDOW)
    smooth = sums(3) * np.int32(_WINDOW**2 // 9)
    return np.less(pixels.astype(np.int32) * _WINDOW**2, total), np.abs(smooth - total)


def _runs(black: NDArray[np.bool_], contrast: NDArray[np.int32], longest: int) -> _Runs:
    """Return the runs between two transitions of a row."""
    row, column = np.nonzero(black[:, 1:] != black[:, :-1])
    whole = np.diff(row) == 0
    length = np.diff(column)[whole]
    before = np.cumsum(contrast, dtype=np.int64)[row * black.shape[1] + column]
    summed = np.diff(before)[whole] / _WINDOW**2
    number, total = (np.bincount(length, part, longest + 1) for part in (None, summed))
    return _Runs(number / black.size, total / black.size)
