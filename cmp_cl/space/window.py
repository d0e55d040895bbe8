"""A window before the cameras: flat layers through which they see the pattern.

The light bends at each face by Snell's law, so a point does not lie on the straight ray of its
pixel. Source: A. Agrawal, S. Ramalingam, Y. Taguchi and V. Chari, A theory of multi-layer flat
refractive geometry, CVPR 2012.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, listed
from cmp_cl.space.lens import checked_array

Array = NDArray[np.float64]

# Estimated parameters: the normal along both of its `axes`, the distance, the index behind.
WINDOW = 4
_MOST_STEPS = 50
_NEAR = 1e-8  # share of the depth; a step of Newton's method squares such an error
_TINY = 1e-300
_LARGEST_INDEX = 4.1  # germanium's in the infrared; a larger one is no index


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """A stack of flat layers before both cameras, and the medium behind it that holds the pattern.

    normal: (3,), from the cameras to the pattern, in the frame of the left camera; it is kept with
        length 1.
    distance: from the left camera to the first face along the normal, in the unit of the rig.
    layers: (thickness, index) of each layer from the first face on, in that unit. Air has index 1.
    index: of the medium behind the last face, such as the gel.

    Raises CalibrationError if a number is not finite, the normal does not point ahead of the left
    camera, the distance is not above 0, a thickness is below 0, or an index is not from 1 to 4.1.
    """

    normal: Array
    distance: float
    layers: Sequence[tuple[float, float]]
    index: float

    def __post_init__(self) -> None:
        normal = checked_array("the window's normal", self.normal, (3,))
        if not normal[2] > 0:
            raise CalibrationError(
                "the window's normal must point ahead of the left camera, to the pattern, as "
                f"(0, 0, 1) does, not {normal.tolist()}"
            )
        distance = float(checked_array("the window's distance", self.distance, ()))
        if not distance > 0:
            raise CalibrationError(
                "the window lies behind the left camera: its distance must be above 0, not "
                f"{distance:g}"
            )
        given = listed("the window's layers", self.layers, object, CalibrationError)
        layers = [
            tuple(checked_array("the window's layers", layer, (2,)).tolist()) for layer in given
        ]
        index = float(checked_array("the window's index", self.index, ()))
        for thickness, refraction in [*layers, (0.0, index)]:
            if thickness < 0 or not 1 <= refraction <= _LARGEST_INDEX:
                raise CalibrationError(
                    f"a medium of the window has thickness {thickness:g} and index {refraction:g}; "
                    f"they must be from 0, and from 1, that of air, to {_LARGEST_INDEX:g}"
                )
        normal /= np.linalg.norm(normal)
        normal.flags.writeable = False
        for field, value in (
            ("normal", normal), ("distance", distance), ("layers", tuple(layers)), ("index", index)
        ):  # fmt: skip
            object.__setattr__(self, field, value)

    @property
    def axes(self) -> Array:
        """Return two unit vectors across the normal, (2, 3): the first has no y, like the rows of
        an image, if the normal points ahead."""
        first = np.cross([0.0, 1.0, 0.0], self.normal)
        if np.linalg.norm(first) < 1e-3:
            first = np.cross([0.0, 0.0, 1.0], self.normal)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.normal, first)])

    @property
    def thickness(self) -> float:
        """Return the thickness of all layers."""
        return sum(thickness for thickness, _ in self.layers)

    def height(self, centre: Array) -> float:
        """Return the distance of the first face from a camera at `centre` (3,)."""
        return self.distance - float(self.normal @ centre)

    def moved(self, step: Array) -> "Window":
        """Return the window after a step (4,) of its estimated parameters."""
        normal = self.normal + step[:2] @ self.axes
        return Window(normal, self.distance + step[2], self.layers, self.index + step[3])

    def refracted(self, centre: Array, directions: Array) -> tuple[Array, Array]:
        """Follow rays of a camera to the medium behind the window, by Snell's law.

        centre: (3,), of the camera. directions: (N, 3), of any length. Returns points on the last
        face, (N, 3), and unit directions behind it, (N, 3); NaN where a ray does not meet the
        window.

        With unit directions v, i = w . v and r the ratio of the indices before and after a face of
        normal w, v becomes r v + (sqrt(1 - r^2 (1 - i^2)) - r i) w.
        """
        ahead = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        cosine = ahead @ self.normal
        ahead = np.where(cosine[:, None] > 0, ahead, np.nan)
        at = centre + ahead * (self.height(centre) / cosine)[:, None]
        before = 1.0
        for thickness, index in [*self.layers, (0.0, self.index)]:
            ratio = before / index
            cosine = ahead @ self.normal
            after = np.sqrt(1 - ratio**2 * (1 - cosine**2))
            ahead = ratio * ahead + (after - ratio * cosine)[:, None] * self.normal
            at = at + ahead * (thickness / after)[:, None]
            before = index
        return at, ahead

    def apparent(self, centre: Array, points: Array) -> tuple[Array, Array]:
        """Return where a camera in air would see points: at the same depth on straight rays.

        centre: (3,), of the camera. points: (N, 3). Returns the apparent points, (N, 3), and their
        derivatives by the points, (N, 3, 3); all is NaN for points in front of the last face.

        Over the depths d_k of all media, the lateral distance L of a point from the camera is the
        sum of d_k q / sqrt(n_k^2 + (n_k^2 - 1) q^2), with q the tangent of the ray's angle in air.
        It is concave in q, so Newton's method from the paraxial q climbs to the solution. With p
        the tangent in the last medium and D the depth, (dL/dq) dq = dL - p dD.
        """
        w, offset = self.normal, points - centre
        depth = offset @ w
        across = offset - depth[:, None] * w
        lateral = np.maximum(np.linalg.norm(across, axis=1), _TINY)
        height = self.height(centre)
        behind = depth - height - self.thickness
        behind[~(behind >= 0)] = np.nan
        media: list[tuple[Any, float]] = [*self.layers, (behind, self.index)]
        q = lateral / sum((d / n for d, n in media), height)
        for _ in range(_MOST_STEPS):
            square, reach, slope = q * q, height * q, np.full_like(q, height)
            for d, n in media:
                root = np.sqrt(n**2 + (n**2 - 1) * square)
                share = d / root
                reach = reach + share * q
                slope = slope + share * n**2 / (root * root)
            off = lateral - reach
            p = q / root  # of the last one
            q = q + off / slope
            if not (np.abs(off) > _NEAR * depth).any():
                break
        ahead = across / lateral[:, None]
        rate = depth / slope
        along = w + (q - p * rate)[:, None] * ahead
        by_point = (
            (depth * q / lateral)[:, None, None] * (np.eye(3) - np.outer(w, w))
            + along[:, :, None] * w
            + (rate - depth * q / lateral)[:, None, None] * ahead[:, :, None] * ahead[:, None]
        )
        return centre + depth[:, None] * (w + q[:, None] * ahead), by_point
