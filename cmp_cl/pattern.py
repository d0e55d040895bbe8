"""The checkerboard to print: SVG or PNG, true to size.

Lengths are mm, x points right and y down from the top-left corner of the sheet.
"""

import dataclasses
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, check_range, check_shape, extra
from cmp_cl.files import suffix_of, whole_file

_MM_PER_INCH = 25.4
_POINTS_PER_MM = 72 / _MM_PER_INCH
_STRIP = 8.0  # mm beside the cells for a scale bar with its label
_BAR = 0.2  # mm, thickness of a scale bar
_TICK = 2.0  # mm, height of the bars' ends
_BESIDE = 1.6  # mm from the border to the middle of a bar, and from there to its label
_LETTER = 2.5  # mm, size of the labels' letters
_WIDTH = 0.5  # mean width of a letter, as a share of its size
_LENGTHS = (200, 100, 50, 20, 10, 5, 2, 1)  # mm, possible lengths of a scale bar
_MOST_PIXELS = 10**8
_MOST_CELLS = 10**6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard on a sheet.

    shape: rows and columns of inner corners, each 1 or more; each side has one cell more. The top
        left cell is black.
    cell: side of a cell, mm, 0.01 to 1000.
    bare: leave out the white border around the cells, one cell wide, and the scale bars along x and
        y, for a mask that covers a gel up to its rim.
    """

    shape: tuple[int, int]
    cell: float
    bare: bool = False

    def __post_init__(self) -> None:
        check_shape(self.shape, ConfigError)
        rows, columns = self.shape
        if (rows + 1) * (columns + 1) > _MOST_CELLS:
            raise ConfigError(
                f"{rows} x {columns} corners are more than {_MOST_CELLS} cells; draw fewer"
            )
        check_range("cell", self.cell, 0.01, 1000)

    @property
    def size(self) -> tuple[float, float]:
        """Return the width and height of the sheet, mm: cells, border and scale bars."""
        width, height = self._board()
        around = 0.0 if self.bare else 2 * self.cell + _STRIP
        return width + around, height + around

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the positions of the inner corners on the sheet, (R, C, 2), (x, y), mm."""
        rows, columns = self.shape
        x = self._border + np.arange(1, columns + 1) * self.cell
        y = self._border + np.arange(1, rows + 1) * self.cell
        return np.stack(np.meshgrid(x, y), axis=2)

    def save(self, path: str | PathLike[str], *, dpi: float = 600) -> None:
        """Write the sheet as .svg or .png, by suffix, whole or not at all.

        .png: grey levels at `dpi` pixels per inch, which the file states; a pixel on an edge is
        darker the more of it is covered.

        Raises ConfigError on another suffix, a dpi outside 10 to 10 000, more than 100 million
        pixels or without matplotlib, OSError if the file cannot be written.
        """
        suffix = suffix_of(path, ConfigError)
        if suffix not in (".svg", ".png"):
            raise ConfigError(f"{str(path)!r}: the suffix must be .svg or .png")
        check_range("dpi", dpi, 10, 10_000)
        width, height = (int(side / _MM_PER_INCH * dpi) for side in self.size)
        if suffix == ".png" and width * height > _MOST_PIXELS:
            raise ConfigError(
                f"{width} x {height} px are more than {_MOST_PIXELS // 10**6} million; "
                "take a smaller dpi, or .svg"
            )
        how = {"metadata": {"Date": None}} if suffix == ".svg" else {"dpi": dpi}
        figure = self._figure()
        with whole_file(path) as file:
            figure.savefig(file, format=suffix[1:], **how)

    def _figure(self) -> Any:
        """Return a figure of matplotlib."""
        with extra("plot", "a pattern"):
            from matplotlib.figure import Figure
            from matplotlib.patches import PathPatch
            from matplotlib.path import Path
        width, height = self.size
        rounding = 1e-9  # so that whole pixels stay whole
        figure = Figure(figsize=(width / _MM_PER_INCH + rounding, height / _MM_PER_INCH + rounding))
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
        axes.set_axis_off()
        black = Path.make_compound_path_from_polys(self._black())
        axes.add_patch(PathPatch(black, facecolor="black", linewidth=0, snap=False))
        if not self.bare:
            self._draw_bars(axes)
        return figure

    def _draw_bars(self, axes: Any) -> None:
        """Draw a scale bar below the cells and one beside them; their outer edges are measured."""
        (rows, columns), start, (width, height) = self.shape, self._border, self._board()
        right, bottom = (start + side + self.cell + _BESIDE for side in (width, height))
        along, down = (next((x for x in _LENGTHS if x <= side), 1) for side in (width, height))
        thick = _BAR * _POINTS_PER_MM
        style = {"color": "black", "linewidth": thick, "markersize": _TICK * _POINTS_PER_MM}
        style |= {"markeredgewidth": thick, "solid_capstyle": "butt"}
        x = start + _BAR / 2, start + along - _BAR / 2
        axes.plot(x, (bottom, bottom), marker="|", **style)
        y = start + _BAR / 2, start + down - _BAR / 2
        axes.plot((right, right), y, marker="_", **style)
        title = f"{along} mm   {rows} x {columns} corners   cell {self.cell:.4g} mm"
        if _WIDTH * _LETTER * len(title) > width + self.cell + _STRIP:
            title = f"{along} mm"
        letters = {"fontsize": _LETTER * _POINTS_PER_MM}
        axes.text(start, bottom + _BESIDE + _LETTER, title, **letters)
        axes.text(right + _BESIDE, start + _LETTER, f"{down}", **letters)

    def _board(self) -> tuple[float, float]:
        """Return the width and height of all cells together, mm."""
        return (self.shape[1] + 1) * self.cell, (self.shape[0] + 1) * self.cell

    @property
    def _border(self) -> float:
        """Return the distance of the cells from the left and the upper edge of the sheet, mm."""
        return 0.0 if self.bare else self.cell

    def _black(self) -> NDArray[np.float64]:
        """Return the corners of each black cell, (N, 4, 2), (x, y), mm."""
        rows, columns = self.shape
        row, column = np.nonzero(np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 0)
        around = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        cells = np.stack([column, row], axis=1)[:, None] + around
        return np.asarray(self._border + cells * self.cell)
