"""Two calibrated cameras, and points in space from equal grid indices."""

import dataclasses
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, FieldError, as_numbers, check_kind
from cmp_cl.fits import bend_shift
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.points import Points3D, PointStatus
from cmp_cl.space.lens import (
    ESTIMATED,
    POSE,
    camera_of,
    check_matrix,
    checked_array,
    checked_distortion,
    projected,
    rays_of,
    rotation_of,
)
from cmp_cl.space.storage import last_entries, read_rig, save_storage
from cmp_cl.space.window import WINDOW, Window

MIN_PARALLAX = 1.0  # px; with less parallax, depth is only noise
MAX_ERROR = 3.0  # px, of the reprojection
_STEP = 1e-5  # of differences by parameters; of lengths, times the distance of the cameras
Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class StereoRig:
    """Two calibrated cameras in OpenCV's convention: X_right = R X_left + T.

    K1, K2: (3, 3) camera matrices, px, pixel centres at integers.
    D1, D2: 4, 5, 8 or 12 distortion coefficients, empty for none.
    R: (3, 3) rotation matrix.
    T: (3,) translation, in `unit`.
    unit: name of the unit of length.
    covariance: (22, 22), or None if unknown. The parameters are fx fy cx cy k1 k2 p1 p2 of
        the left camera, the same of the right camera, the rotation vector, the translation.
        `calibrate` estimates it. With a window it is (26, 26); the last four are the window's
        normal along both of its `axes`, rad, its distance, and the index behind it. (22, 22) means
        that these are exact.
    window: the layers through which both cameras see the pattern; None is air.

    Arrays are kept as read-only float64.

    Raises CalibrationError if a parameter is malformed, the cameras coincide or the window lies
    behind one of them.
    """

    K1: Array
    D1: Array
    K2: Array
    D2: Array
    R: Array
    T: Array
    unit: str = "mm"
    covariance: Array | None = dataclasses.field(default=None, repr=False)
    window: Window | None = None

    def __post_init__(self) -> None:
        for name, shape in (("K1", (3, 3)), ("K2", (3, 3)), ("R", (3, 3)), ("T", (3,))):
            self._set(name, checked_array(name, getattr(self, name), shape))
        for name in ("D1", "D2"):
            self._set(name, checked_distortion(name, getattr(self, name)))
        check_matrix("K1", self.K1)
        check_matrix("K2", self.K2)
        if np.abs(self.R @ self.R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(self.R) < 0:
            raise CalibrationError(f"R must be a rotation matrix, not {self.R.tolist()}")
        if np.linalg.norm(self.T) < 1e-9:
            raise CalibrationError("T is zero: two cameras at one point see no depth")
        if not (isinstance(self.unit, str) and self.unit.isidentifier()):
            raise CalibrationError(f"unit must be a word such as mm, not {self.unit!r}")
        if self.window is not None:
            check_kind("window", self.window, Window, CalibrationError)
            height = self.window.height(self._centre)
            if not height > 0:
                raise CalibrationError(
                    f"the window lies {-height:g} {self.unit} behind the right camera; its "
                    "distance counts from the left camera along its normal"
                )
        if self.covariance is not None:
            self._set("covariance", self._checked_covariance(self.covariance))

    def _checked_covariance(self, covariance: Array) -> Array:
        """Return the covariance of all parameters, 0 for those of a window that is exact."""
        size = 2 * ESTIMATED + POSE
        whole = size if self.window is None else size + WINDOW
        size = whole if np.shape(covariance) == (whole, whole) else size
        checked = checked_array("covariance", covariance, (size, size))
        if np.diag(checked).min() < 0 or not np.allclose(checked, checked.T):
            raise CalibrationError("covariance must be symmetric, with variances of 0 or more")
        return np.pad(checked, (0, whole - len(checked)))

    @property
    def _centre(self) -> Array:
        """Return the centre of the right camera in the frame of the left one, (3,)."""
        return -self.R.T @ self.T

    def _set(self, name: str, value: Array) -> None:
        value.flags.writeable = False
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a rig from a file of OpenCV's FileStorage (YAML, XML or JSON).

        The keys are K1 D1 K2 D2 R T; M1, M2, cameraMatrix1, distCoeffs1, ... are accepted too. The
        key `unit` names the unit of T; without it, that is mm, with a warning.

        Raises CalibrationError if the file cannot be read, or a parameter is missing, malformed or
        given twice.
        """
        found = read_rig(path)
        try:
            return cls(**found)
        except CalibrationError as error:
            raise CalibrationError(f"{path}: {error}") from error

    def save(self, path: str | PathLike[str]) -> None:
        """Write the rig as YAML that OpenCV reads. The file is replaced whole or not at all.

        Raises OSError if the file cannot be written.
        """
        names = ("K1", "D1", "K2", "D2", "R", "T")
        entries = {name: np.atleast_2d(getattr(self, name)) for name in names}
        save_storage(path, entries | last_entries(self.covariance, self.window, self.unit))

    def triangulate(self, left: Grid, right: Grid) -> Points3D:
        """Triangulate the nodes that both grids have, in the frame of the left camera.

        left, right: the grids of the two views. Nodes with equal indices are matched.

        A node without a position is NaN, and `Points3D.status` says why: the rays must enclose
        at least MIN_PARALLAX px in air, the point must lie in front of both cameras and behind the
        window, and it must be seen within MAX_ERROR px of its positions in the image.

        Raises FieldError if an argument is of another type, or if the grids have different rows or
        columns.
        """
        check_kind("left", left, Grid, FieldError)
        check_kind("right", right, Grid, FieldError)
        if (left.origin, left.shape) != (right.origin, right.shape):
            raise FieldError(
                f"the left grid has {left.extent}, the right one {right.extent}; cut both to "
                "the grid at rest with Grid.cut_to"
            )
        both = left.valid & right.valid
        seen = np.hstack([left.xy[both], right.xy[both]]).astype(np.float64)
        deviation = np.column_stack([grid.image_sigma[both] for grid in (left, right)]).astype("f8")
        deviation[~(deviation > 0)] = np.nan
        xyz, status = self._first_order(seen)
        error = np.full(len(seen), np.nan)
        covariance = np.full((len(seen), 3, 3), np.nan)
        good = status == PointStatus.VALID
        # Unfiltered positions: a fiftieth of their noise is added, but a filter would take a
        # quarter of the time.
        bent = np.hstack(
            [
                bend_shift(grid.xy.astype(np.float64), grid.edge_radius)[both]
                for grid in (left, right)
            ]
        )
        moved = np.zeros_like(xyz)
        if good.any():
            xyz[good], error[good], covariance[good], moved[good] = self._refined(
                xyz[good], seen[good], deviation[good], bent[good]
            )
        status[good & ~(error <= MAX_ERROR)] = PointStatus.INCONSISTENT
        bad = status != PointStatus.VALID
        for values in (xyz, covariance, moved):
            values[bad] = np.nan
        all_status = np.full(left.shape, PointStatus.MISSING, np.uint8)
        all_status[both] = status
        return Points3D(
            xyz=spread(both, xyz),
            error=spread(both, error),
            covariance=spread(both, covariance),
            status=all_status,
            source=np.where(both, np.maximum(left.status, right.status), NodeStatus.MISSING).astype(
                np.uint8
            ),
            unit=self.unit,
            bend_shift=spread(both, moved),
        )

    def _first_order(self, seen: Array) -> tuple[Array, NDArray[np.uint8]]:
        """Triangulate (N, 4) px, left and right: the middles between their rays, (N, 3), and the
        status, (N,)."""
        one, left_in_model = rays_of(seen[:, :2], self.K1, self.D1)
        two, right_in_model = rays_of(seen[:, 2:], self.K2, self.D2)
        two = two @ self.R
        sine = np.linalg.norm(np.cross(one, two), axis=1)
        sine /= np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        if self.window is None:
            xyz = between(one, two, self._centre)
            depth = np.minimum(xyz[:, 2], (xyz @ self.R.T + self.T)[:, 2])
        else:
            (from_one, one), (from_two, two) = (
                self.window.refracted(centre, rays)
                for centre, rays in ((np.zeros(3), one), (self._centre, two))
            )
            xyz = from_one + between(one, two, from_two - from_one)
            depth = xyz @ self.window.normal - self.window.distance - self.window.thickness
        focal = (self.K1[0, 0] + self.K1[1, 1] + self.K2[0, 0] + self.K2[1, 1]) / 4

        status = np.full(len(seen), PointStatus.VALID, np.uint8)
        status[~(depth > 0)] = PointStatus.BEHIND
        status[~(sine * focal >= MIN_PARALLAX)] = PointStatus.PARALLEL
        status[~(left_in_model & right_in_model)] = PointStatus.INCONSISTENT
        return xyz, status

    def _refined(
        self, xyz: Array, seen: Array, sigma: Array, bent: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Take one Gauss-Newton step on the reprojection error, weighted by 1 / sigma^2.

        xyz: (N, 3). seen: (N, 4) px, left and right. sigma: (N, 2) px; NaN weights both alike.
        bent: (N, 4) px, shifts by bent edges. Returns the points (N, 3); the reprojection errors
            (N,), px; their covariances (N, 3, 3), NaN if unknown; and the motion of the points by
            the shifts, (N, 3).
        """
        projected, jacobian, _ = self._projected(xyz)
        residual = seen - projected
        known = np.isfinite(sigma.sum(axis=1))
        weight = np.repeat(1 / np.where(known[:, None], sigma, 1), 2, axis=1)[..., None]
        scaled = jacobian * weight
        inverse = np.linalg.inv(scaled.transpose(0, 2, 1) @ scaled)
        by_image = inverse @ (scaled * weight).transpose(0, 2, 1)
        step = by_image @ residual[..., None]
        residual = residual - (jacobian @ step)[..., 0]
        error = np.sqrt(np.square(residual).sum(axis=1) / 2)
        covariance = np.where(known[:, None, None], inverse, np.nan)
        return xyz + step[..., 0], error, covariance, (by_image @ bent[..., None])[..., 0]

    def project(self, xyz: Array) -> tuple[Array, Array]:
        """Project points to both views, (N, 2) px each.

        xyz: (N, 3), in the frame of the left camera. Points in front of the last face of the window
        are NaN. Raises FieldError for other points.
        """
        points = as_numbers("xyz", xyz, FieldError)
        if points.ndim != 2 or points.shape[1] != 3:
            raise FieldError(f"xyz must be (N, 3), not {points.shape}")
        seen, _, _ = self._projected(points)
        return seen[:, :2], seen[:, 2:]

    def slopes(self, xyz: Array) -> tuple[Array, Array]:
        """Return the derivatives of the pixels of both views, left and right.

        xyz: (N, 3), the points. They are by the point, (N, 4, 3), and by the P parameters of
        `covariance`, (N, 4, P), px; those by the pose and the window are differences.
        """
        seen, by_point, by_lens = self._projected(xyz)
        length = np.linalg.norm(self.T)
        sizes = [1, 1, 1, length, length, length]
        if self.window is not None:
            sizes += [1, 1, length, 1]
        by_place = [
            (self._moved(step)._projected(xyz)[0] - seen) / step.sum()
            for step in np.diag(_STEP * np.array(sizes))
        ]
        return by_point, np.dstack([by_lens, *by_place])

    def _moved(self, step: Array) -> "StereoRig":
        """Return the rig after a step of its pose and of its window, without a covariance."""
        pose, window = np.split(step, [POSE])
        right = self._cameras[1]
        right[-POSE:] += pose
        return dataclasses.replace(
            self,
            R=rotation_of(right),
            T=right[-3:],
            window=None if self.window is None else self.window.moved(window),
            covariance=None,
        )

    @property
    def _cameras(self) -> tuple[Array, Array]:
        """Return the parameters of both cameras, see `cmp_cl.space.lens`."""
        return (
            camera_of(self.K1, self.D1, np.eye(3), np.zeros(3)),
            camera_of(self.K2, self.D2, self.R, self.T),
        )

    def _projected(self, xyz: Array) -> tuple[Array, Array, Array]:
        """Project points into both cameras, (N, 4) px; also return the derivatives by the point,
        (N, 4, 3), and by the parameters of both lenses, (N, 4, 16)."""
        seen, slopes = [], []
        by_lens = np.zeros((len(xyz), 4, 2 * ESTIMATED))
        for k, (camera, centre) in enumerate(
            zip(self._cameras, (np.zeros(3), self._centre), strict=True)
        ):
            straight, bend = xyz, np.eye(3)
            if self.window is not None:
                straight, bend = self.window.apparent(centre, xyz)
            pixels, by_camera = projected(straight, camera)
            seen.append(pixels)
            # By the translation, which is by the rotated point.
            slopes.append(by_camera[..., -3:] @ (rotation_of(camera) @ bend))
            own = slice(k * ESTIMATED, (k + 1) * ESTIMATED)
            by_lens[:, 2 * k : 2 * k + 2, own] = by_camera[..., :ESTIMATED]
        return np.hstack(seen), np.concatenate(slopes, axis=1), by_lens


def between(one: Array, two: Array, centre: Array) -> Array:
    """Return the middle of the shortest segment between two rays, (N, 3), NaN where parallel.

    one, two: their directions, (N, 3). The first ray begins at the origin, the second at `centre`,
    (3,) or (N, 3). The middle has nearly the least reprojection error.
    """
    own, both, other, ahead_one, ahead_two = (
        (first * second).sum(axis=1)
        for first, second in ((one, one), (one, two), (two, two), (one, centre), (two, centre))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        shared = own * other - np.square(both)
        depth_one = (ahead_one * other - both * ahead_two) / shared
        depth_two = (both * ahead_one - own * ahead_two) / shared
        points = (depth_one[:, None] * one + depth_two[:, None] * two + centre) / 2
    return np.where(np.isfinite(points), points, np.nan)


def points_by_image(slopes: Array) -> Array:
    """Return the derivatives of points by the pixels of both views, (N, 3, 4), for the least
    squares of the reprojection; slopes: those of the pixels by the points, (N, 4, 3)."""
    turned = slopes.transpose(0, 2, 1)
    return np.linalg.inv(turned @ slopes) @ turned


def spread(where: NDArray[np.bool_], values: NDArray[Any]) -> Array:
    """Scatter values to the True elements of an (R, C) mask; the others are NaN."""
    spread = np.full((*where.shape, *values.shape[1:]), np.nan)
    spread[where] = values
    return spread
