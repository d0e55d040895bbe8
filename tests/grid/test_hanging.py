"""The second largest region of a board."""

import numpy as np
import pytest

from cmp_cl.grid.choice import _hanging
from cmp_cl.lattice.arrays import Board


@pytest.mark.parametrize(("second", "counted"), [(0, 0), (2, 0), (3, 9), (5, 15)])
def test_regions_are_of_firm_nodes_that_are_neighbours(second, counted):
    """Two regions touch at a diagonal; the second one has three rows."""
    firm = np.zeros((12, 20), np.bool_)
    firm[:6, :10] = True
    firm[6:9, 10 : 10 + second] = True
    nodes = np.zeros(firm.shape, np.float32)
    board = Board(x=nodes, y=nodes, owner=nodes.astype(int), torn=~firm, firm=firm, sign=1)
    assert _hanging(board) == _hanging(board.turned(1)) == counted
