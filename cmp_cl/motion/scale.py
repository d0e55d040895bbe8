"""The plane of a flat pattern in the image of one camera."""

import dataclasses
import math
from typing import Self

import cv2
import numpy as np
from numpy.polynomial.polynomial import polyvander2d
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import FieldError, as_numbers, check_kind, check_positive
from cmp_cl.grid.grid import Grid

Array = NDArray[np.float64]
_TERMS = 16  # of a bicubic function


@dataclasses.dataclass(frozen=True, eq=False)
class PlaneScale:
    """The homography from the image to the plane of the pattern.

    matrix: (3, 3), from (x, y, 1), px, to the plane. unit: name of the unit of length there.

    Raises FieldError if the matrix is not finite or has no inverse.
    """

    matrix: Array
    unit: str

    def __post_init__(self) -> None:
        check_kind("unit", self.unit, str, FieldError)
        matrix = as_numbers("matrix", self.matrix, FieldError)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not np.linalg.det(matrix):
            raise FieldError(f"a homography is (3, 3), finite and regular, not {matrix.tolist()}")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def pixels(cls) -> Self:
        """Return the image itself as the plane, in px."""
        return cls(np.eye(3), "px")

    @classmethod
    def of_cells(cls, rest: Grid, side: float) -> Self:
        """Return the homography that maps the cells of a flat pattern to squares of that side.

        rest: the grid at rest. side: side of a cell, mm. The homography fits all nodes by least
            squares. x runs along the rows of the pattern, y along its columns.
            Raises FieldError if side is not positive, if fewer than 4 nodes are valid, or if all
            lie on a line.
        """
        check_kind("rest", rest, Grid, FieldError)
        check_positive("side", side, FieldError)
        row, column = np.nonzero(rest.valid)
        matrix = None
        if len(row) >= 4 and len(set(row)) > 1 and len(set(column)) > 1:
            nodes = np.column_stack([column, row]) * float(side)
            matrix, _ = cv2.findHomography(rest.xy[rest.valid].astype(np.float64), nodes)
        if matrix is None:
            raise FieldError(
                f"{len(row)} nodes at rest do not fix the plane: at least 4 are needed, in two "
                "rows and two columns"
            )
        return cls(np.asarray(matrix, np.float64), "mm")

    def uneven(self, rest: Grid, side: float) -> float:
        """Return by which share of side the sides of cells at rest are off in the plane, RMS.

        It is that of bicubic functions of column and row, less what the noise of the nodes makes of
        it: a lens, or a surface that is not flat. NaN if there are too few nodes to tell.
        """
        row, column = np.nonzero(rest.valid)
        if min(len(set(row)), len(set(column))) < 8 or len(row) < 2 * _TERMS:
            return math.nan
        last = np.array(rest.shape) - 1

        def terms(down: float, right: float) -> Array:
            y, x = (2 * (np.stack([row + down, column + right]).T / last - 0.5)).T
            return polyvander2d(y, x, (3, 3))

        inverse = np.linalg.pinv(terms(0, 0))
        off = self(rest.xy[rest.valid])[0] / side - np.column_stack([column, row])
        steps = np.vstack([terms(0.5, 0) - terms(-0.5, 0), terms(0, 0.5) - terms(0, -0.5)])
        noise = np.square(off - terms(0, 0) @ (inverse @ off)).sum() / (len(row) - _TERMS)
        noise *= np.einsum("nk,kl,nl->", steps, inverse @ inverse.T, steps)
        uneven = np.square(steps @ (inverse @ off)).sum()
        return math.sqrt(max(uneven - noise, 0.0) / len(steps))

    def __call__(self, xy: ArrayLike) -> tuple[Array, Array]:
        """Map points (..., 2), px, to the plane; also return the derivative by px, (..., 2, 2)."""
        points = as_numbers("xy", xy, FieldError)
        if not points.ndim or points.shape[-1] != 2:
            raise FieldError(f"xy must be (..., 2), not {points.shape}")
        mapped = points @ self.matrix[:, :2].T + self.matrix[:, 2]
        plane = mapped[..., :2] / mapped[..., 2:]
        slope = self.matrix[:2, :2] - plane[..., None] * self.matrix[2, :2]
        return plane, slope / mapped[..., 2, None, None]
