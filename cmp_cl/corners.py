"""The corners of an image, and its intermediate images."""

import dataclasses
import enum
import math

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cmp_cl.image import AnyImage, GreyImage, check_image

FACE = 4  # corners, the fewest of a pattern
ASKED = 300  # corners, at most, whose neighbour is looked for
FEW_BITS = 2**14  # a grey level that an image of 16 bits reaches, unless it is very dark
MOSAIC = 0.75  # least share of the brightest mean that the darkest of the four pixels of 2 x 2 has
ALTERNATE = -0.6  # mean cosine of twice the turn to the neighbour; noise has -.24 to -.6


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
    response: (N,) float32, the response there: of the ring of 5 px, or of 3 px in squeezed cells;
        with BinaryRings Eq. 24 or the spectral response.
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

    def advice(
        self, image: AnyImage, full_scale: int | None = None, *, numbered: bool = False
    ) -> str:
        """Return in one line why these seem not to be the corners of a pattern, and what to try.

        The line is empty if nothing speaks against them. It says that grey levels do not fit the
        full scale, that the image is the raw mosaic of a colour camera, or that neighbouring
        corners do not alternate as those of a checkerboard do: most are then noise or texture.

        image: (H, W), which they are of. full_scale: its largest grey level, if that was given.
        numbered: whether a grid without doubts was found: then only grey levels are spoken of.
        Raises ImageError for anything else.
        """
        image = check_image(image)
        if levels := _misfit(int(image.max()), image.dtype, full_scale):
            return levels
        if _is_mosaic(image):
            return (
                "every other row and column is darker, as in the raw image of a colour camera: "
                "convert it first, for example by cv2.cvtColor(image, cv2.COLOR_BayerRG2GRAY)"
            )
        if numbered:
            return ""
        if self._alternation() > ALTERNATE:
            return (
                f"most of the {len(self)} corners are noise or texture, because neighbours do not "
                "alternate as in a checkerboard: give more light, the mean of some frames, or the "
                "part of the image that shows the pattern"
            )
        return ""

    def _alternation(self) -> float:
        """Return the mean cosine of twice the angle between the black sectors of a corner and those
        of its nearest neighbour; -1 if only few corners have boundaries.

        It is -1 in a checkerboard, sheared or not: the mean directions of black are perpendicular.
        """
        known = np.isfinite(self.edges).all(axis=1)
        xy = self.xy[known]
        if len(xy) < FACE:
            return -1.0
        first, second, third, fourth = np.exp(1j * self.edges[known]).T
        angle = np.angle(first + second - third - fourth)
        asked = np.unique(np.linspace(0, len(xy) - 1, ASKED).astype(int))
        apart = ((xy[asked, None] - xy) ** 2).sum(axis=2)
        apart[np.arange(len(asked)), asked] = np.inf
        return float(np.cos(2 * (angle[asked] - angle[apart.argmin(axis=1)])).mean())


def _misfit(brightest: int, dtype: DTypeLike, full_scale: int | None) -> str:
    """Return what to do about grey levels above the full scale, and about pixels of 16 bits that
    seem to come from a camera of fewer; "" if they are none of these."""
    if full_scale is not None:
        above = f"the brightest pixel is {brightest}, above the full scale of {full_scale}: such "
        return f"{above}pixels all look alike" if brightest > full_scale else ""
    if dtype != np.uint16 or not 0 < brightest < FEW_BITS:
        return ""
    cameras = [bits for bits in (8, 10, 12, 14) if brightest < 2**bits]
    *levels, last = [f"{2**bits - 1} for {bits} bits" for bits in cameras]
    scales = f"{', '.join(levels)} or {last}" if levels else last
    return f"the brightest of the 16-bit pixels is {brightest}; give a full scale of {scales}"


def _is_mosaic(image: GreyImage) -> bool:
    """Return whether the four pixels of 2 x 2 differ over the whole image."""
    if min(image.shape) < 2:
        return False
    rows, columns = (length // 2 * 2 for length in image.shape)
    means = image[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).mean(axis=(0, 2))
    return bool(means.min() < MOSAIC * means.max())


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Maps:
    """Every intermediate image of a frame with BinaryRings, each (H, W) unless said otherwise.

    Maps of stages that the configuration leaves out are None.

    binary: bool, True where black.
    inner, outer: uint16 ring bits, bit i is sample i, clockwise from twelve o'clock.
    inner_transitions, outer_transitions: uint8 (Eqs. 19 and 20).
    sector_difference: uint8, d2 of Eq. 21; 255 where the inner ring does not have four runs.
    ring_difference: uint8, popcount(inner ^ outer) (Eq. 22).
    corrosion: int8, Cd of Eq. 23.
    spectrum_12, spectrum_23: float32, the smaller of |F2| - |F1| and of |F2| - |F3| over
        the two rings (Eq. 13).
    correlation: float32, max R / sqrt(n1 n2), 0 where a ring is white (Eq. 17).
    phase: float32, smallest shift of the best correlation, >= 0, rad.
    candidate: bool, after the criteria and before the gate.
    contrast: int32, min(sc1, sc2) of the gate at the maxima of `response`, 0 elsewhere.
    response: int32, R before the gate.
    score: int32, S, the response under the 5 x 5 tent.
    maximum: bool, pixels that suppression and the gate keep.
    """

    binary: NDArray[np.bool_]
    inner: NDArray[np.uint16]
    outer: NDArray[np.uint16]
    inner_transitions: NDArray[np.uint8] | None
    outer_transitions: NDArray[np.uint8] | None
    sector_difference: NDArray[np.uint8] | None
    ring_difference: NDArray[np.uint8] | None
    corrosion: NDArray[np.int8] | None
    spectrum_12: NDArray[np.float32] | None
    spectrum_23: NDArray[np.float32] | None
    correlation: NDArray[np.float32] | None
    phase: NDArray[np.float32] | None
    candidate: NDArray[np.bool_]
    contrast: NDArray[np.int32] | None
    response: NDArray[np.int32]
    score: NDArray[np.int32]
    maximum: NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HarmonicMaps:
    """Every intermediate image of a frame with RingHarmonic, each (H, W).

    Those of octaves are left out.

    fine: uint16, the image smoothed once, in 1/16 of an 8-bit grey level.
    coarse: uint16, the image smoothed three times, likewise.
    coarse_response: int32, the response of the 5 px ring on `coarse`.
    fine_response: int32, the response of the 3 px ring on `fine`; None without the search for
        squeezed cells.
    maximum: bool, the corners that are kept, see `Corners.pixel`.
    """

    fine: NDArray[np.uint16]
    coarse: NDArray[np.uint16]
    coarse_response: NDArray[np.int32]
    fine_response: NDArray[np.int32] | None
    maximum: NDArray[np.bool_]
