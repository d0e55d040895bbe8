"""The second largest region of a board."""

import numpy as np
import pytest

from cmp_cl.grid.choice import Asked, Found, chosen_of
from cmp_cl.lattice.arrays import Board
from cmp_cl.lattice.numbers import Decision, Numbering


@pytest.mark.parametrize(("second", "counted"), [(0, 0), (2, 0), (3, 9), (5, 15)])
@pytest.mark.parametrize("first", [5, 6])
def test_regions_are_of_cells_with_firm_nodes_that_share_sides(first, second, counted):
    """The second region has three rows, and touches the first by one side or by none."""
    firm = np.zeros((12, 20), np.bool_)
    firm[:6, :10] = True
    firm[first : first + 3, 10 : 10 + second] = True
    nodes = np.zeros(firm.shape, np.float32)
    board = Board(x=nodes, y=nodes, owner=nodes.astype(int), torn=~firm, firm=firm, sign=1)
    for each in (board, board.turned(1)):
        found = Found(each, Decision(Numbering(0, 0, 0, 0, 0), None, np.inf), 0)
        assert chosen_of([found], Asked(), firm.size) == (found, counted)
