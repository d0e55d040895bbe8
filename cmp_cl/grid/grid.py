"""The grid of nodes: corners by row and column of the pattern."""

import dataclasses
import enum

import numpy as np
from numpy.typing import NDArray


class NodeStatus(enum.IntEnum):
    """Where the position of a grid node comes from."""

    MISSING = 0
    DETECTED = 1
    ATTACHED = 2  # a free detection near the place that its neighbours predict
    SECOND_LOOK = 3  # found by a second look at the image
    INTERPOLATED = 4
    VIRTUAL = 5  # a marker on the edge between two neighbours


# what an image shows, and no neighbour has told
MEASURED = (NodeStatus.DETECTED, NodeStatus.ATTACHED, NodeStatus.SECOND_LOOK)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Corners by row and column of the pattern.

    xy: (R, C, 2) float32, px, NaN where missing.
    status: (R, C) uint8 of `NodeStatus`.
    sigma: (R, C) float32, standard deviation of the position per axis, px, NaN where unknown.
    index: (N, 2) int32, (row, column) of each corner it was built from, -1 where unassigned.
    parity: 0 where the cell between nodes (0, 0) and (1, 1) is black, 1 where it is white.
    """

    xy: NDArray[np.float32]
    status: NDArray[np.uint8]
    sigma: NDArray[np.float32]
    index: NDArray[np.int32]
    parity: int = 0

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.xy.shape[0], self.xy.shape[1]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(R, C), where there is a position."""
        return ~np.isnan(self.xy[..., 0])

    def to_opencv(self, spacing: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The valid nodes as cv2.calibrateCamera takes a view: object and image points.

        spacing: side of a square, any unit. Returns (N, 1, 3) float32 in that unit and
        (N, 1, 2) float32, px. Raises ConfigError where spacing is not positive.
        """
        from cmp_cl.stereo.exports import grid_to_opencv

        return grid_to_opencv(self, spacing)

    def with_virtual_markers(self, count: int) -> "Grid":
        """The grid with `count` points on every edge between two neighbouring nodes.

        They lie on cubic curves through the nodes. Node (r, c) is at ((count + 1) r,
        (count + 1) c) of the result, ((R - 1)(count + 1) + 1, (C - 1)(count + 1) + 1), whose
        places inside the cells are MISSING. Raises GridError where count is below 1.
        """
        from cmp_cl.grid.markers import virtual_markers

        return virtual_markers(self, count)
