"""What the nodes around a node say: its place where it is missing, and the bend of its edges."""

from cmp_cl.filter.bends import bend_shift, bend_variance, bent_sigma
from cmp_cl.filter.holes import filled
from cmp_cl.filter.surface import bilinear_surface

__all__ = ["bend_shift", "bend_variance", "bent_sigma", "bilinear_surface", "filled"]
