"""What the error of a rig does to the displacements of points: one error, shared by all of them."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.points import largest_deviation
from cmp_cl.space.rig import StereoRig, points_by_image

Array = NDArray[np.float64]

_STEP = 1e-3  # of the differences, share of the distance of the points


class Bias:
    """The standard deviation of displacements by the error of a rig, from its `covariance`.

    rig: with a covariance. rest: the points from which they are, (R, C, 3), NaN where missing.

    Raises FieldError if the rig has no covariance.

    With points x(p) at fixed positions in the image and parameters p of the covariance P, a
    displacement u is off by G u dp, G the derivatives of dx/dp by x. So its covariance is quadratic
    in u, (G u) P (G u)^T; its coefficients are computed once.
    """

    def __init__(self, rig: StereoRig, rest: Array) -> None:
        if rig.covariance is None:
            raise FieldError("the rig has no covariance; calibrate it")
        flat = np.asarray(rest, np.float64).reshape(-1, 3)
        step = _STEP * float(np.nanmedian(np.linalg.norm(flat, axis=1)))
        by_axis = [
            (_by_rig(rig, flat + way) - _by_rig(rig, flat - way)) / (2 * step)
            for way in step * np.eye(3)
        ]
        change = np.stack(by_axis, axis=1).reshape(len(flat), 9, -1)
        form = (change @ rig.covariance @ change.transpose(0, 2, 1)).reshape(-1, 3, 3, 3, 3)
        # (9, 9, N): the axes of the covariance, by those of the two displacements
        self._form = np.ascontiguousarray(form.transpose(2, 4, 1, 3, 0)).reshape(9, 9, -1)

    def covariance(self, displacement: Array) -> Array:
        """Return that of displacements (R, C, 3), in the unit of the rig: (R, C, 3, 3), NaN where
        unknown. All nodes and frames share this error; it is no noise, and does not average out.

        The variance along a unit vector n is n^T C n.
        """
        u = np.asarray(displacement, np.float64)
        flat = u.reshape(-1, 3).T
        both = (flat[:, None] * flat).reshape(9, -1)
        covariance: Array = np.einsum("abn,bn->na", self._form, both).reshape(*u.shape, 3)
        return covariance

    def sigma(self, displacement: Array) -> Array:
        """Return the standard deviation along the most uncertain axis, (R, C), as `covariance`."""
        return largest_deviation(self.covariance(displacement))


def _by_rig(rig: StereoRig, xyz: Array) -> Array:
    """Return the derivatives of points (N, 3) by the parameters of the rig, (N, 3, P), at fixed
    positions in the image."""
    by_point, by_rig = rig.slopes(xyz)
    return -points_by_image(by_point) @ by_rig
