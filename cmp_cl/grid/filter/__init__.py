"""The adaptive lattice filter: positions from the neighbours too, and how far each may be off.

On a worn print the visible corner is not where the material point is. No picture of one corner
can tell, but its neighbours in the lattice can. Each node becomes a mixture of local polynomials
along its row and its column. Stein's unbiased risk estimate chooses, node by node, how far they
reach and of which degree they are; there is nothing to set.
"""

from cmp_cl.grid.filter.bends import bend_shift, bend_shift_of
from cmp_cl.grid.filter.lattice import Filtered, filter_at_rest, filter_grid, noise_of_change
from cmp_cl.grid.filter.positions import filter_positions

__all__ = [
    "Filtered",
    "bend_shift",
    "bend_shift_of",
    "filter_at_rest",
    "filter_grid",
    "filter_positions",
    "noise_of_change",
]
