"""Drawn boards, and some of the corners of an image."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.synthetic import boards


def keep(corners: Corners, which: NDArray[np.bool_] | NDArray[np.int64]) -> Corners:
    """Return some of the corners, in any order: those of a mask, (N,), or of indices."""
    fields = {
        field.name: getattr(corners, field.name)[which]
        for field in dataclasses.fields(corners)
        if field.name not in ("device", "edge_radius")
    }
    return dataclasses.replace(corners, **fields)


def drawn(rows: int, columns: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return an image of a board of cells of 20 px, 40 px from the left and the top of white paper,
    and its inner corners, (rows, columns, 2) px."""
    size = (rows + 3) * 20 + 80, (columns + 3) * 20 + 80
    camera = boards.plane(cell=20, middle=(59.5, 59.5))
    view = boards.drawn(camera, size, (rows, columns), ground=205, seed=rows)
    return view.image, view.corners[:, :2].reshape(rows, columns, 2)
