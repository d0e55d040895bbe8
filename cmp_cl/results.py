"""What comes out: corners, the intermediate maps, grids, points, fields."""

import dataclasses
import enum
from os import PathLike
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

GreyImage: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]
_PIXELS = frozenset({np.dtype(np.uint8), np.dtype(np.uint16)})


class Method(enum.IntEnum):
    """How the position of a corner was found."""

    CENTROID = 0  # no refinement was asked for
    EDGE_LINES = 1
    EDGE_STEP = 2
    MIDLINE = 3
    CUSP = 4
    KEPT = 5  # refinement refused, the centroid was kept


class NodeStatus(enum.IntEnum):
    """Where the position of a grid node comes from."""

    MISSING = 0
    DETECTED = 1
    ATTACHED = 2  # a free detection near the place that its neighbours predict
    SECOND_LOOK = 3  # found by a second look at the image
    INTERPOLATED = 4
    VIRTUAL = 5  # a marker on the edge between two neighbours


class PointStatus(enum.IntEnum):
    """Why a triangulated node is there or not."""

    MISSING = 0  # a side has no position
    VALID = 1
    PARALLEL = 2  # the rays enclose too small an angle: no disparity, or along the baseline
    BEHIND = 3  # behind a camera
    INCONSISTENT = 4  # the two positions do not belong together, or the lens model ends there


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Corners:
    """The corners of one image, rows in (y, x) order of `pixel`.

    xy: (N, 2) float32, x right, y down, px; (0, 0) is the centre of the top-left pixel.
    pixel: (N, 2) int32, the maximum each came from, (x, y).
    response: (N,) float32, the response there (Eq. 24 or the spectral response).
    method: (N,) uint8 of `Method`.
    sigma: (N,) float32, standard deviation of the position per axis, px; NaN where unknown.
    edges: (N, 4) float32, the angles of the four boundaries in [-pi, pi], rad, clockwise on
        screen, the first from white to black; NaN where unknown.
    doubtful: (N,) bool, corners whose surroundings do not look like the corner model
        (EdgeStep only, False otherwise).
    device: what ran, for example "pthread-... (Portable Computing Language)".
    """

    xy: NDArray[np.float32]
    pixel: NDArray[np.int32]
    response: NDArray[np.float32]
    method: NDArray[np.uint8]
    sigma: NDArray[np.float32]
    edges: NDArray[np.float32]
    doubtful: NDArray[np.bool_]
    device: str

    def __len__(self) -> int:
        return len(self.xy)

    def to_opencv(self) -> NDArray[np.float32]:
        """The positions as OpenCV's functions take them: (N, 1, 2) float32, px."""
        return self.xy.reshape(-1, 1, 2).copy()


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Maps:
    """Every intermediate image of a frame, each (H, W) unless said otherwise.

    With three masks the maps up to `contrast` have a leading axis of 3, in the order of
    the thresholds mean, mean - sigma/2, mean + sigma/2. Maps of stages that the
    configuration leaves out are None. With a working scale they have its size.

    binary: bool, True where black.
    inner, outer: uint16 ring masks, bit i is sample i, clockwise from twelve o'clock.
    inner_transitions, outer_transitions: uint8 (Eqs. 19 and 20).
    sector_difference: uint8, d2 of Eq. 21; 255 where the inner ring has not four runs.
    ring_difference: uint8, popcount(inner ^ outer) (Eq. 22).
    corrosion: int8, Cd of Eq. 23.
    spectrum_12, spectrum_23: float32, the smaller of |F2| - |F1| and of |F2| - |F3| over
        the two rings (Eq. 13).
    correlation: float32, max R / sqrt(n1 n2), 0 where a ring is white (Eq. 17).
    phase: float32, smallest shift of the best correlation, >= 0, rad.
    candidate: bool, after the criteria and before the gate.
    contrast: int32, min(sc1, sc2) of the gate, 0 off candidates.
    response: int32, R after the gate.
    score: int32, S, the response under the 5 x 5 tent.
    maximum: bool, what suppression kept.
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

    def with_virtual_markers(self, count: int) -> "Grid":
        """The grid with `count` points on every edge between two neighbouring nodes.

        They lie on cubic curves through the nodes. Node (r, c) is at ((count + 1) r,
        (count + 1) c) of the result, ((R - 1)(count + 1) + 1, (C - 1)(count + 1) + 1), whose
        places inside the cells are MISSING. Raises GridError where count is below 1.
        """
        from cmp_cl.markers import virtual_markers

        return virtual_markers(self, count)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Points3D:
    """Triangulated nodes, in the frame of the left camera.

    xyz: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    error: (R, C) float64, root mean square over both views of the distance between the
        measured and the reprojected position, px; INCONSISTENT nodes may keep it.
    covariance: (R, C, 3, 3) float64, of xyz, in `unit` squared: the corners' standard
        deviations through the geometry, without the calibration's own error; NaN where
        those are unknown.
    status: (R, C) uint8 of `PointStatus`.
    source: (R, C) uint8 of `NodeStatus`, of the two sides the less direct one.
    unit: name of the unit of length.
    """

    xyz: NDArray[np.float64]
    error: NDArray[np.float64]
    covariance: NDArray[np.float64]
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    unit: str

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(R, C), where there is a position."""
        return np.equal(self.status, PointStatus.VALID)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(R, C) float64, standard deviation along the most uncertain axis, in `unit`."""
        return largest_deviation(self.covariance)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisplacementField:
    """Where each node was at rest, and how far it has moved.

    position: (R, C, 3) float64, at rest, in `unit`, in the frame of the left camera; NaN
        unless the node is valid.
    displacement: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    sigma: (R, C) float64, standard deviation of the displacement along its most uncertain
        axis, in `unit`; NaN where unknown.
    status: (R, C) uint8 of `PointStatus`, of now; of rest where that one is not valid.
    source: (R, C) uint8 of `NodeStatus`, of the two moments the less direct one.
    strain: (R, C, 3) float64, Green-Lagrange strain E11, E22, E12 in the tangent plane of
        the rest surface, axis 1 along the rows; NaN where too few neighbours are valid;
        None where it was not asked for (`with_strain`).
    unit: name of the unit of length.
    """

    position: NDArray[np.float64]
    displacement: NDArray[np.float64]
    sigma: NDArray[np.float64]
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    strain: NDArray[np.float64] | None
    unit: str

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(R, C), where there is a displacement."""
        return np.equal(self.status, PointStatus.VALID)

    def with_strain(self, radius: int = 2) -> "DisplacementField":
        """The same field with its in-plane strain, smoothed over 2 radius + 1 nodes a side.

        See `cmp_cl.field.green_lagrange`. Raises ConfigError where radius is not 1 to 50.
        """
        from cmp_cl.field import green_lagrange

        strain = green_lagrange(self.position, self.position + self.displacement, radius=radius)
        return dataclasses.replace(self, strain=strain)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the field as .npz, .csv, .ply or .vtp, by suffix, whole or not at all.

        Raises ConfigError on another suffix, OSError where the file cannot be written.
        """
        from cmp_cl.field import save

        save(self, path)


def largest_deviation(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Square root of the largest eigenvalue: (..., 3, 3) -> (...), NaN stays NaN."""
    known = np.isfinite(covariance).all(axis=(-2, -1))
    deviation = np.full(known.shape, np.nan)
    deviation[known] = np.sqrt(np.linalg.eigvalsh(covariance[known])[:, -1].clip(0))
    return deviation


