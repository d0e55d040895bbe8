"""The checkerboard to print: SVG or PNG, true to size.

Lengths are mm, x points right and y down from the top-left corner of the sheet.
"""

import dataclasses
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, check_range, check_shape, extra
from cmp_cl.files import suffix_of, whole_file

_MM_PER_INCH = 25.4
_MOST_PIXELS = 10**8
_MOST_CELLS = 10**6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checkerboard:
    """A checkerboard that fills its sheet.

    shape: rows and columns of inner corners, each 1 or more; each side has one cell more. The top
        left cell is black.
    cell: side of a cell, mm, 0.01 to 1000.
    """

    shape: tuple[int, int]
    cell: float

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
        """Return the width and height of the sheet, mm."""
        rows, columns = self.shape
        return (columns + 1) * self.cell, (rows + 1) * self.cell

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the positions of the inner corners on the sheet, (R, C, 2), (x, y), mm."""
        row, column = np.indices(self.shape)
        return np.asarray((np.stack([column, row], axis=2) + 1) * self.cell, np.float64)

    def save(self, path: str | PathLike[str], *, dpi: float = 600) -> None:
        """Write the sheet as .svg or .png, by suffix, whole or not at all.

        .png: grey levels at `dpi` pixels per inch, which the file states; a pixel on an edge is
        darker the more of it is covered.

        Raises ConfigError on another suffix, a dpi outside 10 to 10 000, no pixel, more than 100
        million or without matplotlib, OSError if the file cannot be written.
        """
        suffix = suffix_of(path)
        if suffix not in (".svg", ".png"):
            raise ConfigError(f"{str(path)!r}: the suffix must be .svg or .png")
        check_range("dpi", dpi, 10, 10_000)
        pixels = [int(side / _MM_PER_INCH * dpi) for side in self.size]
        if suffix == ".png" and not 0 < pixels[0] * pixels[1] <= _MOST_PIXELS:
            raise ConfigError(
                f"the sheet has {pixels[0]} x {pixels[1]} px, and a .png from 1 to "
                f"{_MOST_PIXELS // 10**6} million; take another dpi, or .svg"
            )
        with extra("plot", "a pattern"):
            from matplotlib.figure import Figure
            from matplotlib.patches import PathPatch
            from matplotlib.path import Path
        width, height = self.size
        rounding = 1e-9  # so that whole pixels stay whole
        figure = Figure(figsize=(width / _MM_PER_INCH + rounding, height / _MM_PER_INCH + rounding))
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
        axes.set_axis_off()
        cells = np.argwhere(np.indices((self.shape[0] + 1, self.shape[1] + 1)).sum(0) % 2 == 0)
        around = cells[:, None, ::-1] + [(0, 0), (1, 0), (1, 1), (0, 1)]
        black = Path.make_compound_path_from_polys(around * self.cell)
        axes.add_patch(PathPatch(black, facecolor="black", linewidth=0, snap=False))
        how = {"metadata": {"Date": None}} if suffix == ".svg" else {"dpi": dpi}
        with whole_file(path) as file:
            figure.savefig(file, format=suffix[1:], **how)
