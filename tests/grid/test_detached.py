"""Parts of a lattice that a dropped misfit has cut off: they stay only where they belong."""

import numpy as np
import pytest

from cmp_cl.grid import NodeStatus
from cmp_cl.grid.detached import drop_detached
from cmp_cl.grid.nodes import NOWHERE, Nodes


@pytest.mark.parametrize(("offset", "rows"), [(0, 8), (3 + 2j, 8), (10j, 5), (-30, 5)])
def test_a_part_without_a_link_is_dropped_if_it_lies_elsewhere_than_its_numbers_say(offset, rows):
    nodes = Nodes((8, 8), 0, np.zeros(0, np.bool_))
    row, column = np.indices((8, 8))
    nodes.at = 10.0 * (column + 1j * row) + 0.1 * row * row
    nodes.at[5] = nodes.at[6:, :3] = nodes.at[6:, 5:] = NOWHERE
    nodes.at[6:, 3:5] += offset
    nodes.status[~np.isnan(nodes.at.real)] = NodeStatus.DETECTED
    drop_detached(nodes)
    assert nodes.at.shape == (rows, 8)
    assert np.count_nonzero(nodes.there) == 5 * 8 + 4 * (rows == 8)