def check_image(image: Any) -> GreyImage:
    """The image itself, if it is (H, W) uint8 or uint16 with contiguous rows.

    Raises ImageError that says what came, what is expected and which call converts it.
    """
    if not _is_image(image):
        raise _not_an_image(image)
    return cast(GreyImage, image)


def _is_image(image: Any) -> bool:
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype not in _PIXELS:
        return False
    (rows, columns), (row, column), size = image.shape, image.strides, image.itemsize
    return not image.size or (
        (column == size or columns == 1)
        and (rows == 1 or (row >= columns * size and row % size == 0))
    )


def _not_an_image(image: Any) -> Exception:
    """An ImageError that says what is wrong with it and what mends it."""
    from cmp_cl.errors import ImageError

    expected = "expected a NumPy array (H, W) of uint8 or uint16"
    if not isinstance(image, np.ndarray):
        hint = "numpy.asarray(image) converts"
        if image is None:
            hint = "cv2.imread gives None for a file that it cannot read"
        elif isinstance(image, str | PathLike):
            hint = "cv2.imread(image, cv2.IMREAD_GRAYSCALE) converts"
        return ImageError(f"{expected}, got {type(image).__name__}; {hint}")
    came = f"got shape {image.shape} of {image.dtype}"
    if image.ndim == 3 and image.shape[2] in (3, 4):
        code = "cv2.COLOR_BGR2GRAY" if image.shape[2] == 3 else "cv2.COLOR_BGRA2GRAY"
        hint = f"cv2.cvtColor(image, {code}) converts"
    elif image.ndim != 2:
        hint = "image.reshape(height, width) or one frame of it converts"
    elif image.dtype == np.bool_:
        hint = "image.astype(numpy.uint8) * 255 converts"
    elif image.dtype.kind in "ui" and image.dtype.itemsize == 2 and image.dtype not in _PIXELS:
        hint = "image.clip(0).astype(numpy.uint16) converts"
    elif image.dtype not in _PIXELS:
        hint = (
            "numpy.nan_to_num(image * (255 / white)).round().clip(0, 255).astype(numpy.uint8) "
            "converts, white being its largest level"
        )
    else:
        expected = f"{expected} with contiguous rows and a positive row step"
        came = f"{came} with strides {image.strides}"
        hint = "numpy.ascontiguousarray(image) converts"
    return ImageError(f"{expected}, {came}; {hint}")
