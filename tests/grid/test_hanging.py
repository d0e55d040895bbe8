"""The second largest region of a board."""

import numpy as np
import pytest

from cmp_cl.grid.choice import _hanging
from cmp_cl.lattice.arrays import Board


@pytest.mark.parametrize(("second", "counted"), [(0, 0), (2, 0), (3, 9), (5, 15)])
@pytest.mark.parametrize("first", [5, 6])
def test_regions_are_of_cells_with_firm_nodes_that_share_sides(first, second, counted):
    """The second region has three rows, and touches the first by one side or by none."""
    firm = np.zeros((12, 20), np.bool_)
    firm[:6, :10] = True
    firm[first : first + 3, 10 : 10 + second] = True
    nodes = np.zeros(firm.shape, np.float32)
    board = Board(x=nodes, y=nodes, owner=nodes.astype(int), torn=~firm, firm=firm, sign=1)
    assert _hanging(board) == _hanging(board.turned(1)) == counted
