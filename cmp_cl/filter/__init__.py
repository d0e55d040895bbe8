"""The adaptive lattice filter: positions that use the neighbours too, and their sigma.

On a worn print the visible corner is not at the material point. The image of one corner cannot show
that, but its neighbours in the lattice can. Each node becomes a mixture of local polynomials along
its row and its column. Stein's unbiased risk estimate chooses their widths and degrees at each
node, so that there are no parameters to set.
"""

from cmp_cl.filter.bends import bend_shift, bend_variance, bent_sigma
from cmp_cl.filter.lattice import Filtered, filter_at_rest, filter_grid, noise_of_change

__all__ = [
    "Filtered",
    "bend_shift",
    "bend_variance",
    "bent_sigma",
    "filter_at_rest",
    "filter_grid",
    "noise_of_change",
]
