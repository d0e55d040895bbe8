"""Limits of a grid and its corners, checked before anything is allocated."""

import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.errors import GridError

MOST_NODES = 1 << 22
MANY, EACH = 65536, 64  # nodes of a grid of known shape: so many, and so many for each corner
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


def check_room(shape: tuple[int, int], corners: int) -> None:
    """Raise GridError if a grid of that shape is far too large for that many corners."""
    most = MANY + EACH * corners
    if shape[0] * shape[1] > most:
        raise GridError(
            f"a grid of {shape[0]} x {shape[1]} nodes is too large for {corners} corners, "
            f"expected at most {most} nodes"
        )
