"""Drawn boards, corners at given positions, and some of the corners of an image."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method
from cmp_cl.synthetic import boards


def corners_at(xy: NDArray[Any], **given: Any) -> Corners:
    """Return corners at positions (..., 2), px, with some fields as given; the others are those of
    corners without a sigma and boundaries."""
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    usual: dict[str, tuple[Any, type]] = {
        "octave": (0, np.uint8),
        "response": (1, np.float32),
        "method": (Method.EDGE_STEP, np.uint8),
        "refusal": (0, np.uint8),
        "sigma": (np.nan, np.float32),
        "edges": (np.full(4, np.nan), np.float32),
        "doubtful": (False, np.bool_),
    }
    fields = {}
    for name, (value, kind) in usual.items():
        each = np.asarray(given.get(name, value), kind)
        shape = (len(xy), 4) if name == "edges" else len(xy)
        fields[name] = np.broadcast_to(each, shape).copy()
    return Corners(xy=xy, pixel=np.rint(xy).astype(np.int32), device="", **fields)


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
