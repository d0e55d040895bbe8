"""What the nodes around a node say: its place where it is missing, and the bend of its edges."""

from cmp_cl.filter.bends import bend_shift, bent_sigma
from cmp_cl.filter.holes import bilinear_surface, completed

__all__ = ["bend_shift", "bent_sigma", "bilinear_surface", "completed"]
