"""Limits of a grid and its corners, checked before anything is allocated."""

import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.errors import GridError

MOST_NODES = 1 << 22
FARTHEST = 1e6  # px


def check_size(rows: int, columns: int) -> None:
    """Raise GridError for a grid of more than MOST_NODES nodes."""
    if int(rows) * int(columns) > MOST_NODES:
        raise GridError(
            f"a grid of {rows} x {columns} nodes is beyond the limit of {MOST_NODES} nodes"
        )


def check_finite(corners: Corners) -> None:
    """Raise GridError if a corner has no finite position, or one that no image has."""
    near = np.abs(corners.xy) < FARTHEST
    if not near.all():
        lost = int(np.count_nonzero(~near.all(axis=1)))
        raise GridError(
            f"{lost} of the {len(corners)} corners have no finite position; leave them out"
        )
