"""The checkerboard to print: SVG or PNG, true to size.

Lengths are mm, x points right and y down from the top-left corner of the sheet.
"""

import dataclasses
import math
import struct
import zlib
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, check_pair, check_range, check_shape
from cmp_cl.files import suffix_of, write_bytes

PAPERS = {  # mm, upright
    "a5": (148.0, 210.0),
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "letter": (215.9, 279.4),
}

_MM_PER_INCH = 25.4
_STRIP = 8.0  # mm beside the cells for a scale bar with its label
_BAR = 0.4  # mm, thickness of a scale bar
_TICK = 2.0  # mm, height of the bars' ends
_GAP = 0.6  # mm between cells, bar and label
_LETTER = 2.5  # mm, size of the labels' letters
_WIDTH = 0.5  # mean width of a letter, as a share of its size
_LENGTHS = (200, 100, 50, 20, 10, 5, 2, 1)  # mm, possible lengths of a scale bar
_MOST_PIXELS = 4 * 10**8
_MOST_CELLS = 10**6
_LONGEST_SIDE = 5000.0  # mm


class _Drawing(NamedTuple):
    """A sheet: (N, 4) black rectangles x0 y0 x1 y1, mm, and texts with the left end of their base
    line, mm."""

    black: NDArray[np.float64]
    labels: list[tuple[float, float, str]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard on a sheet.

    shape: rows and columns of inner corners, each 1 or more; each side has one cell more. The top
        left cell is black.
    cell: side of a cell, mm, 0.01 to 1000.
    bare: leave out the white border around the cells, one cell wide, and the scale bars along x and
        y, for a mask that covers a gel up to its rim.
    paper: width and height of the sheet, mm; the pattern is centred on it. None means a sheet that
        just holds the pattern.
    """

    shape: tuple[int, int]
    cell: float
    bare: bool = False
    paper: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_shape(self.shape, ConfigError)
        rows, columns = self.shape
        if (rows + 1) * (columns + 1) > _MOST_CELLS:
            raise ConfigError(
                f"{rows} x {columns} corners are more than {_MOST_CELLS} cells; draw fewer"
            )
        check_range("cell", self.cell, 0.01, 1000)
        if self.paper is not None:
            check_pair("paper", self.paper, 10, 2000)
        needed, sheet = self._needed(), self.size
        if needed[0] > sheet[0] or needed[1] > sheet[1]:
            raise ConfigError(
                f"the pattern needs {needed[0]:.1f} x {needed[1]:.1f} mm and the paper has "
                f"{sheet[0]:g} x {sheet[1]:g}; take smaller cells or other paper"
            )
        if max(sheet) > _LONGEST_SIDE:
            raise ConfigError(
                f"the sheet would be {sheet[0]:.0f} x {sheet[1]:.0f} mm; its sides are at most "
                f"{_LONGEST_SIDE:.0f} mm"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Return the width and height of the sheet, mm."""
        return self._needed() if self.paper is None else self.paper

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the positions of the inner corners on the sheet, (R, C, 2), (x, y), mm."""
        rows, columns = self.shape
        left, top = self._origin()
        x = left + np.arange(1, columns + 1) * self.cell
        y = top + np.arange(1, rows + 1) * self.cell
        return np.stack(np.meshgrid(x, y), axis=2)

    def save(self, path: str | PathLike[str], *, dpi: float = 600) -> None:
        """Write the sheet as .svg or .png, by suffix, whole or not at all.

        .svg: filled paths, a unit is 1 mm. .png: grey levels at `dpi` pixels per inch, which the
        file states; a pixel on an edge is darker the more of it is covered.

        Raises ConfigError on another suffix, a dpi outside 10 to 10 000 or more than 400
        million pixels, OSError if the file cannot be written.
        """
        suffix = suffix_of(path, ConfigError)
        if suffix not in (".svg", ".png"):
            raise ConfigError(f"{str(path)!r}: the suffix must be .svg or .png")
        size, drawing = self.size, self._drawing()
        write_bytes(path, _svg(size, drawing) if suffix == ".svg" else _png(size, drawing, dpi))

    def _board(self) -> tuple[float, float]:
        """Return the width and height of all cells together, mm."""
        return (self.shape[1] + 1) * self.cell, (self.shape[0] + 1) * self.cell

    def _needed(self) -> tuple[float, float]:
        """Return the width and height of the cells with borders and scale bars, mm."""
        width, height = self._board()
        around = 0.0 if self.bare else 2 * self.cell + _STRIP
        return width + around, height + around

    def _origin(self) -> tuple[float, float]:
        """Return the top-left corner of the cells on the sheet, mm."""
        (width, height), needed = self.size, self._needed()
        border = 0.0 if self.bare else self.cell
        return (width - needed[0]) / 2 + border, (height - needed[1]) / 2 + border

    def _drawing(self) -> _Drawing:
        rows, columns = self.shape
        row, column = np.nonzero(np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 0)
        left, top = self._origin()
        black = np.column_stack([column, row, column + 1, row + 1]) * self.cell
        black = black + np.array([left, top, left, top])
        if self.bare:
            return _Drawing(black, [])
        width, height = self._board()
        right, bottom = left + width + self.cell + _GAP, top + height + self.cell + _GAP
        along, down = (next((x for x in _LENGTHS if x <= side), 1) for side in (width, height))
        title = f"{along} mm   {rows} x {columns} corners   cell {self.cell:.4g} mm"
        if _WIDTH * _LETTER * len(title) > width + self.cell + _STRIP:
            title = f"{along} mm"
        beside = _bar(down, top, right)[:, [1, 0, 3, 2]]
        labels = [
            (left, bottom + _TICK + _GAP + _LETTER, title),
            (right + _TICK + _GAP, top + _LETTER, f"{down}"),
        ]
        return _Drawing(np.vstack([black, _bar(along, left, bottom), beside]), labels)


def _bar(length: float, left: float, top: float) -> NDArray[np.float64]:
    """Return a horizontal bar with its two ends: (3, 4) rectangles, mm."""
    right, bottom, middle, half = left + length, top + _TICK, top + _TICK / 2, _BAR / 2
    return np.array(
        [
            [left, middle - half, right, middle + half],
            [left, top, left + half, bottom],
            [right - half, top, right, bottom],
        ]
    )


def _svg(size: tuple[float, float], drawing: _Drawing) -> bytes:
    width, height = size
    path = " ".join(
        f"M{x0:.7g} {y0:.7g}H{x1:.7g}V{y1:.7g}H{x0:.7g}Z" for x0, y0, x1, y1 in drawing.black
    )
    labels = "".join(
        f'<text x="{x:.7g}" y="{y:.7g}" font-family="sans-serif" font-size="{_LETTER}">'
        f"{text}</text>\n"
        for x, y, text in drawing.labels
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.7g}mm" height="{height:.7g}mm" '
        f'viewBox="0 0 {width:.7g} {height:.7g}">\n'
        f'<rect width="{width:.7g}" height="{height:.7g}" fill="white"/>\n'
        f'<path d="{path}" fill="black"/>\n{labels}</svg>\n'
    ).encode()


def _png(size: tuple[float, float], drawing: _Drawing, dpi: float) -> bytes:
    import cv2

    check_range("dpi", dpi, 10, 10_000)
    scale = dpi / _MM_PER_INCH
    width, height = (math.ceil(side * scale - 1e-6) for side in size)
    if width * height > _MOST_PIXELS:
        raise ConfigError(
            f"{width} x {height} px are more than {_MOST_PIXELS // 10**6} million; "
            "take a smaller dpi, or .svg"
        )
    black = np.zeros((height, width), np.float32)
    for x0, y0, x1, y1 in drawing.black * scale:
        columns, across = _covered(x0, x1, width)
        rows, down = _covered(y0, y1, height)
        black[rows, columns] += down[:, None] * across
    image = np.rint(255 * (1 - black.clip(0, 1))).astype(np.uint8)
    for x, y, text in drawing.labels:
        font, origin = cv2.FONT_HERSHEY_SIMPLEX, (round(x * scale), round(y * scale))
        wide = cv2.getTextSize(text, font, 10, 1)[0][0] / 10  # the fonts of OpenCV 4 and 5 differ
        letters = _WIDTH * _LETTER * scale * len(text) / wide
        cv2.putText(image, text, origin, font, letters, 0, 1, cv2.LINE_AA)
    data: bytes = cv2.imencode(".png", image)[1].tobytes()
    per_metre = round(scale * 1000)
    chunk = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    resolution = struct.pack(">I", 9) + chunk + struct.pack(">I", zlib.crc32(chunk))
    after_header = 33  # bytes: the signature and the chunk IHDR
    return data[:after_header] + resolution + data[after_header:]


def _covered(start: float, end: float, count: int) -> tuple[slice, NDArray[np.float32]]:
    """Return the pixels of a row that an interval covers, and the covered share of each."""
    first, last = max(math.floor(start), 0), min(math.ceil(end), count)
    edge = np.arange(first, max(last, first) + 1)
    inside = np.minimum(edge[1:], end) - np.maximum(edge[:-1], start)
    return slice(first, max(last, first)), inside.clip(0, 1).astype(np.float32)
