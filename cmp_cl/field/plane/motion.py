"""Translation, rotation and zoom of a whole pattern in the plane, apart from its deformation."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind
from cmp_cl.field.plane.displacement import PlaneField

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """One motion of the whole pattern: now = centre + translation + zoom R (rest - centre).

    centre: (x, y), the mean of the nodes at rest. translation: (x, y) of the centre, in `unit`.
    rotation: rad, from x towards y. zoom: factor. sigma_translation, sigma_rotation,
    sigma_zoom: standard deviations from the errors of the positions alone; NaN where unknown.
    """

    centre: tuple[float, float]
    translation: tuple[float, float]
    rotation: float
    zoom: float
    sigma_translation: float
    sigma_rotation: float
    sigma_zoom: float
    unit: str


def motion_of(field: PlaneField, *, zoom: bool = True) -> Motion:
    """Return the translation, rotation and zoom that fit a field best by least squares.

    zoom: whether lengths may change; False fits a rigid motion, with a zoom of 1.

    Raises FieldError if fewer than two nodes are valid, or field is of another type.
    """
    check_kind("field", field, PlaneField, FieldError)
    valid = field.valid
    if np.count_nonzero(valid) < 2:
        raise FieldError("a motion needs at least two valid nodes")
    before, after = _complex(field.position[valid]), _complex(field.now[valid])
    centre, goal = before.mean(), after.mean()
    spread = np.square(np.abs(before - centre)).sum()
    if not spread > 0:
        raise FieldError("all nodes lie at one point: they show no rotation")
    factor = (np.conj(before - centre) * (after - goal)).sum() / spread
    scale = abs(factor) if zoom else 1.0
    own = field if field.raw is None else field.raw  # the filter makes neighbours share errors
    variance = np.square(own.sigma[valid])
    variance += np.square(abs(factor - 1) * own.sigma_position[valid])
    turning = math.sqrt((np.square(np.abs(before - centre)) * variance).sum()) / spread
    return Motion(
        centre=(float(centre.real), float(centre.imag)),
        translation=(float((goal - centre).real), float((goal - centre).imag)),
        rotation=float(np.angle(factor)),
        zoom=float(scale),
        sigma_translation=math.sqrt(variance.sum()) / len(before),
        sigma_rotation=turning / abs(factor),
        sigma_zoom=turning if zoom else 0.0,
        unit=field.unit,
    )


def without_motion(field: PlaneField, motion: Motion) -> PlaneField:
    """Remove a motion from the field, so that the deformation alone remains.

    The current positions are moved back. `sigma` does not include the error of the motion.
    Raises FieldError if an argument is of another type.
    """
    check_kind("field", field, PlaneField, FieldError)
    check_kind("motion", motion, Motion, FieldError)
    centre, goal = complex(*motion.centre), complex(*motion.centre) + complex(*motion.translation)
    factor = motion.zoom * np.exp(1j * motion.rotation)
    back = (_complex(field.now) - goal) / factor + centre
    moved = np.stack([back.real, back.imag], axis=-1) - field.position
    return dataclasses.replace(
        field,
        displacement=moved,
        sigma=field.sigma / abs(motion.zoom),
        shared=None if field.shared is None else _moved_back(field.shared, motion),
        raw=None if field.raw is None else without_motion(field.raw, motion),
    )


def _moved_back(shared: Array, motion: Motion) -> Array:
    cosine, sine = math.cos(motion.rotation), math.sin(motion.rotation)
    back = np.array([[cosine, sine], [-sine, cosine]]) / motion.zoom
    return np.stack([shared[0], back @ shared[1] @ back.T])


def _complex(points: Array) -> NDArray[np.complex128]:
    numbers: NDArray[np.complex128] = points[..., 0] + 1j * points[..., 1]
    return numbers
