"""The tables that `detect` writes: corners, or the nodes of a grid."""

from collections.abc import Iterable, Iterator, Sequence
from typing import BinaryIO

import numpy as np

from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.files import csv_bytes
from cmp_cl.grid import Grid, NodeStatus

CORNER_COLUMNS = (
    *("x_px", "y_px", "pixel_x_px", "pixel_y_px", "response", "method"),
    *("sigma_px", "edge0_rad", "edge1_rad", "edge2_rad", "edge3_rad", "doubtful", "refusal"),
)
NODE_COLUMNS = ("row", "column", "x_px", "y_px", "sigma_px", "status")


class Table:
    """Writes rows of frames as CSV: a header with units, then a row for each corner or node.

    columns: the names of the columns after those of the image and the frame. rows: how many were
    written.
    """

    def __init__(self, file: BinaryIO, columns: Sequence[str]) -> None:
        self._file = file
        self.rows = 0
        file.write(csv_bytes([("image", "frame", *columns)]))

    def write(self, name: str, frame: int, rows: Iterable[Sequence[object]]) -> None:
        """Append the rows of one frame; name: the file that holds the frame."""
        full = [(name, frame, *row) for row in rows]
        self._file.write(csv_bytes(full))
        self.rows += len(full)


def corner_rows(corners: Corners) -> Iterator[Sequence[object]]:
    """Return a row of CORNER_COLUMNS for every corner."""
    arrays = (
        *(corners.xy, corners.pixel, corners.response, corners.method),
        *(corners.sigma, corners.edges, corners.doubtful, corners.refusal),
    )
    for xy, pixel, response, method, sigma, edges, doubtful, refusal in zip(*arrays, strict=True):
        how, why = Method(method).name, Refusal(refusal).name
        yield (*xy, *pixel, response, how, sigma, *edges, int(doubtful), why)


def node_rows(grid: Grid) -> Iterator[Sequence[object]]:
    """Return a row of NODE_COLUMNS for every node; missing positions are NaN."""
    for index in np.ndindex(grid.shape):
        status = NodeStatus(int(grid.status[index])).name
        yield (*index, *grid.xy[index], grid.sigma[index], status)
