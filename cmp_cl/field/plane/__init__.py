"""Displacement and strain in the plane, from one view.

`plane_displacement` returns the displacement of each node, in px or in a length. `Motion` is the
part of it that is a common translation, rotation and zoom. `plane_strain` returns the part that
changes lengths. Each has its standard deviation, to first order in those of the positions.
"""

from cmp_cl.field.plane.displacement import (
    PlaneField,
    PlaneScale,
    plane_displacement,
    with_measured_noise,
)
from cmp_cl.field.plane.motion import Motion, motion_of, without_motion
from cmp_cl.field.plane.strain import PlaneStrain, PrincipalStrain, plane_strain

__all__ = [
    "Motion",
    "PlaneField",
    "PlaneScale",
    "PlaneStrain",
    "PrincipalStrain",
    "motion_of",
    "plane_displacement",
    "plane_strain",
    "with_measured_noise",
    "without_motion",
]
