"""The corners of an image."""

import dataclasses
import enum
import math

import numpy as np
from numpy.typing import NDArray


class Method(enum.IntEnum):
    """How the position of a corner was found."""

    CENTROID = 0  #: the centroid of the response; no refinement was requested
    EDGE_LINES = 1  #: the intersection of the two edge lines
    EDGE_STEP = 2  #: a least-squares step of the corner model after EDGE_LINES
    MIDLINE = 3  #: the intersection of the centrelines of the black sectors
    CUSP = 4  #: the midpoint between the tips of the black sectors
    KEPT = 5  #: the centroid, because the refinement was rejected


class Refusal(enum.IntEnum):
    """The reason why the requested refinement was rejected; `method` says what is kept instead."""

    NONE = 0  #: the refinement was accepted
    RINGS = 1  #: fewer than two rings cross four boundaries
    ANGLE = 2  #: the lines enclose less than 10 degrees
    SHIFT = 3  #: the result is too far from the start, or EDGE_STEP's from EDGE_LINES'
    RESIDUAL = 4  #: the edge points are too far from their lines: the corner is torn
    FLAT = 5  #: the disc of EDGE_STEP has too little contrast


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Corners:
    """The corners of one image, rows in (y, x) order of `pixel`.

    xy: (N, 2) float32, x right, y down, px; (0, 0) is the centre of the top-left pixel.
    pixel: (N, 2) int32, the maximum (x, y) of each corner; of a maximum in a halved frame, the
        pixel of the frame nearest to it.
    octave: (N,) uint8, how often the frame was halved in which the corner was found and refined.
    response: (N,) float32, the response there (Eq. 24 or the spectral response).
    method: (N,) uint8 of `Method`.
    refusal: (N,) uint8 of `Refusal`.
    sigma: (N,) float32, standard deviation of the position per axis, px; NaN where unknown. It
        covers noise and blur, but neither wear nor edges that bend within `edge_radius`: the
        lattice shows those, see `Grid.sigma`.
    edges: (N, 4) float32, the angles of the four boundaries in [-pi, pi], rad, clockwise on
        screen, the first from white to black; NaN where unknown.
    doubtful: (N,) bool, corners whose surroundings do not fit the corner model (EdgeStep only,
        False otherwise).
    edge_radius: the radius around a corner, px, within which its refinement assumes straight
        edges; NaN if unknown (only EdgeStep has one). In octave n it is 2^n times that.
    device: the device that ran, for example "pthread-... (Portable Computing Language)".
    """

    xy: NDArray[np.float32]
    pixel: NDArray[np.int32]
    octave: NDArray[np.uint8]
    response: NDArray[np.float32]
    method: NDArray[np.uint8]
    refusal: NDArray[np.uint8]
    sigma: NDArray[np.float32]
    edges: NDArray[np.float32]
    doubtful: NDArray[np.bool_]
    edge_radius: float = math.nan
    device: str

    def __len__(self) -> int:
        return len(self.xy)

    def __repr__(self) -> str:
        return f"<Corners: {len(self)}, found on {self.device}>"

    def to_opencv(self) -> NDArray[np.float32]:
        """Return the positions as OpenCV's functions take them: (N, 1, 2) float32, px."""
        return self.xy.reshape(-1, 1, 2).copy()
